//! Plausibility checks of observations before the fit: numbers, sizes, implausible units and directions.
//!
//! Observations that a program builds are checked as well. Limits are stated for usual machine tools and scale with the
//! extent of the rows.

pub(crate) mod result;

use volcomp_document::{CsvTable, InputError, Value};
use volcomp_kinematics::nalgebra::{Matrix3, Vector3};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, MAX_AXES};

use crate::basis::Basis;
use crate::error::{IdentifyError, at};
use crate::observations::{
    MachinePose, Observations, Part, Quantity, Row, RowReading, SetUp, Unknown,
};

/// Minimum and maximum extent of rows to which limits apply without scaling, mm: the extents of nearly all machine
/// tools.
const USUAL_EXTENT_MM: [f64; 2] = [300.0, 2000.0];

/// Minimum scale factor of a limit, for rows that cover only a corner of a machine.
const SMALLEST_FACTOR: f64 = 0.1;

/// The larger of two extents, mm: the diagonal of the box around all coordinates of the linear axes, and the diagonal
/// of the box around all nominal tips in workpiece axes. Both are needed: with the tip on a sphere only the linear axes
/// move, and rotary axes move the tip while the linear axes are at rest.
fn extent_mm<'r>(machine: &Machine, rows: impl Iterator<Item = &'r Row>) -> f64 {
    let is_linear: Vec<bool> =
        (machine.axes().iter()).map(|axis| axis.name.kind() == AxisKind::Linear).collect();
    let mut coordinates = [[f64::INFINITY, f64::NEG_INFINITY]; MAX_AXES];
    let mut tips = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    let grow = |ends: &mut [f64; 2], at: f64| *ends = [ends[0].min(at), ends[1].max(at)];
    for pose in rows.flat_map(Row::poses) {
        let q = coordinates.iter_mut().zip(&pose.state.q).zip(&is_linear);
        q.filter(|(_, is_linear)| **is_linear).for_each(|((ends, q), _)| grow(ends, *q));
        let tip = pose.ideal_tip_mm(machine.chain());
        tips.iter_mut().zip(tip.iter()).for_each(|(ends, at)| grow(ends, *at));
    }
    let diagonal = |ends: &[[f64; 2]]| {
        let squares = ends.iter().map(|[low, high]| (high - low).max(0.0).powi(2));
        squares.sum::<f64>().sqrt()
    };
    diagonal(&coordinates).max(diagonal(&tips))
}

/// Scales a limit for usual machine tools, mm, to the extent of these rows. The result is rounded to two digits for
/// messages.
pub(crate) fn limit_mm<'r>(
    machine: &Machine,
    rows: impl Iterator<Item = &'r Row>,
    usual_mm: f64,
) -> f64 {
    scaled(usual_mm, extent_mm(machine, rows))
}

fn scaled(usual_mm: f64, extent_mm: f64) -> f64 {
    let [small, large] = USUAL_EXTENT_MM;
    let factor = if extent_mm <= 0.0 {
        // A single pose does not show the size of the machine.
        1.0
    } else if extent_mm < small {
        (extent_mm / small).max(SMALLEST_FACTOR)
    } else {
        (extent_mm / large).max(1.0)
    };
    let limit = usual_mm * factor;
    let digit = 10.0_f64.powf(limit.log10().floor() - 1.0);
    ((limit / digit).round() * digit * 1e6).round() / 1e6
}

pub(crate) fn median(sizes: &[f64]) -> f64 {
    let mut sorted = sizes.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or_default()
}

pub(crate) const MAX_DRIFT_ORDER: usize = 12;
pub(crate) const MAX_FOLDS: usize = 100;
/// Maximum number of coefficients of one curve, which is sufficient for any error of an axis.
pub(crate) const MAX_COEFFICIENTS: usize = 60;
/// Maximum order along a second axis, also the maximum number of spline coefficients along it.
pub(crate) const MAX_SECOND_ORDER: usize = 8;
/// Minimum number of coefficients of a spline.
pub(crate) const MIN_SPLINE_COEFFICIENTS: usize = 4;

/// Returns a standard uncertainty, µm, if it is usable as a weight: 1e-6 to 1e6.
///
/// # Errors
/// Another number; the message states the value and the expected range.
pub fn standard_uncertainty_um(found: f64) -> Result<f64, String> {
    const LEAST: f64 = 1e-6;
    const MOST: f64 = 1e6;
    // A value that was converted to mm and back differs by rounding.
    const ROUNDING: f64 = 1e-12;
    if (LEAST * (1.0 - ROUNDING)..=MOST * (1.0 + ROUNDING)).contains(&found) {
        return Ok(found);
    }
    Err(format!("found {found:e} µm, expected {LEAST:e} to {MOST:e} µm"))
}

/// Normalises a direction vector. Errors: a zero vector.
pub(crate) fn unit_vector(value: &Value<'_>) -> Result<Vector3<f64>, InputError> {
    Vector3::from(value.vector::<3>()?)
        .try_normalize(1e-12)
        .ok_or_else(|| value.error("found a zero direction, expected a vector of any other length"))
}

