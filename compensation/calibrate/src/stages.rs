//! Stages from readings to a machine: angular errors, then linear errors, then squareness errors.
//!
//! 1. Angular errors follow from their own readings, or from parallel lines at different lever arms.
//! 2. Linear errors are freed of Abbe errors, a straightness also of its fitted line.
//! 3. Squareness errors are stated, or follow from diagonals (ISO 230-6), or from the slopes of the straightness lines
//!    minus the contributions of the tilts of held axes.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use volcomp_identify::identify;
use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_metrology::{
    DeviationUnit, Measurement, MotionKind, Reading, ReferenceKind, Rides, RunAlignment,
    SlopeUncertainty, angular_method_um, slope_gain, slope_gain_of_tilts, squareness,
    squareness_parts,
};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{AxisKind, AxisName, Component, Direction, ErrorName, Urad};

use crate::branches::{Fitted, FittedCurve, FittedLine, fit, joint_of};
use crate::calibration_file::{
    CalibrationFile, Diagonals, Line, Method, Setup, Squareness, SquarenessSource, lines_of,
    measured, set_square, tilt_of,
};
use crate::checks::{ParallelReadings, Tilts, contradictions, noise_of_lines};
use crate::error::CalibrateError;
use crate::line_of_sight::{ArtefactPoses, Lever, OtherErrors, without_abbe, without_others};
use crate::profile::{Points, Profile};

/// Maximum number of passes after the first pass. Few are enough, because the contribution of a rotary axis to the
/// lines of another axis is small.
const PASSES: usize = 4;

pub(crate) struct Stages {
    pub(crate) machine: Machine,
    pub(crate) measured: Vec<ErrorName>,
    pub(crate) fitted: Vec<Fitted>,
    pub(crate) squareness: Vec<(ErrorName, Urad)>,
    pub(crate) square_uncertainties: BTreeMap<ErrorName, Urad>,
    pub(crate) notes: Vec<String>,
    pub(crate) contradictions: Vec<(ErrorName, String)>,
    pub(crate) undecided: Vec<ErrorName>,
}

impl Stages {
    /// Fits every line of a file. `known` is the machine of the file with the errors known from other sources; `step`
    /// is called after each error.
    pub(crate) fn of(
        file: &CalibrationFile,
        known: &Machine,
        step: impl FnMut(),
    ) -> Result<Self, CalibrateError> {
        let artefacts = ArtefactPoses::before_lines(file, known)?;
        let mut stages = Self::once(file, known, (None, &artefacts), step)?;
        let sees_others =
            |line: &Line| line.holds_location && line.setup.error.axis.kind() == AxisKind::Rotary;
        if !file.measurements.iter().any(sees_others) {
            return Ok(stages);
        }
        // Lines of rotary axes contain the errors of the held axes that rotate with the measured axis.
        for _ in 0..PASSES {
            let again = Self::once(file, known, (Some(&stages.machine), &artefacts), || ())?;
            let is_same = again.is_as_measured(&stages);
            stages = again;
            if is_same {
                break;
            }
        }
        Ok(stages)
    }

