//! Finds numbers that are not finite in a result, because JSON would represent them as null.

use ciborium::Value;
use serde::Serialize;

use crate::failure::Failure;

/// The key of the first number that is NaN or infinite; `None` if all numbers are finite.
pub(crate) fn first_not_finite(document: &impl Serialize) -> Option<String> {
    // Unlike JSON, CBOR represents such numbers. A value that CBOR cannot represent is rejected later by JSON.
    below(&Value::serialized(document).ok()?)
}

/// The failure of a result with a number under `key` that is not finite.
pub(crate) fn not_finite(key: &str) -> Failure {
    Failure::Input(format!(
        "the result `{key}` is not a finite number: check the numbers in the input files, which are too large or do not determine it"
    ))
}

fn below(value: &Value) -> Option<String> {
    match value {
        Value::Float(number) => (!number.is_finite()).then(String::new),
        Value::Array(items) => {
            let mut items = items.iter().enumerate();
            items.find_map(|(index, item)| Some(joined(&format!("[{index}]"), &below(item)?)))
        }
        Value::Map(entries) => {
            let mut entries = entries.iter();
            entries.find_map(|(key, item)| Some(joined(key.as_text()?, &below(item)?)))
        }
        _ => None,
    }
}

fn joined(key: &str, rest: &str) -> String {
    let dot = if rest.is_empty() || rest.starts_with('[') { "" } else { "." };
    format!("{key}{dot}{rest}")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::first_not_finite;

    #[derive(serde::Serialize)]
    #[serde(untagged)]
    enum Shape {
        Plain(f64),
        Named { value: Option<f64> },
    }

    #[derive(serde::Serialize)]
    struct Document {
        name: &'static str,
        shapes: Vec<Shape>,
        by_axis: BTreeMap<String, [f64; 2]>,
    }

    #[test]
    fn the_first_number_that_is_not_finite_is_named() {
        let document = |shape: f64, named: Option<f64>, axis: f64| Document {
            name: "NaN",
            shapes: vec![Shape::Plain(shape), Shape::Named { value: named }],
            by_axis: BTreeMap::from([("X".to_owned(), [0.0, axis])]),
        };
        let cases = [
            (document(1.0, None, 2.0), None),
            (document(f64::NAN, None, 2.0), Some("shapes[0]")),
            (document(1.0, Some(f64::INFINITY), 2.0), Some("shapes[1].value")),
            (document(1.0, Some(0.0), f64::NEG_INFINITY), Some("by_axis.X[1]")),
        ];
        for (document, key) in cases {
            assert_eq!(first_not_finite(&document).as_deref(), key);
        }
    }
}
