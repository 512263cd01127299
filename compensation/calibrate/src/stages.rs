//! Stages from readings to a machine: angular errors, linear errors without Abbe errors, slopes of the straightness lines, squareness.

use std::collections::BTreeMap;

use volcomp_metrology::squareness_parts;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, ErrorName, Urad};

use crate::{
    angular::{angular, from_parallel_lines},
    artefact_poses::ArtefactPoses,
    branches::FittedCurve,
    calibration_file::{CalibrationFile, Line, SquarenessSource, measured},
    checks::contradictions::Tilts,
    error::CalibrateError,
    fitted::{Fitted, FittedLine},
    linear::linear,
    squareness::{set_square, tilt_of},
    squares::{slopes, square_uncertainties, squares},
};

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
