//! Tolerances, and figures checked against them.

use volcomp_metrology::{
    Edition, MetrologyError, MotionKind, Tolerance, Vdi3441, Verdict, decide, parse_tolerances_of,
};
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::{
    build::pair_of,
    report::{Check, CheckOf, Curve, Drawn, Positioning, Report, Square, State, VOLUME},
};

/// Parses `A=10,C.A=30,EC0Y=20`: µm for lengths, µrad for angles. A name is one of: a symbol of ISO 230-2 or VDI/DGQ 3441, for all
/// positioning tests, those of an axis (`C.A`) or of an error (`EXX.A`); [`VOLUME`]; an error name, for the absolute value of a location
/// error or for the range of an error motion (of its mean readings or, without readings, of its curve).
///
/// # Errors
/// The first part that is invalid.
pub fn tolerances(text: &str) -> Result<Vec<Tolerance>, MetrologyError> {
    let symbols = symbols();
    let named = |name: &str| {
        let (of, symbol) = parts(name);
        let is_symbol = symbols.contains(&symbol) && of.is_none_or(is_axis_or_positioning);
        let is_error = || name.parse::<ErrorName>().is_ok();
        (is_symbol || name == VOLUME || is_error()).then(|| name.to_owned())
    };
    let expected = format!(
        "{}, one of these of an axis or an error as C.A or EXX.A, {VOLUME} or the name of an error as EYX or EC0Y",
        symbols.join(", ")
    );
    parse_tolerances_of(text, named, &expected)
}

fn parts(name: &str) -> (Option<&str>, &str) {
    match name.split_once('.') {
        Some((of, symbol)) => (Some(of), symbol),
        None => (None, name),
    }
}

fn is_axis_or_positioning(of: &str) -> bool {
    let positioning =
        |error: ErrorName| !error.location && MotionKind::of(error) == MotionKind::Positioning;
    of.parse::<AxisName>().is_ok() || of.parse().is_ok_and(positioning)
}

fn is_of(test: &Positioning, of: Option<&str>) -> bool {
    let axis = || test.error.parse::<ErrorName>().map(|error| error.axis.to_string());
    of.is_none_or(|of| test.error == of || axis().is_ok_and(|axis| axis == of))
}

/// Positioning tests to which a tolerance applies: the test of the named error, the tests of the named axis, or all
/// tests. A test with a more specific tolerance for the same symbol is excluded.
fn tests_of<'r>(
    report: &'r Report,
    tolerances: &[Tolerance],
    tolerance: &Tolerance,
) -> Vec<&'r Positioning> {
    let (of, symbol) = parts(&tolerance.symbol);
    // The name of an axis has one letter, that of an error more.
    let narrowness = |of: Option<&str>| of.map_or(0, str::len);
    let has_narrower = |test: &Positioning| {
        tolerances.iter().any(|other| {
            let (other_of, other) = parts(&other.symbol);
            other == symbol && narrowness(other_of) > narrowness(of) && is_of(test, other_of)
        })
    };
    let tests = report.positioning.iter();
    tests.filter(|test| is_of(test, of) && !has_narrower(test)).collect()
}

/// Rejects a limit that would apply both to linear axes in µm and to rotary axes in µrad.
///
/// # Errors
/// The first such tolerance.
pub fn refuse_two_units(report: &Report, tolerances: &[Tolerance]) -> Result<(), MetrologyError> {
    let symbols = symbols();
    for tolerance in tolerances {
        if !symbols.contains(&tolerance.symbol.as_str()) {
            continue;
        }
        let tests = tests_of(report, tolerances, tolerance);
        let of_unit = |unit: &str| tests.iter().find(|test| test.unit == unit);
        let Some((length, angle)) = of_unit("µm").zip(of_unit("µrad")) else {
            continue;
        };
        let axis = |test: &Positioning| test.error.chars().last().map(String::from);
        let (symbol, limit) = (&tolerance.symbol, tolerance.limit);
        return Err(MetrologyError::Readings {
            name: "tolerance".into(),
            what: symbol.clone(),
            found: format!("{limit} for {} (µm) and for {} (µrad)", length.error, angle.error),
            expected: format!(
                "one limit for each kind: {symbol}={limit} stays for the rest where the others have their own, {}.{symbol}=… or {}.{symbol}=…",
                axis(angle).unwrap_or_default(),
                angle.error
            ),
        });
    }
    Ok(())
}

