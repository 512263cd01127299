//! Third stage: squareness errors. They follow from the slopes of the straightness lines, minus the contributions of
//! the tilts of held axes; from stated values; or from diagonals (ISO 230-6).

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

use volcomp_identify::identify;
use volcomp_metrology::{RunAlignment, slope_uncertainty_with_runs, squareness, squareness_parts};
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
/// Slope differences up to this are irrelevant for any machine tool, µrad.
const NEVER_BELOW_URAD: f64 = 0.5;

/// Least-squares slope of each measured straightness error, by the coordinate of the machine coordinate system.
pub(crate) type Slopes = BTreeMap<ErrorName, Urad>;

pub(crate) struct RemovedSlope<'a> {
    pub(crate) line: &'a Line,
    pub(crate) slope: Urad,
    /// Standard deviation of the slope: from repeated runs, otherwise from the scatter of the targets about the line; `None`
    /// if neither is available.
    pub(crate) noise: Option<Urad>,
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
        let of_slope = match profile.line.setup.method {
            Method::Direct => slope_uncertainty_with_runs(&profile.line.readings, of_line),
            Method::Angular { .. } => of_line,
        };
        Self {
            line: profile.line,
            slope: profile.removed,
            noise: of_slope.map(Urad),
        }
    }
}

/// Mean slope of the lines of each straightness error, from the slopes removed from them, and notes on lines whose slopes contradict each other.
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

/// Note on the steepest and the flattest line of an error if noise does not explain their difference.
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

/// Slope of a line due to all known errors of the machine at the held positions except those of the travel along the
/// line: the reading of a perfect instrument along an axis that is straight and has the right direction.
fn held_slope(
    line: &Line,
    tilted: &Machine,
    artefacts: &ArtefactPoses,
) -> Result<Urad, ModelError> {
    /// Half the distance over which the slope is read, mm; the reading is a straight line.
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

/// `None` if the squareness is computed from diagonals, which need all other errors.
fn square(entry: &Squareness, slopes: &Slopes) -> Result<Option<Urad>, CalibrateError> {
    let reference_angle = match entry.source {
        SquarenessSource::Value(value) => return Ok(Some(value)),
        SquarenessSource::Diagonals => return Ok(None),
        SquarenessSource::Slopes { reference_angle } => reference_angle,
    };
    let [first, second] = squareness_parts(entry.error)?;
    let slope = |straightness: ErrorName| {
        let found = slopes.get(&straightness).copied();
        found.ok_or(CalibrateError::NoSlope {
            squareness: entry.error,
            straightness,
        })
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
                None => Err(CalibrateError::Diagonals {
                    error: *error,
                    files: self.files().collect(),
                }),
            }
        };
        let errors = self.errors.iter().map(square).collect::<Result<_, _>>()?;
        let names: Vec<String> = self.errors.iter().map(ErrorName::to_string).collect();
        let names = names.join(" ");
        let notes = found.warnings.iter();
        let notes = notes.map(|note| format!("{names} from diagonals: {note}"));
        Ok(Squares {
            errors,
            notes: notes.collect(),
            undecided: found.undecided(),
        })
    }

    fn files(&self) -> impl Iterator<Item = PathBuf> {
        let files = self.observations.observations.iter();
        files.map(|observation| PathBuf::from(&observation.file))
    }
}
