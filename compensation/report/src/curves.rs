//! Error curves of a report: those of a calibration with their readings, and those of a machine file.

use std::collections::HashMap;

use volcomp_calibrate::{Calibration, CalibrationFile, FittedCurve, FittedLine, Method, Quality};
use volcomp_metrology::{Measurement, MotionKind};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, Direction, ErrorName};

use crate::report::{Band, Branch, Curve, CurveLine, FitNumbers, Residual, Run};

const POINTS: usize = 241;

/// Curves of all errors of a machine: the fitted ones in the order of the calibration, then those of the machine file.
pub(crate) fn curves(file: &CalibrationFile, calibration: &Calibration) -> Vec<Curve> {
    let machine = &calibration.machine;
    let mut names: Vec<ErrorName> = Vec::new();
    for curve in &calibration.curves {
        if !names.contains(&curve.error) {
            names.push(curve.error);
        }
    }
    let fitted = names.iter().filter_map(|error| {
        let lines: Vec<&FittedLine> =
            calibration.lines.iter().filter(|l| l.error == *error).collect();
        let fits: Vec<&FittedCurve> =
            calibration.curves.iter().filter(|c| c.error == *error).collect();
        of_error(machine, *error, file, &lines, &fits)
    });
    let mut all: Vec<Curve> = fitted.collect();
    let others = machine.errors().map(|(error, _)| error);
    let others = others.filter(|error| !names.contains(error));
    all.extend(others.filter_map(|error| of_error(machine, error, file, &[], &[])));
    all
}

pub(crate) fn stated_curves(machine: &Machine) -> Vec<Curve> {
    let names = machine.errors().map(|(error, _)| error);
    names.filter_map(|error| bare(machine, error)).collect()
}

fn of_error(
    machine: &Machine,
    error: ErrorName,
    file: &CalibrationFile,
    lines: &[&FittedLine],
    fits: &[&FittedCurve],
) -> Option<Curve> {
    let mut curve = bare(machine, error)?;
    if lines.is_empty() {
        return Some(curve);
    }
    for fit in fits {
        let directions: &[usize] = match fit.direction {
            Some(direction) => &[direction as usize],
            None => &[0, 1],
        };
        // If only one direction was measured, its curve is used for both.
        let found = curve.branches.iter().position(|b| b.direction == fit.direction);
        let Some(place) = found.or((!curve.branches.is_empty()).then_some(0)) else {
            continue;
        };
        let means = lines.iter().flat_map(|line| directions.iter().flat_map(|d| &line.points[*d]));
        let mut means: Vec<(f64, f64)> = means.copied().collect();
        means.sort_by(|a, b| a.0.total_cmp(&b.0));
        let value = curve_of(machine, error, fit.direction);
        let branch = &mut curve.branches[place];
        branch.residuals = means.iter().map(|(at, mean)| (*at, mean - value(*at))).collect();
        branch.fit = Some(numbers(fit));
        branch.band = fit.band().map(|found| about(&value, &found));
    }
    curve.lines = lines.iter().map(|line| of_line(file, line)).collect();
    Some(curve)
}

/// Band around a curve, without the points that linear interpolation reproduces.
fn about(value: impl Fn(f64) -> f64, found: &volcomp_fit::Band) -> Band {
    let mut band = Band { x: Vec::new(), low: Vec::new(), high: Vec::new(), source: found.source };
    let all: Vec<[f64; 3]> = (found.at.iter().zip(&found.half_width))
        .map(|(&x, half)| [x, value(x) - half, value(x) + half])
        .collect();
    // A point is omitted if the line from the last kept point to the next point passes through all points in between.
    let mut kept = 0;
    for place in 0..all.len() {
        let may_go = place > 0
            && all.get(place + 1).is_some_and(|next| {
                let mut skipped = all[kept + 1..=place].iter();
                skipped.all(|skipped| is_on(all[kept], *next, *skipped))
            });
        if may_go {
            continue;
        }
        let [x, low, high] = all[place];
        band.x.push(x);
        band.low.push(low);
        band.high.push(high);
        kept = place;
    }
    band
}

/// Whether both edges of a band at the point `at` are within a hundredth of its width from the straight line between `from` and `to`.
fn is_on(from: [f64; 3], to: [f64; 3], at: [f64; 3]) -> bool {
    let share = (at[0] - from[0]) / (to[0] - from[0]);
    let allowed = 0.01 * (at[2] - at[1]);
    [1, 2].into_iter().all(|edge| {
        let line = from[edge] + share * (to[edge] - from[edge]);
        (at[edge] - line).abs() <= allowed
    })
}

/// Curve of an error from the machine file, without readings.
fn bare(machine: &Machine, error: ErrorName) -> Option<Curve> {
    let axis = machine.axis(error.axis)?;
    let range = machine.range_of(error)?;
    let stated = machine.error(error)?;
    let directions: &[Option<Direction>] = match stated {
        volcomp_model::curve::ErrorCurve::Single(_) => &[None],
        _ => &[Some(Direction::Positive), Some(Direction::Negative)],
    };
    let [low, high] = axis.travel;
    let at = |index: usize| low + (high - low) * index as f64 / (POINTS - 1) as f64;
    let branches = directions.iter().map(|direction| {
        let value = curve_of(machine, error, *direction);
        Branch {
            direction: *direction,
            points: (0..POINTS).map(|index| (at(index), value(at(index)))).collect(),
            residuals: Vec::new(),
            band: None,
            fit: None,
        }
    });
    Some(Curve {
        error: error.to_string(),
        axis: error.axis.to_string(),
        x_unit: error.axis.kind().coordinate_unit().to_owned(),
        unit: error.component.symbol().to_owned(),
        travel: axis.travel,
        range: [range.smallest, range.largest],
        has_other_axes: range.at.iter().any(|(axis, _)| *axis != error.axis),
        branches: branches.collect(),
        lines: Vec::new(),
    })
}