    /// One pass over the lines. The contributions of other axes to lines of rotary axes are computed with `before`, the machine of the previous pass.
    fn once(
        file: &CalibrationFile,
        known: &Machine,
        (before, artefacts): (Option<&Machine>, &ArtefactPoses),
        mut step: impl FnMut(),
    ) -> Result<Self, CalibrateError> {
        let whole = (before.unwrap_or(known), artefacts);
        let angular = angular(file, known, whole, &mut step)?;
        let parallel = from_parallel_lines(file, &angular.tilted)?;
        let mut noise_urad = angular.noise_urad;
        noise_urad.extend(&parallel.noise_urad);
        let tilts = Tilts {
            machine: &parallel.tilted,
            noise_urad: &noise_urad,
            found_from: &parallel.found_from,
        };
        let whole = (before.unwrap_or(&parallel.tilted), artefacts);
        let linear = linear(file, &tilts, whole, &mut step)?;
        let (slopes, of_slopes) = slopes(&linear.removed, &parallel.tilted, artefacts)?;
        let mut squareness = squares(file, &slopes)?;
        let square_uncertainties = square_uncertainties(file, &linear.removed)?;
        let mut machine = parallel.tilted;
        for fitted in &linear.fitted {
            fitted.set_in(&mut machine)?;
        }
        for (error, value) in &squareness {
            set_square(&mut machine, file.reference_axes, *error, *value)?;
        }
        let mut diagonal_notes = Vec::new();
        let mut undecided = Vec::new();
        let mut contradictions = angular.contradictions;
        contradictions.extend(linear.contradictions);
        for square in &file.squareness {
            let SquarenessSource::Slopes { .. } = square.source else {
                continue;
            };
            let parts = squareness_parts(square.error)?;
            let own = of_slopes.iter().filter(|(error, _)| parts.contains(error));
            let before = contradictions.len();
            contradictions.extend(own.cloned());
            if contradictions.len() > before {
                undecided.push(tilt_of(square.error, file.reference_axes).0);
            }
        }
        for diagonals in &file.diagonals {
            let found = diagonals.squares(&machine, file.reference_axes)?;
            diagonal_notes.extend(found.notes);
            undecided.extend(found.undecided);
            for (error, value) in &found.errors {
                set_square(&mut machine, file.reference_axes, *error, *value)?;
            }
            squareness.extend(found.errors);
        }
        let angles = angular.fitted.into_iter().chain(parallel.fitted);
        let mut notes = angular.notes;
        notes.extend(parallel.notes);
        notes.extend(linear.notes);
        notes.extend(diagonal_notes);
        notes.extend(of_slopes.into_iter().map(|(_, text)| text));
        Ok(Self {
            machine,
            measured: measured(file),
            fitted: angles.chain(linear.fitted).collect(),
            squareness,
            square_uncertainties,
            notes,
            contradictions,
            undecided,
        })
    }

    /// The curves with their quality, angular errors first. Computing the quality takes longer than the fit.
    pub(crate) fn curves(&self) -> Vec<FittedCurve> {
        let curves = self.fitted.iter();
        let curves = curves.flat_map(|fitted| fitted.branches.fitted(fitted.error));
        curves.collect()
    }

    /// The fitted lines in the order of the curves.
    pub(crate) fn lines(&self) -> Vec<FittedLine> {
        let lines = self.fitted.iter().flat_map(|fitted| &fitted.lines);
        lines.cloned().collect()
    }

    pub(crate) fn is_as_measured(&self, other: &Self) -> bool {
        let same = |name: &ErrorName| self.machine.error(*name) == other.machine.error(*name);
        let mut filled = self.fitted.iter().map(|fitted| fitted.error);
        filled.all(|name| same(&name)) && self.squareness == other.squareness
    }
}

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

/// Minimum effect of 1 mrad, µm, at which an unmeasured tilt is reported: a lever arm of 1 mm.
const NAMED_ABOVE_UM_BY_MRAD: f64 = 1.0;

/// Fitted linear errors, and the slopes of the straightness lines that were removed.
pub(crate) struct Linear<'a> {
    pub(crate) fitted: Vec<Fitted>,
    /// Each measured straightness line with the total slope removed from it, as a function of the coordinate of the
    /// line.
    pub(crate) removed: Vec<RemovedSlope<'a>>,
    pub(crate) notes: Vec<String>,
    /// Subset of `notes`: contradictory measurement lines.
    pub(crate) contradictions: Vec<(ErrorName, String)>,
}

/// Fits every linear error, and calls `step` after each of them. The contributions of the tilts of the machine in
/// `tilts` and, for rotary axes, of the other axes of `whole` are subtracted.
pub(crate) fn linear<'a>(
    file: &'a CalibrationFile,
    tilts: &Tilts<'_>,
    (whole, artefacts): (&Machine, &ArtefactPoses),
    mut step: impl FnMut(),
) -> Result<Linear<'a>, CalibrateError> {
    let tilted = tilts.machine;
    let mut result = Linear {
        fitted: Vec::new(),
        removed: Vec::new(),
        notes: Vec::new(),
        contradictions: Vec::new(),
    };
    let names = measured(file).into_iter();
    for error in names.filter(|error| !error.component.is_angular()) {
        let joint = joint_of(tilted, error)?;
        let straightness = MotionKind::of(error) == MotionKind::Straightness;
        let mut profiles = Vec::new();
        for line in lines_of(file, error) {
            let read = Profile::new(line, &joint)?;
            let mut profile = without_abbe(without_others(read, whole, artefacts)?, tilted)?;
            profile.as_one_run = tilts.found_from.get(&error).cloned();
            result.notes.extend(levers_left_in(&profile, tilted)?);
            profiles.push(profile);
        }
        let found = contradictions(error, &profiles, Some(tilts))?;
        result.notes.extend(found.iter().map(|(_, text)| text.clone()));
        result.contradictions.extend(found);
        if straightness {
            let straight = |profile: Profile<'a>| {
                let line = profile.reference_line()?;
                Ok(profile.without_line(&line))
            };
            let profiles_of = profiles.into_iter().map(straight);
            profiles = profiles_of.collect::<Result<_, CalibrateError>>()?;
        }
        let (fitted, profiles) = fit(file, error, profiles)?;
        result.fitted.extend(fitted);
        if straightness {
            result.removed.extend(profiles.iter().map(RemovedSlope::of));
        }
        step();
    }
    Ok(result)
}