fn symbols() -> Vec<&'static str> {
    [&Edition::symbols()[..], &Vdi3441::symbols()].concat()
}

/// Checks the figures of a report against tolerances, in the order of the tolerances. A tolerance without a figure is reported as not
/// evaluated.
pub fn checks(report: &Report, tolerances: &[Tolerance]) -> Vec<Check> {
    let symbols = symbols();
    let mut all = Vec::new();
    for tolerance in tolerances {
        let symbol = tolerance.symbol.as_str();
        let mut check = |of: CheckOf, value: Option<f64>, u: Option<f64>, unit: &str| {
            let value = value.filter(|value| value.is_finite());
            let uncertainty = u.filter(|_| value.is_some());
            let outcome = match decide(value, tolerance.limit, uncertainty) {
                // At another temperature the figure would differ, and an undetermined error or an unknown
                // scatter may have any size.
                Verdict::Pass
                    if matches!(
                        of,
                        CheckOf::AtReference | CheckOf::NotConfirmed | CheckOf::ScatterUnknown
                    ) =>
                {
                    Verdict::Undecided
                }
                outcome => outcome,
            };
            all.push(Check {
                symbol: symbol.to_owned(),
                of,
                value,
                limit: tolerance.limit,
                unit: unit.to_owned(),
                uncertainty,
                without_uncertainty: without_uncertainty(report, symbol).to_owned(),
                outcome,
            });
        };
        let (of, figure) = parts(symbol);
        if symbols.contains(&figure) {
            for test in tests_of(report, tolerances, tolerance) {
                let of = CheckOf::Test { error: test.error.clone(), file: test.file.clone() };
                check(of, test.figure(figure), test.uncertainty(figure), &test.unit);
            }
            if !report.positioning.iter().any(|test| is_of(test, of)) {
                let axis = of.and_then(|of| AxisName::from_letter(of.chars().last()?));
                let is_rotary = axis.is_some_and(AxisName::is_rotary);
                check(CheckOf::Symbol, None, None, if is_rotary { "µrad" } else { "µm" });
            }
        } else if symbol == VOLUME {
            let volume = report.volume.as_ref();
            let last = volume.map(|volume| volume.after.as_ref().unwrap_or(&volume.before));
            // The Monte Carlo samples are those of the identified errors.
            let found = last.filter(|last| last.state == State::Found);
            let drawn = drawn(report).filter(|_| found.is_some());
            // If no uncertainty is known, all samples are equal.
            let u = drawn.map(|drawn| 2.0 * drawn.max_um).filter(|u| *u > 0.0);
            // If no error of the machine is known, there is no verdict.
            let value = last.filter(|last| match last.state {
                State::Found => report.knows_errors(),
                _ => volume.is_some_and(|volume| volume.knows_errors),
            });
            let is_partly = volume.is_some_and(|volume| volume.is_partly_measured)
                || found.is_some() && !report.not_measured.is_empty();
            let of = if value.is_some() && volume.is_some_and(|volume| volume.has_thermal) {
                CheckOf::AtReference
            } else if value.is_some() && volume.is_some_and(|volume| !volume.undecided.is_empty()) {
                CheckOf::NotConfirmed
            } else if drawn.is_some() && !report.without_scatter.is_empty() {
                CheckOf::ScatterUnknown
            } else if value.is_some() && is_partly {
                CheckOf::MeasuredAlone
            } else if last.is_some_and(|last| last.state == State::TruthCorrected) {
                CheckOf::Corrected
            } else {
                CheckOf::Symbol
            };
            check(of, value.map(|last| last.found.form_max_um), u, "µm");
        } else if let Ok(error) = symbol.parse::<ErrorName>() {
            let (value, u) = of_error(report, symbol);
            let of = of_error_on(report, error);
            check(of, value, u, error.component.symbol());
        }
    }
    all
}