fn wrong(place: String, why: impl Into<String>) -> IdentifyError {
    IdentifyError::Unusable { place, why: why.into() }
}

/// Rejects observations that give no equations. Observations read from a file always pass.
pub(crate) fn check(observations: &Observations) -> Result<(), IdentifyError> {
    if observations.folds > MAX_FOLDS {
        let why = format!("found {}, expected 0 to {MAX_FOLDS}", observations.folds);
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
        Basis::BSpline { coefficients } => (MIN_SPLINE_COEFFICIENTS..=most).contains(&coefficients),
    };
    let refuse = |basis: Basis, most: usize, of: &str| {
        let why = format!(
            "found {basis:?}{of}, expected a curve of at most {most} coefficients, and at least {MIN_SPLINE_COEFFICIENTS} for a spline"
        );
        Err(wrong(unknown.error.to_string(), why))
    };
    match unknown.basis {
        Some(basis) if !within(basis, MAX_COEFFICIENTS) => {
            return refuse(basis, MAX_COEFFICIENTS, "");
        }
        _ => {}
    }
    match unknown.second.map(|second| second.basis) {
        // Orders and harmonics share one limit here, although a harmonic has two coefficients.
        Some(Basis::Fourier { harmonics }) if harmonics <= MAX_SECOND_ORDER => Ok(()),
        Some(basis) if !within(basis, MAX_SECOND_ORDER) => {
            refuse(basis, MAX_SECOND_ORDER, " along the second axis")
        }
        _ => Ok(()),
    }
}