/// Notes on unknown tilts of the axis that would affect a line.
fn levers_left_in(profile: &Profile<'_>, tilted: &Machine) -> Result<Vec<String>, ModelError> {
    let line = profile.line;
    let targets = profile.all().map(|point| point.0);
    let effects = Lever::new(line, tilted)?.um_by_mrad(targets);
    let components = Component::ALL.into_iter().filter(|c| c.is_angular());
    let note = |(component, effect): (Component, f64)| {
        let tilt = ErrorName::motion(component, line.setup.error.axis);
        let is_left = effect >= NAMED_ABOVE_UM_BY_MRAD && tilted.error(tilt).is_none();
        is_left.then(|| {
            format!(
                "{tilt} was not measured: {} from {} keeps its part, over a lever of up to {effect:.0} mm",
                line.setup.error,
                line.file.display()
            )
        })
    };
    Ok(components.zip(effects).filter_map(note).collect())
}

/// Slopes of lines of one error contradict each other if they differ by more than this multiple of their noise.
const TIMES_NOISE: f64 = 3.0;
/// Differences of slopes up to this are insignificant for any machine tool, µrad.
const NEVER_BELOW_URAD: f64 = 0.5;

/// Maximum ratio of two uncertainties of a slope: from the slopes of the runs, and from the readings about the line.
/// Above it, the runs scatter more than the readings explain. Independent scatter of the readings exceeds this ratio
/// for one in twenty lines of two runs, and more rarely with more runs.
const TIMES_OF_LINE: f64 = 2.0;

/// Least-squares slope of each measured straightness error, by the coordinate of the machine coordinate system.
pub(crate) type Slopes = BTreeMap<ErrorName, Urad>;

pub(crate) struct RemovedSlope<'a> {
    pub(crate) line: &'a Line,
    pub(crate) slope: Urad,
    /// Standard deviation of the slope, from the scatter of the readings about the line; from the slopes of repeated
    /// runs if these give more than `TIMES_OF_LINE` times as much, or if the scatter of the readings is unknown. `None`
    /// if both are unknown.
    pub(crate) noise: Option<Urad>,
    /// Uncertainty of the least-squares slope from the scatter of its readings; `None` if it is unknown.
    scatter: Option<SlopeUncertainty>,
    /// Change of the slope per independent deviation of each mean reading, µrad per µm (of a bridge: per µrad).
    gain: f64,
}