/// Why a figure without an uncertainty has none. The Monte Carlo samples, drawn on request from the readings, are those of the machine found, not of a
/// corrected one.
fn without_uncertainty(report: &Report, symbol: &str) -> &'static str {
    let volume = report.volume.as_ref().filter(|_| symbol == VOLUME);
    let can_draw = !report.head.files.is_empty() && drawn(report).is_none();
    match volume.map(|volume| volume.after.as_ref().unwrap_or(&volume.before).state) {
        Some(State::Found) if can_draw => "uncertainty not evaluated: --trials",
        None | Some(State::Found) => "no uncertainty given",
        Some(_) => "the uncertainty of what a correction leaves is not evaluated",
    }
}

fn drawn(report: &Report) -> Option<&Drawn> {
    report.uncertainty.as_ref()?.drawn.as_ref()
}

fn of_error_on(report: &Report, error: ErrorName) -> CheckOf {
    let name = error.to_string();
    // The range of mean readings does not depend on the curve.
    let mut curves = report.curves.iter();
    let is_of_readings = curves.any(|of| of.error == name && !of.lines.is_empty());
    // The tolerance of a squareness may name either axis of the pair.
    let pair = pair_of(error).filter(|_| error.location);
    let is_it = |of: ErrorName| of == error || of.location && pair.is_some() && pair_of(of) == pair;
    let mut undecided = report.undecided.iter().filter_map(|of| of.parse().ok());
    if !is_of_readings && undecided.any(is_it) {
        CheckOf::NotConfirmed
    } else if identified(report, &name).is_some() && !report.without_scatter.is_empty() {
        CheckOf::ScatterUnknown
    } else if report.partly_measured.contains(&name) {
        CheckOf::Part
    } else {
        CheckOf::Symbol
    }
}

/// Size of an error and its expanded uncertainty (k = 2); `None` if it is not determined, or if no contribution is known.
fn of_error(report: &Report, name: &str) -> (Option<f64>, Option<f64>) {
    let found = report.identified.as_ref();
    if found.is_some_and(|of| of.leaves_open(name)) {
        return (None, None);
    }
    if let Some(curve) = report.curves.iter().find(|curve| curve.error == name) {
        if curve.has_other_axes || curve.lines.is_empty() {
            let [low, high] = curve.range;
            return (Some(high - low), None);
        }
        return match extremes(curve) {
            Some([low, high]) => {
                let u = of_range(report, curve, high.0 - low.0);
                (Some(high.1 - low.1), u.map(|u| 2.0 * u))
            }
            None => (None, None),
        };
    }
    if report.has_assembly {
        return (None, None);
    }
    let mut squares = report.squareness.iter();
    let square = squares.find_map(|square| {
        let of = square.from.iter().find(|from| from.error == name);
        // The angle of the pair may be assigned to its other axis.
        of.map(|from| (square, from.urad.abs().max(square.angle_urad.abs())))
    });
    if let Some((square, value)) = square {
        return (Some(value), of_square(report, square, name).map(|u| 2.0 * u));
    }
    let mut locations = report.locations.iter();
    let location = locations.find(|location| location.error == name);
    let u = location.and_then(|location| location.uncertainty);
    let u = u.or_else(|| identified(report, name));
    let value = location.map(|location| location.value.abs());
    (value, u.filter(|_| value.is_some()).map(|u| 2.0 * u))
}

