//! Look-ups shared by all decoders: a value or its default, a number within a range, one of several words, an array of tables.

use core::{fmt::Display, ops::RangeInclusive};

use crate::{
    error::InputError,
    toml_file::{Section, Value},
};

/// Description of an expected range; an infinite end is no limit.
pub(crate) fn expected_range(range: RangeInclusive<f64>) -> String {
    let (low, high) = range.into_inner();
    match (low.is_finite(), high.is_finite()) {
        (true, false) => format!("a number of {low} or more"),
        (false, true) => format!("a number of {high} or less"),
        _ => format!("a number from {low} to {high}"),
    }
}

impl<'a> Section<'a> {
    /// Value of a key as `decode` returns it; `None` if the key is missing.
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

    /// Number within `range`, or `default` (which may lie outside it) if the key is missing.
    ///
    /// # Errors
    /// Anything but a number within the range.
    pub fn number_or(
        &self,
        key: &str,
        range: RangeInclusive<f64>,
        default: f64,
    ) -> Result<f64, InputError> {
        Ok(self.optional(key, |value| value.number_in(range))?.unwrap_or(default))
    }

    /// Whole number within `range`, or `default` (which may lie outside it) if the key is missing.
    ///
    /// # Errors
    /// Anything but a whole number within the range.
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
    /// Anything but a truth value.
    pub fn truth_or(&self, key: &str, default: bool) -> Result<bool, InputError> {
        Ok(self.optional(key, Value::truth)?.unwrap_or(default))
    }

    /// Value that belongs to the word of a key, or `default` if the key is missing.
    ///
    /// # Errors
    /// Anything but one of the words.
    pub fn one_of<T: Clone>(
        &self,
        key: &str,
        words: &[(&str, T)],
        default: T,
    ) -> Result<T, InputError> {
        Ok(self.optional(key, |value| value.one_of(words))?.unwrap_or(default))
    }

    /// Decodes every table of an array of tables (`[[key]]`) in order; empty if the key is missing.
    ///
    /// # Errors
    /// Anything but an array of tables, and those of `decode`.
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
    /// Number within `range`, both ends included; an infinite end is no limit.
    ///
    /// # Errors
    /// Anything else, with the expected range.
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
    /// Anything else.
    pub fn positive(&self) -> Result<f64, InputError> {
        let found = self.number()?;
        if found > 0.0 {
            return Ok(found);
        }
        Err(self.error(format!("found {found}, expected a number above 0")))
    }

    /// Value that belongs to this word.
    ///
    /// # Errors
    /// Anything but one of the words; the message lists them.
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
