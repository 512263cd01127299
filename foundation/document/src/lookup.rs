//! Look-ups for all decoders: a value or its default, a number within a range, one of several words, an array of
//! tables.

use core::{fmt::Display, ops::RangeInclusive};

use crate::{
    error::InputError,
    toml_file::{Section, Value},
};

/// Describes an expected range. An infinite end is no limit.
pub(crate) fn expected_range(range: RangeInclusive<f64>) -> String {
    let (low, high) = range.into_inner();
    match (low.is_finite(), high.is_finite()) {
        (true, false) => format!("a number of {low} or more"),
        (false, true) => format!("a number of {high} or less"),
        _ => format!("a number from {low} to {high}"),
    }
}

impl<'a> Section<'a> {
    /// Value that `decode` returns for a key; `None` if the key is missing.
    ///
    /// # Errors
    /// The errors of `decode`.
    pub fn optional<T, E>(
        &self,
        key: &str,
        decode: impl FnOnce(&Value<'a>) -> Result<T, E>,
    ) -> Result<Option<T>, E> {
        self.get(key).map(|value| decode(&value)).transpose()
    }

    /// Number within `range`, or `default` if the key is missing. The default may be outside the range.
    ///
    /// # Errors
    /// The value is not a number within the range.
    pub fn number_or(
        &self,
        key: &str,
        range: RangeInclusive<f64>,
        default: f64,
    ) -> Result<f64, InputError> {
        Ok(self.optional(key, |value| value.number_in(range))?.unwrap_or(default))
    }

    /// Whole number within `range`, or `default` if the key is missing. The default may be outside the range.
    ///
    /// # Errors
    /// The value is not a whole number within the range.
    pub fn whole_or<N>(
        &self,
        key: &str,
        range: RangeInclusive<N>,
        default: N,
    ) -> Result<N, InputError>
    where
        N: TryFrom<i128> + PartialOrd + Display,
    {
        Ok(self.optional(key, |value| value.whole(range))?.unwrap_or(default))
    }

    /// `true` or `false`, or `default` if the key is missing.
    ///
    /// # Errors
    /// The value is neither `true` nor `false`.
    pub fn truth_or(&self, key: &str, default: bool) -> Result<bool, InputError> {
        Ok(self.optional(key, Value::truth)?.unwrap_or(default))
    }

    /// The key must be one of the words. Returns the value that belongs to that word, or `default` if the key is
    /// missing.
    ///
    /// # Errors
    /// The value of the key is not one of the words.
    pub fn one_of<T: Clone>(
        &self,
        key: &str,
        words: &[(&str, T)],
        default: T,
    ) -> Result<T, InputError> {
        Ok(self.optional(key, |value| value.one_of(words))?.unwrap_or(default))
    }

    /// Decodes all tables of an array of tables (`[[key]]`) in order. Returns an empty list if the key is missing.
    ///
    /// # Errors
    /// The value is not an array of tables, or an error of `decode`.
    pub fn tables<T, E: From<InputError>>(
        &self,
        key: &str,
        mut decode: impl FnMut(&Section<'a>) -> Result<T, E>,
    ) -> Result<Vec<T>, E> {
        let Some(value) = self.get(key) else {
            return Ok(Vec::new());
        };
        let mut decoded = Vec::new();
        for item in value.items()? {
            decoded.push(decode(&item.section()?)?);
        }
        Ok(decoded)
    }
}

impl Value<'_> {
    /// Number within `range`, including both ends. An infinite end is no limit.
    ///
    /// # Errors
    /// The value is not a number within the range. The message states the range.
    pub fn number_in(&self, range: RangeInclusive<f64>) -> Result<f64, InputError> {
        let found = self.number()?;
        if range.contains(&found) {
            return Ok(found);
        }
        let expected = expected_range(range);
        Err(self.error(format!("found {found}, expected {expected}")))
    }

    /// Finite number above 0.
    ///
    /// # Errors
    /// The value is not a finite number above 0.
    pub fn positive(&self) -> Result<f64, InputError> {
        let found = self.number()?;
        if found > 0.0 {
            return Ok(found);
        }
        Err(self.error(format!("found {found}, expected a number above 0")))
    }

    /// The text must be one of the words. Returns the value that belongs to that word.
    ///
    /// # Errors
    /// The text is not one of the words. The message lists the words.
    pub fn one_of<T: Clone>(&self, words: &[(&str, T)]) -> Result<T, InputError> {
        let found = self.text()?;
        if let Some((_, meaning)) = words.iter().find(|(word, _)| *word == found) {
            return Ok(meaning.clone());
        }
        let known: Vec<&str> = words.iter().map(|(word, _)| *word).collect();
        let known = known.join(", ");
        Err(self.error(format!("found \"{found}\", expected one of: {known}")))
    }
}