/// Smallest and largest mean reading, each with its position; `None` if there are too few targets for two readings to differ (for a
/// straightness after removal of the fitted line).
fn extremes(curve: &Curve) -> Option<[(f64, f64); 2]> {
    let means = curve.lines.iter().flat_map(|line| line.means.iter().flatten());
    let points: Vec<(f64, f64)> = means.copied().collect();
    let mut targets: Vec<f64> = points.iter().map(|(x, _)| *x).collect();
    targets.sort_unstable_by(f64::total_cmp);
    targets.dedup();
    let error = curve.error.parse::<ErrorName>();
    let is_straightness = error.is_ok_and(|of| MotionKind::of(of) == MotionKind::Straightness);
    if targets.len() < 2 + usize::from(is_straightness) {
        return None;
    }
    let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
    let (low, high) = (points.iter().min_by(by_value)?, points.iter().max_by(by_value)?);
    Some([*low, *high])
}

fn stated(report: &Report, key: &str) -> Option<f64> {
    let of = report.uncertainty.as_ref()?;
    let mut stated = of.stated.iter();
    stated.find(|of| of.key == key).map(|of| of.standard)
}

/// Standard uncertainty of the range of mean readings: the uncertainty of two readings and, for a length, the scale
/// uncertainty over the distance `apart` between them, mm. `None` without contributions, and for curves derived from
/// other readings (summed tilts, other errors).
fn of_range(report: &Report, curve: &Curve, apart: f64) -> Option<f64> {
    let direct = |line: &crate::report::CurveLine| !line.runs.is_empty();
    if !curve.lines.iter().all(direct) {
        return None;
    }
    let name = curve.error.parse::<ErrorName>().ok()?;
    let is_angular = name.component.is_angular();
    let key = if is_angular { "reading_urad" } else { "reading_um" };
    let reading = stated(report, key);
    let is_length = !is_angular && MotionKind::of(name) == MotionKind::Positioning;
    let scale = stated(report, "laser_um_per_m").filter(|_| is_length);
    if reading.is_none() && scale.is_none() {
        return None;
    }
    let of_readings = core::f64::consts::SQRT_2 * reading.unwrap_or_default();
    let of_scale = scale.unwrap_or_default() * 1e-3 * apart.abs();
    Some(of_readings.hypot(of_scale))
}

/// Standard uncertainty of a squareness, µrad: from the identification if the squareness was
/// identified, otherwise from its straightness lines and reference angle.
fn of_square(report: &Report, square: &Square, name: &str) -> Option<f64> {
    let mut from = square.from.iter();
    let of_lines = || from.find(|of| of.error == name)?.uncertainty;
    identified(report, name).or_else(of_lines)
}

fn identified(report: &Report, name: &str) -> Option<f64> {
    let found = report.identified.as_ref()?;
    let mut parameters = found.parameters.iter();
    let of_statements = parameters.find(|of| of.name == name)?.uncertainty?;
    // If the residual of the observations exceeds their uncertainty, the uncertainty of the unknowns is scaled by the same factor.
    Some(of_statements * found.excess)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_limits_are_read() {
        let found =
            tolerances("A=10, EC0Y=20,V=1.5,P=3,R_forward=2,C.A=30,EXX.B=4").expect("seven");
        let limits: Vec<f64> = found.iter().map(|tolerance| tolerance.limit).collect();
        assert_eq!(limits, [10.0, 20.0, 1.5, 3.0, 2.0, 30.0, 4.0]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, said) in [
            ("A", "part"),
            ("Q=1", "found `Q`, expected A, A_forward,"),
            ("A=-1", "limit of A: found `-1`"),
            ("A=inf", "limit of A: found `inf`"),
            ("A=1,A=2", "expected each symbol once"),
            ("EYX.A=1", "found `EYX.A`"),
            ("X.V=1", "found `X.V`"),
            (".A=1", "found `.A`"),
            ("", "found ``"),
        ] {
            let message = tolerances(text).expect_err(text).to_string();
            assert!(message.contains(said), "{message}");
        }
    }
}
