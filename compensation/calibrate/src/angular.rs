//! First stage: the angular errors from their own readings, then unmeasured tilts from parallel lines of positioning or
//! straightness. Lines at different lever arms differ by the tilt times the difference of their lever arms (Abbe's
//! principle).

use std::{collections::BTreeMap, path::PathBuf};

use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_metrology::{DeviationUnit, Measurement, MotionKind, Reading, ReferenceKind, Rides};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{AxisKind, Component, Direction, ErrorName};

use crate::{
    abbe::{Lever, without_abbe},
    artefact_poses::ArtefactPoses,
    calibration_file::{CalibrationFile, Line, lines_of, measured},
    checks::contradictions::{ParallelReadings, contradictions, noise_of_lines},
    error::CalibrateError,
    fitted::{Fitted, fit, joint_of},
    line_of_sight::without_others,
    profile::{Points, Profile},
    setup::{Method, Setup},
};

pub(crate) struct Angular {
    pub(crate) fitted: Vec<Fitted>,
    /// The machine of the file with its fitted tilts, for Abbe's principle and for the tilts of held axes.
    pub(crate) tilted: Machine,
    /// Standard deviation of each fitted tilt at a target, µrad; no entry for a tilt whose readings do not show their
    /// scatter.
    pub(crate) noise_urad: BTreeMap<ErrorName, f64>,
    /// Linear errors from whose lines tilts were found, with their readings forward and backward: at each target the mean of the lines without the Abbe
    /// errors of the tilts found there, before a curve smooths these.
    pub(crate) found_from: BTreeMap<ErrorName, [Points; 2]>,
    pub(crate) notes: Vec<String>,
    /// Subset of `notes`: contradictory measurement lines.
    pub(crate) contradictions: Vec<(ErrorName, String)>,
}

/// Fits every angular error, and calls `step` after each of them.
///
/// `known` is the machine of the file with the errors that are already known. The contributions of the location errors
/// and of the other axes of `whole` are subtracted from the readings of rotary axes.
pub(crate) fn angular(
    file: &CalibrationFile,
    known: &Machine,
    (whole, artefacts): (&Machine, &ArtefactPoses),
    mut step: impl FnMut(),
) -> Result<Angular, CalibrateError> {
    let mut result = Angular {
        fitted: Vec::new(),
        tilted: known.clone(),
        noise_urad: BTreeMap::new(),
        found_from: BTreeMap::new(),
        notes: Vec::new(),
        contradictions: Vec::new(),
    };
    let names = measured(file).into_iter();
    for error in names.filter(|error| error.component.is_angular()) {
        let joint = joint_of(&file.machine, error)?;
        let mut profiles = Vec::new();
        for line in lines_of(file, error) {
            let read = Profile::new(line, &joint)?;
            profiles.push(without_others(read, whole, artefacts)?);
        }
        let found = contradictions(error, &profiles, None)?;
        result.notes.extend(found.iter().map(|(_, text)| text.clone()));
        result.contradictions.extend(found);
        let noise = noise_of_lines(&profiles);
        result.noise_urad.extend(noise.map(|noise| (error, noise)));
        let (fitted, _) = fit(file, error, profiles)?;
        for one in &fitted {
            one.set_in(&mut result.tilted)?;
        }
        result.fitted.extend(fitted);
        step();
    }
    Ok(result)
}

/// Minimum difference of lever arms, as a fraction of the diagonal of the working space. A smaller
/// difference does not determine a tilt that acts over the whole space.
const LEAST_PART: f64 = 0.02;
/// Maximum difference of lever arms that are treated as equal, mm.
const SAME_LEVER_MM: f64 = 1.0;

/// Determines tilts from several lines, with notes on tilts that cannot be separated. Checks every
/// linear error of a linear axis with several lines; positioning first, because it is affected by
/// the whole tilt.
pub(crate) fn from_parallel_lines(
    file: &CalibrationFile,
    tilted: &Machine,
) -> Result<Angular, CalibrateError> {
    let mut result = Angular {
        fitted: Vec::new(),
        tilted: tilted.clone(),
        noise_urad: BTreeMap::new(),
        found_from: BTreeMap::new(),
        notes: Vec::new(),
        contradictions: Vec::new(),
    };
    let mut names = measured(file);
    names.retain(|name| !name.component.is_angular() && name.axis.kind() == AxisKind::Linear);
    names.sort_by_key(|name| MotionKind::of(*name) == MotionKind::Straightness);
    for error in names {
        let lines: Vec<&Line> = lines_of(file, error).collect();
        if lines.len() > 1 {
            of_error(file, error, &lines, &mut result)?;
        }
    }
    Ok(result)
}

