//! What the name of a file, its title and its location say of the test.

use std::collections::BTreeMap;
use std::path::Path;

use volcomp_metrology::{Metadata, errors_named};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::draft::Proposed;

/// What names and texts say.
#[derive(Debug, Default)]
pub(crate) struct Hints {
    /// Every error motion that is named, each once.
    pub(crate) errors: Vec<ErrorName>,
    /// The one axis that stands alone as a word of the file's name.
    pub(crate) axis: Option<AxisName>,
    /// Where axes stood: `y-z1050`, `X at Y = 0`.
    pub(crate) places: BTreeMap<AxisName, f64>,
    /// Texts that say different things.
    pub(crate) contradictions: Vec<String>,
}

impl Hints {
    pub(crate) fn of(path: &Path, texts: &Metadata, machine: &Machine) -> Self {
        let stem = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let mut hints = Self::default();
        let texts = [texts.title.as_deref(), texts.location.as_deref()];
        let has = |error: &ErrorName| !error.location && machine.axis(error.axis).is_some();
        let all = [Some(stem.as_str())].into_iter().chain(texts).flatten();
        for error in all.flat_map(errors_named).filter(has) {
            if !hints.errors.contains(&error) {
                hints.errors.push(error);
            }
        }
        let words: Vec<&str> = stem
            .split(|c: char| !(c.is_ascii_alphanumeric() || c == '.'))
            .collect();
        let mut alone = words
            .iter()
            .filter_map(|word| letter(word, machine).filter(|(_, rest)| rest.is_empty()));
        hints.axis = match (alone.next(), alone.next()) {
            (Some((axis, _)), None) => Some(axis),
            _ => None,
        };
        // A minus in a file's name may be a dash: only numbers right behind their letter count.
        let in_name = words.iter().filter_map(|word| {
            let (axis, number) = letter(word, machine)?;
            let plain = number.bytes().all(|b| b.is_ascii_digit() || b == b'.');
            Some((axis, number.parse::<f64>().ok().filter(|_| plain)?))
        });
        let in_texts = texts.iter().flatten().flat_map(|text| stated_places(text));
        for (axis, place) in in_name.chain(in_texts) {
            match hints.places.get(&axis) {
                Some(other) if *other != place => hints.contradictions.push(format!(
                    "CONTRADICTION: name, title and location say {axis} = {other} and {axis} = {place}"
                )),
                _ => {
                    hints.places.insert(axis, place);
                }
            }
        }
        // Of two places none is the right one.
        let contradicted = std::mem::take(&mut hints.contradictions);
        for axis in AxisName::ALL {
            if contradicted
                .iter()
                .any(|said| said.contains(&format!("say {axis} = ")))
            {
                hints.places.remove(&axis);
            }
        }
        hints.contradictions = contradicted;
        hints
    }

    /// The error, where one is named and no other.
    pub(crate) fn only_error(&self) -> Option<ErrorName> {
        match self.errors[..] {
            [only] => Some(only),
            _ => None,
        }
    }
}

/// The axis of the machine whose letter a word begins with, and the rest of the word.
fn letter<'w>(word: &'w str, machine: &Machine) -> Option<(AxisName, &'w str)> {
    let mut letters = word.chars();
    let first = letters.next()?.to_ascii_uppercase();
    let axis = AxisName::from_letter(first).filter(|axis| machine.axis(*axis).is_some())?;
    Some((axis, letters.as_str()))
}

/// Every `Y = 12.5` of a text.
fn stated_places(text: &str) -> Vec<(AxisName, f64)> {
    let mut places = Vec::new();
    let parts: Vec<&str> = text.split('=').collect();
    for pair in parts.windows(2) {
        let before = pair[0].trim_end();
        let mut letters = before.chars().rev();
        let axis = letters
            .next()
            .and_then(|c| AxisName::from_letter(c.to_ascii_uppercase()));
        let stands_alone = letters.next().is_none_or(|c| !c.is_alphanumeric());
        let number = pair[1].trim_start();
        let end = number.find(|c: char| !(c.is_ascii_digit() || "+-.".contains(c)));
        let number = number[..end.unwrap_or(number.len())].parse::<f64>().ok();
        if let (Some(axis), true, Some(number)) = (axis, stands_alone, number) {
            places.push((axis, number));
        }
    }
    places
}

/// Known errors in the order of their names, then the unknown ones; within an error by file.
pub(crate) fn sort(proposed: &mut [Proposed]) {
    let key = |of: &Proposed| {
        let error = of
            .error
            .map(|error| (error.axis.index(), error.component.index()));
        (error.is_none(), error, of.files.clone())
    };
    proposed.sort_by_key(key);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_stand_behind_their_letter() {
        assert_eq!(
            stated_places("X at Y = 0, Z=-1050.5 mm"),
            [(AxisName::Y, 0.0), (AxisName::Z, -1050.5)]
        );
        assert_eq!(stated_places("FLY = 3; Y ="), []);
        assert_eq!(stated_places("= = ="), []);
    }
}