fn check_setup(setup: &SetUp) -> Result<(), IdentifyError> {
    fn quantity<T>(of: &Quantity<T>, numbers: impl Fn(&T) -> bool) -> Result<(), IdentifyError> {
        if of.drift > MAX_DRIFT_ORDER {
            let why =
                format!("found a drift of order {}, expected 0 to {MAX_DRIFT_ORDER}", of.drift);
            return Err(wrong(of.name.clone(), why));
        }
        let within = of.known_within.unwrap_or_default();
        if !of.value.as_ref().is_none_or(numbers) || !within.is_finite() || within < 0.0 {
            let why = "found a value or an uncertainty that is not finite, expected finite numbers";
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
    // A number without a kind has no unit.
    let [kinds, numbers] = [setup.number_kinds.len(), setup.numbers.len()];
    if kinds != numbers {
        let why = format!("found {kinds} kinds for {numbers} numbers, expected one for each");
        return Err(wrong("set-up".to_owned(), why));
    }
    Ok(())
}

fn check_row(file: &str, row: &Row, setup: &SetUp) -> Result<(), IdentifyError> {
    for part in row.reading.parts() {
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
    let has_finite_numbers = |pose: &MachinePose| {
        let mut numbers = pose.state.q.iter().chain(pose.tip_mm.iter());
        numbers.all(|number| number.is_finite())
    };
    let is_finite = match &row.reading {
        RowReading::Point { at_mm: seen, .. } | RowReading::Sphere { offset_mm: seen, .. } => {
            seen.iter().all(|number| number.is_finite())
        }
        RowReading::Distance { length_mm, .. } => length_mm.is_finite(),
        RowReading::Pair { from, length_mm, .. } => {
            has_finite_numbers(from) && length_mm.is_finite()
        }
        RowReading::Line { direction, deviation_mm, .. } => {
            direction.iter().chain([deviation_mm]).all(|n| n.is_finite())
        }
        RowReading::Ball { axes, offset_mm, .. } => {
            let read = offset_mm.iter().flatten();
            axes.iter().chain(read).all(|number| number.is_finite())
        }
    };
    if !is_finite || !has_finite_numbers(&row.pose) || !row.time.is_finite() {
        return refuse("found a coordinate or a reading that is not a finite number".to_owned());
    }
    Ok(())
}

pub(crate) fn refuse_units(
    table: &CsvTable,
    machine: &Machine,
    rows: &[Row],
    setup: &SetUp,
) -> Result<(), InputError> {
    /// Ratio, or its inverse, between the spread of targets and the spread of the tool that indicates another unit: an
    /// inch is about 25 mm.
    const OTHER_UNIT: f64 = 15.0;
    const MIN_MOTION_MM: f64 = 1.0;
    /// Largest difference between a measured and the nominal length between two poses, mm, scaled by [`limit_mm`].
    const MAX_APART_MM: f64 = 5.0;
    /// Permissible additional difference per mm of nominal length, mm.
    const MAX_APART_SHARE: f64 = 2e-3;
    /// Maximum measured length, as a multiple of the diagonal of the travels: no ballbar or tracer is longer.
    const MAX_DIAGONALS: f64 = 20.0;
    let nominal = |pose: &MachinePose| pose.ideal_tip_mm(machine.chain());
    // A machine with rotary axes only has arms of unknown length, so lengths are not limited.
    let diagonal = Some(machine.diagonal_of_travels_mm()).filter(|d| *d > 0.0);
    let diagonal = diagonal.unwrap_or(f64::INFINITY);
    let apart_mm = limit_mm(machine, rows.iter(), MAX_APART_MM);
    let mut seen = Vec::new();
    for row in rows {
        match &row.reading {
            RowReading::Point { at_mm, .. } => seen.push((*at_mm, nominal(&row.pose))),
            RowReading::Pair { from, dead, length_mm } => {
                let dead = &setup.numbers[*dead];
                let expected = (nominal(&row.pose) - nominal(from)).norm();
                let found = length_mm + dead.value.unwrap_or_default();
                if !dead.unknown && (found - expected).abs() > apart_mm + MAX_APART_SHARE * expected
                {
                    return Err(table.error_at(row.line, format!(
                        "found a length of {length_mm} mm between poses that are nominally {expected:.3} mm apart: is it another unit, or are they other poses?"
                    )));
                }
            }
            RowReading::Distance { length_mm, .. } if *length_mm > MAX_DIAGONALS * diagonal => {
                return Err(table.error_at(row.line, format!(
                    "found a length of {length_mm} mm at a machine whose travels are {diagonal:.0} mm from corner to corner, expected mm: is it another unit?"
                )));
            }
            _ => {}
        }
    }
    let spread = |points: &mut dyn Iterator<Item = Vector3<f64>>| {
        let points: Vec<Vector3<f64>> = points.collect();
        let count = points.len().max(1) as f64;
        let middle = points.iter().sum::<Vector3<f64>>() / count;
        let squares = points.iter().map(|point| (point - middle).norm_squared());
        (squares.sum::<f64>() / count).sqrt()
    };
    let found = spread(&mut seen.iter().map(|(found, _)| *found));
    let moved = spread(&mut seen.iter().map(|(_, nominal)| *nominal));
    if moved > MIN_MOTION_MM && !(1.0 / OTHER_UNIT..=OTHER_UNIT).contains(&(found / moved)) {
        return Err(table.header_error(format!(
            "found x, y, z that spread by {found:.3} where the tool spreads by {moved:.3} mm, expected mm: are they in another unit?"
        )));
    }
    Ok(())
}

/// Reason to reject a line of sight that runs neither along its rows (positioning) nor across its rows (straightness).
/// `None` if the line is aligned in one of the two ways, or if the rows are not on a line.
pub(crate) fn oblique(rows: &[Row], direction: &Vector3<f64>, machine: &Machine) -> Option<String> {
    const ALIGNED_DEG: f64 = 1.0;
    /// Largest spread of the rows across their best-fit line, as a fraction of the spread along it, at which they count as straight.
    const STRAIGHT: f64 = 1e-3;
    const MIN_SPREAD_MM: f64 = 1.0;
    let tips = rows.iter().map(|row| row.pose.ideal_tip_mm(machine.chain()));
    let tips: Vec<Vector3<f64>> = tips.collect();
    let count = tips.len() as f64;
    let middle = tips.iter().sum::<Vector3<f64>>() / count;
    let squares: Matrix3<f64> =
        tips.iter().map(|tip| (tip - middle) * (tip - middle).transpose()).sum();
    let found = (squares / count).symmetric_eigen();
    let spread = found.eigenvalues.map(|square| square.max(0.0).sqrt());
    let longest = spread.imax();
    let across = (spread.norm_squared() - spread[longest].powi(2)).max(0.0);
    if across.sqrt() > STRAIGHT * spread[longest] || spread[longest] <= MIN_SPREAD_MM {
        return None;
    }
    let along: Vector3<f64> = found.eigenvectors.column(longest).into();
    let along = along * along.dot(direction).signum();
    let angle_deg = along.dot(direction).min(1.0).acos().to_degrees();
    if angle_deg <= ALIGNED_DEG || angle_deg >= 90.0 - ALIGNED_DEG {
        return None;
    }
    // Rounding first avoids a negative zero in the message.
    let [x, y, z] = along.map(|x| format!("{:.3}", (x * 1e3).round() / 1e3 + 0.0)).into();
    Some(format!(
        "the rows run along [{x}, {y}, {z}] in workpiece axes, {angle_deg:.1} deg from this direction: expected a line of sight along them, or across them for a straightness"
    ))
}

#[cfg(test)]
mod tests {
    use super::scaled;

    #[test]
    fn limits_grow_with_the_extent_of_the_rows() {
        for usual in [0.0, 300.0, 1000.0, 2000.0] {
            for limit in [10.0, 1.0, 0.25, 2.0, 5.0] {
                assert_eq!(scaled(limit, usual), limit, "{usual}");
            }
        }
        assert_eq!(scaled(10.0, 50.0), 1.7);
        assert_eq!(scaled(10.0, 20_000.0), 100.0);
        // Rows in a corner of the machine get the smallest factor.
        assert_eq!(scaled(10.0, 1e-3), 1.0);
    }
}
