//! Error motions: their kind with respect to the axis, and their names in titles and file names.

use volcomp_document::quoted;
use volcomp_vocabulary::{AxisKind, ErrorName};

use crate::{DeviationUnit, Measurement};

/// Kind of an error motion with respect to its axis. It determines the method of measurement and the reference that is
/// removed from the readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum MotionKind {
    /// Deviation of the coordinate itself, such as EXX of a linear axis and ECC of a rotary axis.
    Positioning,
    /// Deviation of a linear axis perpendicular to its direction, such as EYX.
    Straightness,
    /// Angular error of a linear axis (EAX), or any error of a rotary axis except positioning (EXC, EAC).
    Other,
}

impl MotionKind {
    /// Kind of an error, by its component and axis. A location error has the kind of the error motion with the same
    /// component.
    pub fn of(error: ErrorName) -> Self {
        let own = error.component.mcs_index() == error.axis.mcs_index();
        match (error.axis.kind(), error.component.is_angular()) {
            (AxisKind::Linear, false) | (AxisKind::Rotary, true) if own => Self::Positioning,
            (AxisKind::Linear, false) => Self::Straightness,
            _ => Self::Other,
        }
    }
}

/// All errors named in a text (title, location or file name), in the order of the words, in upper or lower case. `EYX
/// at Z-150` names EYX. The location error of a squareness may be written `EC0Y` or `EC(0X)Y`.
pub fn errors_named(text: &str) -> Vec<ErrorName> {
    let error = |word: &str| -> Option<ErrorName> {
        let word = word.to_ascii_uppercase();
        // `C0Y` would also parse as an error, but in a title it may be any word.
        word.parse().ok().filter(|_| word.starts_with('E'))
    };
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || "()".contains(c)));
    words
        .flat_map(|word| match error(word) {
            Some(error) => vec![error],
            // The name may be in brackets, as in `(EXY)`, or have brackets, as in `exx(1)`.
            None => word.split(['(', ')']).filter_map(error).collect(),
        })
        .collect()
}

/// The error that the title of a file names, if it names only one.
pub fn error_in_title(measurement: &Measurement) -> Option<ErrorName> {
    let mut named = errors_named(measurement.metadata.title.as_deref().unwrap_or_default());
    named.dedup();
    match named[..] {
        [error] => Some(error),
        _ => None,
    }
}

/// The error other than positioning that the title names, such as a straightness, and a message: ISO 230-2 does not
/// evaluate such a file. `None` for angles of a linear axis in µrad, which it evaluates as an angular error motion.
pub fn not_positioning(
    measurement: &Measurement,
    unit: DeviationUnit,
) -> Option<(ErrorName, String)> {
    let error = error_in_title(measurement)?;
    let is_angle = error.component.is_angular() && error.axis.kind() == AxisKind::Linear;
    let what = match MotionKind::of(error) {
        MotionKind::Positioning if !error.location => return None,
        _ if is_angle && unit == DeviationUnit::Urad => return None,
        MotionKind::Straightness if !error.location => "a straightness",
        _ if is_angle => "an angle",
        _ => "no positioning",
    };
    let title = quoted(measurement.metadata.title.as_deref().unwrap_or_default());
    let message =
        format!("found the title {title}, which names {error}, {what}; expected positioning");
    Some((error, message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_names_are_whole_words() {
        for (text, names) in [
            ("EXY straightness, table", "EXY"),
            ("exx(1)-y200", "EXX"),
            ("(EYX) and EC(0X)Y", "EYX EC0Y"),
            ("FLEXYTHING EXQ C0Y, text", ""),
        ] {
            let found: Vec<String> = errors_named(text).iter().map(ToString::to_string).collect();
            assert_eq!(found.join(" "), names, "{text}");
        }
    }
}