fn of_error(
    file: &CalibrationFile,
    error: ErrorName,
    lines: &[&Line],
    result: &mut Angular,
) -> Result<(), CalibrateError> {
    let (acting, differences) = differing_levers(file, error, lines, &result.tilted)?;
    if acting.is_empty() {
        return Ok(());
    }
    let svd = differences.svd(true, true);
    let least_mm = LEAST_PART * file.machine.diagonal_of_travels_mm();
    let singular = svd.singular_values.iter();
    let rank = singular.filter(|s| **s > least_mm).count();
    if rank < acting.len() {
        let note = not_separated(error, lines, &acting, rank, least_mm);
        result.notes.push(note);
        return Ok(());
    }
    let profiles: Vec<Profile<'_>> = lines
        .iter()
        .map(|line| {
            let joint = joint_of(&result.tilted, error)?;
            Ok(without_abbe(Profile::new(line, &joint)?, &result.tilted)?)
        })
        .collect::<Result<_, CalibrateError>>()?;
    let is_straightness = MotionKind::of(error) == MotionKind::Straightness;
    let beside = ParallelReadings::of(&profiles.iter().collect::<Vec<_>>(), is_straightness);
    // The inverse exists because the rank is full.
    let (Some(beside), Ok(inverse)) = (beside, svd.pseudo_inverse(0.0)) else {
        return Ok(());
    };
    let levers = levers_of(lines, &result.tilted)?;
    result.found_from.insert(error, without_tilts(&beside, &inverse, &acting, &levers));
    let noise = profiles.iter().filter_map(Profile::noise_of_shape);
    let noise_um = noise.reduce(f64::max);
    let files = files_named(lines);
    for (column, tilt) in acting.into_iter().enumerate() {
        let readings = readings_of(&beside, &inverse, column);
        let line = line_of(tilt, readings, lines);
        let joint = joint_of(&result.tilted, tilt)?;
        let profile = Profile::new(&line, &joint)?;
        let gain = inverse.row(column).norm() * 1e3;
        let of_runs = noise_um.map(|noise| noise * gain);
        let noise_urad = of_runs.or_else(|| noise_of_lines(std::slice::from_ref(&profile)));
        result.noise_urad.extend(noise_urad.map(|noise| (tilt, noise)));
        let (fitted, _) = fit(file, tilt, vec![profile])?;
        for one in &fitted {
            one.set_in(&mut result.tilted)?;
        }
        result.fitted.extend(fitted);
        let uncertain = of_runs.map_or_else(String::new, |at_target| {
            format!(", with a standard uncertainty of {at_target:.2} µrad at a target")
        });
        let slope = if is_straightness {
            ". Its part that grows evenly along the axis is not determined, because each straightness line has a separate slope"
        } else {
            ""
        };
        result.notes.push(format!(
            "{tilt} was not measured: it was found from the lines of {error} ({files}), whose levers differ{uncertain}{slope}"
        ));
    }
    Ok(())
}

/// Unknown tilts for which the lines have different lever arms, and these lever arms, mm: a row for each line and a column for each tilt, relative
/// to the mean of the column.
fn differing_levers(
    file: &CalibrationFile,
    error: ErrorName,
    lines: &[&Line],
    tilted: &Machine,
) -> Result<(Vec<ErrorName>, DMatrix<f64>), CalibrateError> {
    let levers = levers_of(lines, tilted)?;
    let levers: Vec<[f64; 3]> = levers.iter().map(|lever| lever.um_of_mrad(0.0)).collect();
    let observed = file.observations.iter().flat_map(|o| &o.unknown);
    let unknown: Vec<ErrorName> = observed.map(|unknown| unknown.error).collect();
    let angular = Component::ALL.into_iter().filter(|c| c.is_angular());
    let mut acting = Vec::new();
    let mut columns = Vec::new();
    for (about, component) in angular.enumerate() {
        let tilt = ErrorName::motion(component, error.axis);
        let own = || levers.iter().map(|lever| lever[about]);
        let highest = own().fold(f64::NEG_INFINITY, f64::max);
        let spread = highest - own().fold(f64::INFINITY, f64::min);
        if spread > SAME_LEVER_MM && tilted.error(tilt).is_none() && !unknown.contains(&tilt) {
            let mean = own().sum::<f64>() / lines.len() as f64;
            acting.push(tilt);
            columns.extend(own().map(|lever| lever - mean));
        }
    }
    let matrix = DMatrix::from_vec(lines.len(), acting.len(), columns);
    Ok((acting, matrix))
}

fn levers_of(lines: &[&Line], tilted: &Machine) -> Result<Vec<Lever>, ModelError> {
    lines.iter().map(|line| Lever::new(line, tilted)).collect()
}