impl<'a> RemovedSlope<'a> {
    pub(crate) fn of(profile: &Profile<'a>) -> Self {
        let count = profile.all().count().max(1) as f64;
        let middle = profile.all().map(|(at, _)| at).sum::<f64>() / count;
        let spread: f64 = profile.all().map(|(at, _)| (at - middle).powi(2)).sum();
        let noise_um = profile
            .scatter_of_mean(RunAlignment::Offset)
            .map(|noise| noise.deviation)
            .or_else(|| profile.unevenness());
        let noise = noise_um.filter(|_| spread > 0.0);
        let of_line = noise.map(|um| 1e3 * um / spread.sqrt());
        let line = profile.line;
        let of_runs = heights(line).and_then(|heights| SlopeUncertainty::of_runs(&heights));
        let noise_of_runs = (of_runs.map(|of| of.standard_urad))
            .filter(|_| line.setup.method == Method::Direct)
            .filter(|of_runs| of_line.is_none_or(|of_line| *of_runs > TIMES_OF_LINE * of_line));
        let (of_one_run, gain) = match line.setup.method {
            Method::Direct => (
                SlopeUncertainty::of_line(&line.readings.mean_curve()),
                slope_gain(&profile.all().map(|(at, _)| *at).collect::<Vec<_>>()),
            ),
            Method::Angular { .. } => {
                let tilts = line.readings.mean_curve();
                let directions = profile.points.iter().filter(|of| !of.is_empty()).count();
                let steps = tilts.len().saturating_sub(1);
                let gain = slope_gain_of_tilts(steps) / (directions.max(1) as f64).sqrt();
                (SlopeUncertainty::of_tilts(&tilts), gain)
            }
        };
        Self {
            line,
            slope: profile.removed,
            noise: noise_of_runs.or(of_line).map(Urad),
            // The uncertainty applies to least-squares lines; slopes of other lines scatter more.
            scatter: (of_runs.or(of_one_run))
                .filter(|_| line.reference_line == ReferenceKind::LeastSquares),
            gain,
        }
    }
}

/// The readings of a line as straightness; readings of a bridge are summed for each run. `None` if
/// the runs of a bridge are not complete.
fn heights(line: &Line) -> Option<Cow<'_, Measurement>> {
    let Method::Angular { bridge_mm, reading } = line.setup.method else {
        return Some(Cow::Borrowed(&line.readings));
    };
    let mut readings = Vec::new();
    for direction in Direction::BOTH {
        for run in line.readings.runs(direction) {
            let own = line.readings.readings.iter();
            let own = own.filter(|of| of.direction == direction && of.run == run);
            let mut tilts: Vec<_> = own.map(|of| (of.target, of.deviation)).collect();
            tilts.sort_by(|a, b| a.0.total_cmp(&b.0));
            let heights = angular_method_um(line.setup.error, reading, &tilts, bridge_mm).ok()?;
            readings.extend(heights.into_iter().map(|(target, deviation)| Reading {
                target,
                run,
                direction,
                deviation,
            }));
        }
    }
    Some(Cow::Owned(Measurement { readings, ..Measurement::default() }))
}

