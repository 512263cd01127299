//! Tolerances and how figures stand against them.

use volcomp_metrology::{Edition, MetrologyError, Tolerance, Vdi3441, decide, parse_tolerances_of};
use volcomp_vocabulary::ErrorName;

use crate::report::{Check, Report, State};

/// The largest error of position over the working space, beside the best rigid motion of the workpiece.
pub const VOLUME: &str = "V";

/// Reads `A=10,EC0Y=20`: µm of what is a length, µrad of what is an angle. A name is a symbol of ISO 230-2 or VDI/DGQ 3441, which is
/// of every positioning test, [`VOLUME`], or that of an error: of a location error its size, of an error motion the range of its mean
/// readings or, without readings, of its curve.
///
/// # Errors
/// The first part that cannot be read.
pub fn tolerances(text: &str) -> Result<Vec<Tolerance>, MetrologyError> {
    let symbols = symbols();
    let named = |name: &str| {
        let symbol = symbols.iter().find(|symbol| **symbol == name);
        let is_error = || name.parse::<ErrorName>().is_ok();
        (symbol.is_some() || name == VOLUME || is_error()).then(|| name.to_owned())
    };
    let expected = format!(
        "{}, {VOLUME} or the name of an error as EYX or EC0Y",
        symbols.join(", ")
    );
    parse_tolerances_of(text, named, &expected)
}

/// The symbols of positioning tests.
fn symbols() -> Vec<&'static str> {
    [&Edition::symbols()[..], &Vdi3441::symbols()].concat()
}

/// How the figures of a report stand against tolerances, in the order of these. A tolerance whose figure nothing gives is not
/// evaluated, and that is said.
pub fn checks(report: &Report, tolerances: &[Tolerance]) -> Vec<Check> {
    let symbols = symbols();
    let mut all = Vec::new();
    for tolerance in tolerances {
        let symbol = tolerance.symbol.as_str();
        let mut check = |of: String, value: Option<f64>, u: Option<f64>, unit: &str| {
            let value = value.filter(|value| value.is_finite());
            let uncertainty = u.filter(|_| value.is_some());
            all.push(Check {
                symbol: symbol.to_owned(),
                of,
                value,
                limit: tolerance.limit,
                unit: unit.to_owned(),
                uncertainty,
                outcome: decide(value, tolerance.limit, uncertainty),
            });
        };
        if symbols.contains(&symbol) {
            for test in &report.positioning {
                let of = format!("{}, {}", test.error, test.file);
                check(
                    of,
                    test.figure(symbol),
                    test.uncertainty(symbol),
                    &test.unit,
                );
            }
            if report.positioning.is_empty() {
                check(String::new(), None, None, "µm");
            }
        } else if symbol == VOLUME {
            let volume = report.volume.as_ref();
            let last = volume.map(|volume| volume.after.unwrap_or(volume.before));
            // The machines that were drawn are those of the errors that were found.
            let drawn = report.uncertainty.as_ref().filter(|found| found.trials > 0);
            let found = last.filter(|(state, _)| *state == State::Found);
            let u = drawn
                .filter(|_| found.is_some())
                .map(|drawn| 2.0 * drawn.max_um);
            check(String::new(), last.map(|last| last.1.form_max_um), u, "µm");
        } else if let Ok(error) = symbol.parse::<ErrorName>() {
            let (value, u) = of_error(report, symbol);
            check(String::new(), value, u, error.component.symbol());
        }
    }
    all
}

/// The size of an error, and its expanded uncertainty where it is stated.
fn of_error(report: &Report, name: &str) -> (Option<f64>, Option<f64>) {
    let location = report
        .locations
        .iter()
        .find(|location| location.error == name);
    let u = location.and_then(|location| location.uncertainty);
    (size_of_error(report, name), u.map(|u| 2.0 * u))
}

fn size_of_error(report: &Report, name: &str) -> Option<f64> {
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
        let found = tolerances("A=10, EC0Y=20,V=1.5,P=3,R_forward=2").expect("five");
        let limits: Vec<f64> = found.iter().map(|tolerance| tolerance.limit).collect();
        assert_eq!(limits, [10.0, 20.0, 1.5, 3.0, 2.0]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, said) in [
            ("A", "part"),
            ("Q=1", "found `Q`, expected A, A_forward,"),
            ("A=-1", "limit of A: found `-1`"),
            ("A=inf", "limit of A: found `inf`"),
            ("A=1,A=2", "expected each symbol once"),
            ("", "found ``"),
        ] {
            let message = tolerances(text).expect_err(text).to_string();
            assert!(message.contains(said), "{message}");
        }
    }
}
