//! Third stage: squareness errors. A squareness is stated, or follows from diagonals (ISO 230-6), or from the slopes of
//! the straightness lines minus the contributions of the tilts of held axes.

use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

use volcomp_identify::identify;
use volcomp_metrology::{
    Direction, Measurement, Reading, ReferenceKind, RunAlignment, SlopeUncertainty,
    angular_method_um, slope_gain, slope_gain_of_tilts, squareness, squareness_parts,
};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{AxisName, ErrorName, Urad};

use crate::{
    artefact_poses::ArtefactPoses,
    calibration_file::{CalibrationFile, Diagonals, Line, Squareness, SquarenessSource},
    error::CalibrateError,
    line_of_sight::OtherErrors,
    profile::Profile,
    setup::Method,
    squareness::{set_square, tilt_of},
};

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