fn not_separated(
    error: ErrorName,
    lines: &[&Line],
    acting: &[ErrorName],
    rank: usize,
    least_mm: f64,
) -> String {
    let names: Vec<String> = acting.iter().map(ErrorName::to_string).collect();
    let (names, files) = (names.join(" and "), files_named(lines));
    let was = if acting.len() == 1 { "was" } else { "were" };
    if rank == 0 {
        return format!(
            "{names} {was} not measured, and the levers of the lines of {error} ({files}) differ by too little to show it: expected lines at least {least_mm:.0} mm apart, or the angular measurement"
        );
    }
    format!(
        "{names} {was} not measured, and the {} lines of {error} ({files}) do not separate them: they determine {rank} of {} tilts. Expected lines that differ in one lever at a time, or the angular measurement",
        lines.len(),
        acting.len()
    )
}

/// Mean of the lines at a place, µm, and the tilts there, mrad (µm per mm), by least squares from the differences of the lines. The linear error δ itself
/// is equal in all lines and cancels when their mean is subtracted.
fn mean_and_tilts(
    beside: &ParallelReadings,
    inverse: &DMatrix<f64>,
    place: usize,
) -> (f64, DVector<f64>) {
    let lines = beside.lines.iter().map(|line| line[place]);
    let at = DVector::from_iterator(beside.lines.len(), lines);
    let mean = at.mean();
    (mean, inverse * at.add_scalar(-mean))
}

/// Tilt at every place, µrad.
fn readings_of(beside: &ParallelReadings, inverse: &DMatrix<f64>, column: usize) -> Vec<Reading> {
    let places = beside.places.iter().enumerate();
    let reading = |(place, (direction, target)): (usize, &(Direction, f64))| {
        let (_, tilts_mrad) = mean_and_tilts(beside, inverse, place);
        let deviation = tilts_mrad[column] * 1e3;
        Reading { target: *target, run: 1, direction: *direction, deviation }
    };
    places.map(reading).collect()
}

/// Mean of the lines without the Abbe errors of the tilts at every place, µm, forward and backward.
fn without_tilts(
    beside: &ParallelReadings,
    inverse: &DMatrix<f64>,
    acting: &[ErrorName],
    levers: &[Lever],
) -> [Points; 2] {
    let mut points = [Points::new(), Points::new()];
    for (place, (direction, target)) in beside.places.iter().enumerate() {
        let (mut value, tilts_mrad) = mean_and_tilts(beside, inverse, place);
        for (tilt, tilt_mrad) in acting.iter().zip(&tilts_mrad) {
            let about = tilt.component.mcs_index();
            let lever = |lever: &Lever| lever.um_of_mrad(*target)[about];
            value -= tilt_mrad * levers.iter().map(lever).sum::<f64>() / levers.len() as f64;
        }
        points[*direction as usize].push((*target, value));
    }
    points
}

fn files_named(lines: &[&Line]) -> String {
    let files: Vec<String> = lines.iter().map(|l| l.file.display().to_string()).collect();
    files.join(", ")
}

/// A line with the computed tilt as its readings, fitted with the kind of curve of the lines from
/// which it was computed.
fn line_of(tilt: ErrorName, readings: Vec<Reading>, lines: &[&Line]) -> Line {
    Line {
        setup: Setup {
            error: tilt,
            at: lines.first().map_or_else(Vec::new, |line| line.setup.at.clone()),
            point_mcs: None,
            rides: Rides::Carriage,
            method: Method::Direct,
            sign: 1.0,
        },
        file: PathBuf::from(files_named(lines)),
        sources: (lines.iter()).flat_map(|line| line.sources.iter().cloned()).collect(),
        place: lines.first().map_or_else(String::new, |line| line.place.clone()),
        readings: Measurement {
            unit: Some(DeviationUnit::Urad),
            readings,
            ..Measurement::default()
        },
        curve: lines.iter().find_map(|line| line.curve),
        reference_line: ReferenceKind::LeastSquares,
        holds_location: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{file, line, name};
    use volcomp_vocabulary::AxisName;

    /// ECX = 3 + 0.02 q becomes zero at the reference q = 200: 0.02 (q − 200).
    #[test]
    fn a_curve_is_zero_at_the_reference() {
        let mut file = file(vec![line("ECX", |q| 3.0 + 0.02 * q), line("EXX", |q| q)]);
        file.reference[0] = 200.0;
        let mut steps = 0;
        let found = angular(
            &file,
            &file.machine,
            (
                &file.machine,
                &ArtefactPoses::of(&file.machine, &[], [AxisName::X, AxisName::Y], |_| None),
            ),
            || steps += 1,
        )
        .unwrap();
        assert_eq!((steps, found.fitted.len()), (1, 1), "the linear error is left alone");
        for q in [0.0, 200.0, 730.0] {
            let value = found.fitted[0].branches.mean_at(q);
            assert!((value - 0.02 * (q - 200.0)).abs() < 1e-9, "{value} at {q}");
        }
        assert!(found.tilted.error(name("ECX")).is_some());
        assert!(found.tilted.error(name("EXX")).is_none());
    }
}