/// Standard uncertainty of each squareness with known contributions, widened so that twice its value is a 95.45 %
/// interval. A squareness from slopes has contributions of its reference angle, of the scatter of the slopes with
/// Student's t, and of the stated uncertainty of the readings. A stated value has the contribution of its reference
/// angle only.
pub(crate) fn square_uncertainties(
    file: &CalibrationFile,
    removed: &[RemovedSlope<'_>],
) -> Result<BTreeMap<ErrorName, Urad>, CalibrateError> {
    let stated = &file.uncertainty;
    let mut found = BTreeMap::new();
    for entry in &file.squareness {
        let of_slopes = match entry.source {
            SquarenessSource::Diagonals => continue,
            SquarenessSource::Value(_) => Some(0.0),
            SquarenessSource::Slopes { .. } => {
                let parts = squareness_parts(entry.error)?;
                let of = |part: ErrorName| {
                    let lines = removed.iter();
                    lines.filter(move |of| of.line.setup.error == part)
                };
                let count = parts.map(|part| of(part).count() as f64);
                let lines = || (0..2).flat_map(|k| of(parts[k]).map(move |of| (of, count[k])));
                let scatter = lines()
                    .map(|(of, count)| Some(of.scatter?.divided_by(count)))
                    .collect::<Option<Vec<_>>>();
                let of_readings = lines().map(|(of, count)| {
                    let reading = match of.line.setup.method {
                        Method::Direct => stated.reading_um,
                        Method::Angular { .. } => stated.reading_urad,
                    };
                    of.gain * reading / count
                });
                let of_readings = of_readings.fold(0.0, f64::hypot);
                scatter.map(|of| {
                    let scatter = SlopeUncertainty::of_sum(of).expanded_urad() / 2.0;
                    scatter.hypot(of_readings)
                })
            }
        };
        let whole = of_slopes.map(|of_slopes| stated.square_urad.hypot(of_slopes));
        if let Some(known) = whole.filter(|whole| *whole > 0.0) {
            found.insert(entry.error, Urad(known));
        }
    }
    Ok(found)
}

/// Straightness lines with a single run whose slopes determine a squareness. A single run does not show the scatter
/// from the alignment of the reference.
pub fn squareness_lines_of_one_run(file: &CalibrationFile) -> impl Iterator<Item = &Line> {
    let from_slopes = |line: &&Line| {
        let mut squares = file.squareness.iter();
        squares.any(|entry| {
            matches!(entry.source, SquarenessSource::Slopes { .. })
                && squareness_parts(entry.error).is_ok_and(|of| of.contains(&line.setup.error))
        })
    };
    let lines = file.measurements.iter();
    (lines.filter(from_slopes)).filter(|line| line.readings.most_runs() < 2)
}

/// Mean slope of the lines of each straightness error, from the slopes in `removed`, and notes on lines with
/// contradictory slopes.
pub(crate) fn slopes(
    removed: &[RemovedSlope<'_>],
    tilted: &Machine,
    artefacts: &ArtefactPoses,
) -> Result<(Slopes, Vec<(ErrorName, String)>), ModelError> {
    let mut of_errors: BTreeMap<ErrorName, Vec<(&RemovedSlope<'_>, Urad)>> = BTreeMap::new();
    for of in removed {
        let slope = of.slope - held_slope(of.line, tilted, artefacts)?;
        let all = of_errors.entry(of.line.setup.error).or_default();
        all.push((of, slope));
    }
    let mut slopes = Slopes::new();
    let mut contradictions = Vec::new();
    for (error, all) in of_errors {
        let direction = tilted.chain().joints()[tilted.index_of(error.axis)?].direction;
        let along_mcs = direction[error.axis.mcs_index()].signum();
        let sum: f64 = all.iter().map(|(_, slope)| slope.0).sum();
        slopes.insert(error, Urad(along_mcs * sum / all.len() as f64));
        contradictions.extend(contradiction(&all).map(|text| (error, text)));
    }
    Ok((slopes, contradictions))
}

/// Note on the steepest and the flattest line of an error if noise does not explain the difference of their slopes.
fn contradiction(all: &[(&RemovedSlope<'_>, Urad)]) -> Option<String> {
    let by_slope =
        |a: &&(&RemovedSlope<'_>, Urad), b: &&(&RemovedSlope<'_>, Urad)| a.1.0.total_cmp(&b.1.0);
    let (low, low_slope) = all.iter().min_by(by_slope)?;
    let (high, high_slope) = all.iter().max_by(by_slope)?;
    let noise = low.noise?.0.hypot(high.noise?.0);
    let apart = high_slope.0 - low_slope.0;
    (apart > (TIMES_NOISE * noise).max(NEVER_BELOW_URAD)).then(|| {
        format!(
            "{}: the slopes of {} and {} contradict each other: {:.1} and {:.1} µrad, with a noise of {noise:.2} µrad. A squareness from their mean is that of neither; state the reference of each line, or leave one out",
            low.line.setup.error,
            low.line.file.display(),
            high.line.file.display(),
            low_slope.0,
            high_slope.0,
        )
    })
}

/// Slope of a line due to all known errors of the machine at the held positions, except the errors of the measured axis
/// itself: the slope that a perfect instrument reads along an ideally straight axis in its nominal direction.
fn held_slope(
    line: &Line,
    tilted: &Machine,
    artefacts: &ArtefactPoses,
) -> Result<Urad, ModelError> {
    /// Half the distance over which the slope is evaluated, mm; the readings are a straight line, so its size has no
    /// effect.
    const REACH_MM: f64 = 500.0;
    let others = OtherErrors::new(line, tilted, artefacts)?;
    let ends = others.readings([-REACH_MM, REACH_MM].into_iter())?;
    let read = (ends[1] - ends[0]) / (2.0 * REACH_MM) * 1e3;
    Ok(Urad(read + others.reference_slope_urad()))
}

/// Every squareness of a file that is stated, or computed from the slopes of its two straightness errors.
pub(crate) fn squares(
    file: &CalibrationFile,
    slopes: &Slopes,
) -> Result<Vec<(ErrorName, Urad)>, CalibrateError> {
    let mut found = Vec::new();
    for entry in &file.squareness {
        found.extend(square(entry, slopes)?.map(|value| (entry.error, value)));
    }
    Ok(found)
}

/// Value of a squareness; `None` if it is computed from diagonals, which require all other errors.
fn square(entry: &Squareness, slopes: &Slopes) -> Result<Option<Urad>, CalibrateError> {
    let reference_angle = match entry.source {
        SquarenessSource::Value(value) => return Ok(Some(value)),
        SquarenessSource::Diagonals => return Ok(None),
        SquarenessSource::Slopes { reference_angle } => reference_angle,
    };
    let [first, second] = squareness_parts(entry.error)?;
    let slope = |straightness: ErrorName| {
        let found = slopes.get(&straightness).copied();
        found.ok_or(CalibrateError::NoSlope { squareness: entry.error, straightness })
    };
    let parts = [(first, slope(first)?), (second, slope(second)?)];
    Ok(Some(squareness(entry.error, reference_angle, parts)?))
}

pub(crate) struct Squares {
    pub(crate) errors: Vec<(ErrorName, Urad)>,
    pub(crate) notes: Vec<String>,
    pub(crate) undecided: BTreeSet<ErrorName>,
}

impl Diagonals {
    /// Squareness errors from the diagonals on a machine with all its other errors, µrad, with notes on their quality.
    pub(crate) fn squares(
        &self,
        machine: &Machine,
        reference_axes: [AxisName; 2],
    ) -> Result<Squares, CalibrateError> {
        let mut machine = machine.clone();
        for error in &self.errors {
            set_square(&mut machine, reference_axes, *error, Urad(0.0))?;
        }
        let mut observations = self.observations.clone();
        observations.machine = machine;
        let found = identify(&observations, |_, _| {})?;
        let square = |error: &ErrorName| {
            let (tilt, sign) = tilt_of(*error, reference_axes);
            let name = tilt.to_string();
            let parameter = found.parameters.iter().find(|p| p.name == name);
            match parameter.filter(|p| p.determined && p.given_zero.is_empty()) {
                Some(parameter) => Ok((*error, Urad(sign * parameter.value))),
                None => {
                    Err(CalibrateError::Diagonals { error: *error, files: self.files().collect() })
                }
            }
        };
        let errors = self.errors.iter().map(square).collect::<Result<_, _>>()?;
        let names: Vec<String> = self.errors.iter().map(ErrorName::to_string).collect();
        let names = names.join(" ");
        let notes = found.warnings.iter();
        let notes = notes.map(|note| format!("{names} from diagonals: {note}"));
        Ok(Squares { errors, notes: notes.collect(), undecided: found.undecided() })
    }

    fn files(&self) -> impl Iterator<Item = PathBuf> {
        let files = self.observations.observations.iter();
        files.map(|observation| PathBuf::from(&observation.file))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use volcomp_vocabulary::AxisName;

    use super::*;
    use crate::testing::{file, line, machine, name};

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

    fn with_tilts<'a>(file: &'a CalibrationFile, machine: &Machine) -> Linear<'a> {
        let (noise_urad, found_from) = (&BTreeMap::new(), &BTreeMap::new());
        linear(
            file,
            &Tilts { machine, noise_urad, found_from },
            (machine, &ArtefactPoses::of(machine, &[], [AxisName::X, AxisName::Y], |_| None)),
            || (),
        )
        .unwrap()
    }

    /// EXX measured 400 mm from the point at which errors are stated, along −Y: a yaw of 0.05
    /// µrad/mm adds −ECX · y = 0.05 q · 0.4 µm, which the stage subtracts.
    #[test]
    fn what_a_yaw_adds_over_its_lever_is_removed() {
        let mut positioning = line("EXX", |q| 0.01 * q + 0.05 * q * 0.4);
        positioning.setup.point_mcs = Some([0.0, -400.0, 0.0]);
        let file = file(vec![positioning]);
        let tilted = machine("ECX = { poly = [0, 0.05] }");
        let found = with_tilts(&file, &tilted);
        for q in [0.0, 500.0, 1000.0] {
            let value = found.fitted[0].branches.mean_at(q);
            assert!((value - 0.01 * q).abs() < 1e-9, "{value} at {q}");
        }
        assert!(found.notes.is_empty(), "{:?}", found.notes);
        let left_in = with_tilts(&file, &machine("")).notes;
        assert_eq!(
            left_in,
            ["ECX was not measured: EXX from EXX.csv keeps its part, over a lever of up to 400 mm"]
        );
    }
}