/// Value of an error as a function of the coordinate of its axis (mm or deg), with all other axes at 0.
fn curve_of(
    machine: &Machine,
    error: ErrorName,
    direction: Option<Direction>,
) -> impl Fn(f64) -> f64 {
    let stated = machine.error(error).cloned();
    let own = machine.index_of(error.axis).unwrap_or_default();
    let count = machine.axes().len();
    move |at| {
        let mut coordinates = vec![0.0; count];
        if let Some(place) = coordinates.get_mut(own) {
            *place = at;
        }
        stated.as_ref().map_or(0.0, |curve| curve.value(own, &coordinates, direction))
    }
}

fn numbers(fit: &FittedCurve) -> FitNumbers {
    let residual = |min, max, rms| Residual { min, max, rms };
    let (residual, leave_one_out, reversal) = match fit.quality {
        Quality::Length(q) => (
            residual(q.residual_min.0, q.residual_max.0, q.residual_rms.0),
            q.leave_one_out.map(|error| error.0),
            q.reversal.map(|b| b.0),
        ),
        Quality::Angle(q) => (
            residual(q.residual_min.0, q.residual_max.0, q.residual_rms.0),
            q.leave_one_out.map(|error| error.0),
            q.reversal.map(|b| b.0),
        ),
    };
    FitNumbers {
        kind: fit.kind.to_owned(),
        readings: fit.readings,
        residual,
        leave_one_out,
        reversal,
    }
}

/// Readings of a line, shifted by the same offset as their means.
fn of_line(file: &CalibrationFile, fitted: &FittedLine) -> CurveLine {
    let means = fitted.points.clone();
    let Some(line) = fitted.line.and_then(|line| file.measurements.get(line)) else {
        return CurveLine { file: None, runs: Vec::new(), means };
    };
    let mut runs = Vec::new();
    if line.setup.method == Method::Direct {
        let key = |at: f64| (at + 0.0).to_bits();
        let moved = Direction::BOTH.map(|direction| -> HashMap<u64, (f64, f64)> {
            let raw = line.readings.mean_curve_in(direction).into_iter();
            let raw: HashMap<u64, f64> = raw.map(|(at, mean)| (key(at), mean)).collect();
            let there = means[direction as usize].iter();
            there.filter_map(|(at, mean)| Some((key(*at), (*mean, *raw.get(&key(*at))?)))).collect()
        });
        runs = runs_of(&line.readings, |direction, at, reading| {
            let (mean, raw) = moved[direction as usize].get(&key(at))?;
            Some(mean + fitted.factor * (reading - raw))
        });
    }
    CurveLine { file: Some(line.file.display().to_string()), runs, means }
}

pub(crate) fn runs_of(
    measurement: &Measurement,
    value: impl Fn(Direction, f64, f64) -> Option<f64>,
) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    let mut places: HashMap<(Direction, u32), usize> = HashMap::new();
    for reading in &measurement.readings {
        let Some(value) = value(reading.direction, reading.target, reading.deviation) else {
            continue;
        };
        let place = *places.entry((reading.direction, reading.run)).or_insert_with(|| {
            runs.push(Run {
                direction: reading.direction,
                number: reading.run,
                points: Vec::new(),
            });
            runs.len() - 1
        });
        runs[place].points.push((reading.target, value));
    }
    for run in &mut runs {
        run.points.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    runs.sort_by_key(|run| (run.direction == Direction::Negative, run.number));
    runs
}

/// Description of an error, such as `straightness deviation of X in Y`; empty if the name is invalid.
pub(crate) fn described(error: &str) -> String {
    let Ok(name) = error.parse::<ErrorName>() else {
        return String::new();
    };
    let axis = name.axis;
    let letter = match name.component.mcs_index() {
        0 => 'X',
        1 => 'Y',
        _ => 'Z',
    };
    let rotary = axis.kind() == AxisKind::Rotary;
    let own = name.component.mcs_index() == axis.mcs_index();
    if name.location {
        return "location error".to_owned();
    }
    match MotionKind::of(name) {
        MotionKind::Positioning => format!("positioning deviation of {axis}"),
        _ if name.component.is_angular() && !rotary && own => format!("roll of {axis}"),
        _ if name.component.is_angular() => {
            format!("tilt of {axis} about {letter}")
        }
        _ if rotary && own => format!("axial error motion of {axis}"),
        _ if rotary => format!("radial error motion of {axis} in {letter}"),
        _ => format!("straightness deviation of {axis} in {letter}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_described_in_words() {
        for (error, words) in [
            ("EXX", "positioning deviation of X"),
            ("EYX", "straightness deviation of X in Y"),
            ("EAX", "roll of X"),
            ("ECY", "tilt of Y about Z"),
            ("ECC", "positioning deviation of C"),
            ("EXC", "radial error motion of C in X"),
            ("EZC", "axial error motion of C"),
            ("EC0Y", "location error"),
            ("<b>", ""),
        ] {
            assert_eq!(described(error), words);
        }
    }
}
