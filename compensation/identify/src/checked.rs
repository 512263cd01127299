//! What numbers and sizes observations may have, whether a file states them or a program: one rule for each, and one check of all.

use volcomp_document::{InputError, Value};
use volcomp_kinematics::nalgebra::Vector3;

use crate::{
    basis::Basis,
    error::{IdentifyError, at},
    observations::{Observations, Quantity, Row, Seen, SetUp, Stand, Unknown},
    params::Part,
};

/// The highest order of a drift.
pub(crate) const MOST_DRIFT: usize = 12;
/// The most parts into which poses are divided.
pub(crate) const MOST_FOLDS: usize = 100;
/// More coefficients than this are no error of an axis.
pub(crate) const MOST_COEFFICIENTS: usize = 60;
/// The highest order along a second axis, and the most coefficients of a spline along it.
pub(crate) const MOST_SECOND: usize = 8;
/// The fewest coefficients of a cubic spline.
pub(crate) const LEAST_SPLINE: usize = 4;

/// A standard uncertainty, µm, by which numbers can be weighed.
///
/// # Errors
/// What was found and expected, in words.
pub fn standard_uncertainty_um(found: f64) -> Result<f64, String> {
    const LEAST: f64 = 1e-6;
    const MOST: f64 = 1e6;
    // What was brought to mm and back is off by rounding.
    const ROUNDING: f64 = 1e-12;
    if (LEAST * (1.0 - ROUNDING)..=MOST * (1.0 + ROUNDING)).contains(&found) {
        return Ok(found);
    }
    Err(format!(
        "found {found:e} µm, expected {LEAST:e} to {MOST:e} µm"
    ))
}

/// The direction of a vector of any length.
pub(crate) fn unit_vector(value: &Value<'_>) -> Result<Vector3<f64>, InputError> {
    Vector3::from(value.vector::<3>()?)
        .try_normalize(1e-12)
        .ok_or_else(|| value.error("found a zero direction, expected a vector of any other length"))
}

fn wrong(place: String, why: impl Into<String>) -> IdentifyError {
    IdentifyError::Unusable {
        place,
        why: why.into(),
    }
}

/// Refuses observations of which no equations can be made; a file that was read has none of this.
pub(crate) fn check(observations: &Observations) -> Result<(), IdentifyError> {
    if observations.folds > MOST_FOLDS {
        let why = format!("found {}, expected 0 to {MOST_FOLDS}", observations.folds);
        return Err(wrong("folds".to_owned(), why));
    }
    for unknown in &observations.unknown {
        check_unknown(unknown)?;
    }
    check_setup(&observations.setup)?;
    for observation in &observations.observations {
        for row in &observation.rows {
            check_row(&observation.file, row, &observations.setup)?;
        }
    }
    Ok(())
}

fn check_unknown(unknown: &Unknown) -> Result<(), IdentifyError> {
    let within = |basis: Basis, most: usize| match basis {
        Basis::Constant => true,
        Basis::Legendre { order } => order <= most,
        Basis::Fourier { harmonics } => harmonics <= most / 2,
        Basis::BSpline { coefficients } => (LEAST_SPLINE..=most).contains(&coefficients),
    };
    let refuse = |basis: Basis, most: usize, of: &str| {
        let why = format!(
            "found {basis:?}{of}, expected a curve of at most {most} coefficients, and of {LEAST_SPLINE} at the least for a spline"
        );
        Err(wrong(unknown.error.to_string(), why))
    };
    match unknown.basis {
        Some(basis) if !within(basis, MOST_COEFFICIENTS) => {
            return refuse(basis, MOST_COEFFICIENTS, "");
        }
        _ => {}
    }
    match unknown.second.map(|second| second.basis) {
        // A harmonic has two coefficients; orders and harmonics go up to the same number here.
        Some(Basis::Fourier { harmonics }) if harmonics <= MOST_SECOND => Ok(()),
        Some(basis) if !within(basis, MOST_SECOND) => {
            refuse(basis, MOST_SECOND, " along the second axis")
        }
        _ => Ok(()),
    }
}

fn check_setup(setup: &SetUp) -> Result<(), IdentifyError> {
    fn quantity<T>(of: &Quantity<T>, numbers: impl Fn(&T) -> bool) -> Result<(), IdentifyError> {
        if of.drift > MOST_DRIFT {
            let why = format!(
                "found a drift of order {}, expected 0 to {MOST_DRIFT}",
                of.drift
            );
            return Err(wrong(of.name.clone(), why));
        }
        let within = of.known_within.unwrap_or_default();
        if !of.value.as_ref().is_none_or(numbers) || !within.is_finite() || within < 0.0 {
            let why = "found a value or an uncertainty that is no number, expected finite ones";
            return Err(wrong(of.name.clone(), why));
        }
        Ok(())
    }
    let finite = |numbers: &[f64]| numbers.iter().all(|number| number.is_finite());
    for frame in &setup.frames {
        quantity(frame, |six| finite(six))?;
    }
    for point in &setup.points {
        quantity(point, |three| finite(three))?;
    }
    for number in &setup.numbers {
        quantity(number, |one| one.is_finite())?;
    }
    // Without its kind a number has no unit.
    let [kinds, numbers] = [setup.number_kinds.len(), setup.numbers.len()];
    if kinds != numbers {
        let why = format!("found {kinds} kinds of {numbers} numbers, expected one for each");
        return Err(wrong("set-up".to_owned(), why));
    }
    Ok(())
}

fn check_row(file: &str, row: &Row, setup: &SetUp) -> Result<(), IdentifyError> {
    for part in row.seen.parts() {
        let (what, count, found) = match part {
            Part::Frame(place) => ("frames", setup.frames.len(), place),
            Part::Point(place) => ("points", setup.points.len(), place),
            Part::Number(place) => ("numbers", setup.numbers.len(), place),
        };
        if found >= count {
            return Err(IdentifyError::NoSuchPlace {
                file: file.to_owned(),
                line: row.line,
                what,
                found,
                count,
            });
        }
    }
    let refuse = |why: String| Err(wrong(at(file, row.line), why));
    if let Err(why) = standard_uncertainty_um(row.uncertainty_mm * 1e3) {
        return refuse(format!("the standard uncertainty: {why}"));
    }
    let stands = |stand: &Stand| {
        let mut numbers = stand.state.q.iter().chain(stand.tip_mm.iter());
        numbers.all(|number| number.is_finite())
    };
    let is_finite = match &row.seen {
        Seen::Point { at_mm: seen, .. }
        | Seen::Sphere {
            offset_mm: seen, ..
        } => seen.iter().all(|number| number.is_finite()),
        Seen::Distance { length_mm, .. } => length_mm.is_finite(),
        Seen::Pair {
            from, length_mm, ..
        } => stands(from) && length_mm.is_finite(),
        Seen::Line {
            direction,
            deviation_mm,
            ..
        } => direction
            .iter()
            .chain([deviation_mm])
            .all(|n| n.is_finite()),
        Seen::Ball {
            axes, offset_mm, ..
        } => {
            let read = offset_mm.iter().flatten();
            axes.iter().chain(read).all(|number| number.is_finite())
        }
    };
    if !is_finite || !stands(&row.stand) || !row.time.is_finite() {
        return refuse("found a coordinate or a reading that is no finite number".to_owned());
    }
    Ok(())
}
