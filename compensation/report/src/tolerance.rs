//! Tolerances and how figures stand against them.

use volcomp_vocabulary::ErrorName;

use crate::report::{Check, Outcome, Report};

/// The figures of ISO 230-2 that a tolerance can name.
pub const SYMBOLS: [&str; 5] = ["A", "R", "E", "M", "B"];

/// The largest error of position over the working space, beside the best rigid motion of the workpiece.
pub const VOLUME: &str = "V";

/// A figure and the most that is allowed, µm or µrad.
#[derive(Clone, Debug, PartialEq)]
pub struct Tolerance {
    /// What has to be within: a symbol of [`SYMBOLS`], [`VOLUME`], or the name of an error.
    pub of: Figure,
    /// The most that is allowed.
    pub limit: f64,
}

/// A figure that can have a tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Figure {
    /// A figure of ISO 230-2, of every positioning test.
    Positioning(&'static str),
    /// The size of a squareness or of another location error; of an error motion the range of its mean readings or, without
    /// readings, of its curve.
    Error(ErrorName),
    /// The largest error of position over the working space beside the best rigid motion of the workpiece: after a
    /// compensation where that is known.
    Volume,
}

/// Why a list of tolerances cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ToleranceError {
    /// A part is no `NAME=NUMBER`.
    #[error("found `{0}`, expected NAME=NUMBER: A=10,EC0Y=20")]
    Form(String),
    /// The name is none that can have a tolerance.
    #[error("found `{0}`, expected A, R, E, M, B, V or the name of an error as EYX or EC0Y")]
    Name(String),
    /// The limit is no number above 0.
    #[error("{name}: found `{found}`, expected a number above 0, in µm or µrad")]
    Limit {
        /// The name before it.
        name: String,
        /// The text that should be a number.
        found: String,
    },
    /// A name is there twice.
    #[error("{0} is there twice, expected one tolerance for it")]
    Twice(String),
}

/// Reads `A=10,EC0Y=20`: µm of what is a length, µrad of what is an angle.
///
/// # Errors
/// The first part that cannot be read.
pub fn tolerances(text: &str) -> Result<Vec<Tolerance>, ToleranceError> {
    let mut found: Vec<Tolerance> = Vec::new();
    for part in text.split(',').map(str::trim) {
        let form = || ToleranceError::Form(part.to_owned());
        let (name, number) = part.split_once('=').ok_or_else(form)?;
        let (name, number) = (name.trim(), number.trim());
        let symbol = SYMBOLS.into_iter().find(|symbol| *symbol == name);
        let of = match (symbol, name) {
            (Some(symbol), _) => Figure::Positioning(symbol),
            (None, VOLUME) => Figure::Volume,
            (None, _) => match name.parse() {
                Ok(error) => Figure::Error(error),
                Err(_) => return Err(ToleranceError::Name(name.to_owned())),
            },
        };
        let limit: f64 = number.parse().unwrap_or(f64::NAN);
        if !(limit > 0.0 && limit.is_finite()) {
            let (name, found) = (name.to_owned(), number.to_owned());
            return Err(ToleranceError::Limit { name, found });
        }
        if found.iter().any(|tolerance| tolerance.of == of) {
            return Err(ToleranceError::Twice(name.to_owned()));
        }
        found.push(Tolerance { of, limit });
    }
    Ok(found)
}

/// How the figures of a report stand against tolerances, in the order of these. A tolerance whose figure nothing gives is not
/// evaluated, and that is said.
pub fn checks(report: &Report, tolerances: &[Tolerance]) -> Vec<Check> {
    let mut all = Vec::new();
    for tolerance in tolerances {
        let check = |symbol: &str, of: String, value: Option<f64>, unit: &str| Check {
            symbol: symbol.to_owned(),
            of,
            value: value.filter(|value| value.is_finite()),
            limit: tolerance.limit,
            unit: unit.to_owned(),
            outcome: match value.filter(|value| value.is_finite()) {
                Some(value) if value <= tolerance.limit => Outcome::Pass,
                Some(_) => Outcome::Fail,
                None => Outcome::NotEvaluated,
            },
        };
        match tolerance.of {
            Figure::Positioning(symbol) => {
                let tests = report.positioning.iter();
                all.extend(tests.map(|test| {
                    let of = format!("{}, {}", test.error, test.file);
                    check(symbol, of, test.figure(symbol), &test.unit)
                }));
                if report.positioning.is_empty() {
                    all.push(check(symbol, String::new(), None, "µm"));
                }
            }
            Figure::Error(error) => {
                let name = error.to_string();
                let value = of_error(report, &name);
                all.push(check(&name, String::new(), value, error.component.symbol()));
            }
            Figure::Volume => {
                let volume = report.volume.as_ref();
                let size = volume.map(|v| v.after.unwrap_or(v.before).1.form_max_um);
                all.push(check(VOLUME, String::new(), size, "µm"));
            }
        }
    }
    all
}

/// The size of an error.
fn of_error(report: &Report, name: &str) -> Option<f64> {
    if let Some(curve) = report.curves.iter().find(|curve| curve.error == name) {
        let means = curve
            .lines
            .iter()
            .flat_map(|line| line.means.iter().flatten());
        let mut values: Vec<f64> = means.map(|point| point.1).collect();
        if values.is_empty() {
            let points = curve.branches.iter().flat_map(|branch| &branch.points);
            values = points.map(|point| point.1).collect();
        }
        let largest = values.iter().copied().reduce(f64::max)?;
        return Some(largest - values.iter().copied().reduce(f64::min)?);
    }
    let mut squares = report.squareness.iter().flat_map(|square| &square.from);
    if let Some((_, value)) = squares.find(|(from, _)| from == name) {
        return Some(value.abs());
    }
    let mut locations = report.locations.iter();
    locations
        .find(|location| location.error == name)
        .map(|location| location.value.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_limits_are_read() {
        let found = tolerances("A=10, EC0Y=20,V=1.5").expect("three");
        let limits: Vec<f64> = found.iter().map(|tolerance| tolerance.limit).collect();
        assert_eq!(limits, [10.0, 20.0, 1.5]);
        assert_eq!(found[0].of, Figure::Positioning("A"));
        assert_eq!(found[2].of, Figure::Volume);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, said) in [
            ("A", "found `A`, expected NAME=NUMBER"),
            ("Q=1", "found `Q`, expected A, R, E, M, B, V or"),
            ("A=-1", "A: found `-1`"),
            ("A=inf", "A: found `inf`"),
            ("A=1,A=2", "A is there twice"),
            ("", "found ``"),
        ] {
            let message = tolerances(text).expect_err(text).to_string();
            assert!(message.starts_with(said), "{message}");
        }
    }
}
