//! The curves that the lines of one error make.

use volcomp_kinematics::{Joint, nalgebra::Vector3};
use volcomp_metrology::MotionKind;
use volcomp_model::{Axis, Machine, ModelError};
use volcomp_vocabulary::{Component, ErrorName};

use crate::{
    branches::Branches,
    calibration_file::{CalibrationFile, Line},
    error::CalibrateError,
    fitted_line::FittedLine,
    profile::{Profile, files_of},
    with_files,
};

/// A fitted error: its name and its curve for each direction, zero at the reference.
pub(crate) struct Fitted {
    pub(crate) error: ErrorName,
    pub(crate) branches: Branches,
    /// The readings that the curves follow.
    pub(crate) lines: Vec<FittedLine>,
}

impl Fitted {
    /// The machine with this error in place of what it had.
    pub(crate) fn set_in(&self, machine: &mut Machine) -> Result<(), ModelError> {
        machine.set_error(self.error, self.branches.clone().into_curve())
    }
}

/// The errors that a file measures, each once: first the angular ones, which Abbe needs, then the linear ones.
pub(crate) fn measured(file: &CalibrationFile) -> Vec<ErrorName> {
    let mut names: Vec<ErrorName> = file.measurements.iter().map(|l| l.setup.error).collect();
    names.sort_unstable_by_key(|name| (!name.component.is_angular(), *name));
    names.dedup();
    names
}

/// The lines of one error, in the order of the file.
pub(crate) fn lines_of(file: &CalibrationFile, error: ErrorName) -> impl Iterator<Item = &Line> {
    let lines = file.measurements.iter();
    lines.filter(move |line| line.setup.error == error)
}

/// The notes from reading the measurement files, each with the names of all files before it that it is about.
pub(crate) fn notes_of(lines: &[Line]) -> Vec<String> {
    with_files(lines.iter().flat_map(|line| {
        let file = line.file.display().to_string();
        let notes = line.readings.notes.iter();
        notes.map(move |note| (file.clone(), note.clone()))
    }))
}

/// The joint of the axis of an error.
pub(crate) fn joint_of(machine: &Machine, error: ErrorName) -> Result<Joint, ModelError> {
    Ok(machine.chain().joints()[machine.index_of(error.axis)?])
}

/// The period of what repeats along an axis, deg: that of one that turns all the way round. On an axis that does not, the error at one
/// end of the travel has nothing to do with that at the other.
fn period_of(axis: &Axis) -> Option<f64> {
    let [low, high] = axis.travel;
    let turns = axis.name.is_rotary() && high - low >= FULL_TURN_DEG * (1.0 - 1e-9);
    turns.then_some(FULL_TURN_DEG)
}

const FULL_TURN_DEG: f64 = 360.0;

/// Fits the profiles of an error: its curves, zero at the reference (a straightness has lost its constant with its
/// line), and the profiles as they were moved to agree. A positioning deviation along an oblique axis makes a curve
/// for each component of the axis's direction.
pub(crate) fn fit<'a>(
    file: &CalibrationFile,
    error: ErrorName,
    profiles: Vec<Profile<'a>>,
) -> Result<(Vec<Fitted>, Vec<Profile<'a>>), CalibrateError> {
    let machine = &file.machine;
    let profiles = match machine.axis(error.axis) {
        Some(axis) => {
            let profiles = profiles.into_iter();
            profiles
                .map(|profile| profile.within_travel(axis))
                .collect()
        }
        None => profiles,
    };
    let choice = profiles.iter().find_map(|profile| profile.line.curve);
    let period = machine.axis(error.axis).and_then(period_of);
    let (branches, profiles) = Branches::fit(error, choice.unwrap_or_default(), period, profiles)?;
    let zero = if MotionKind::of(error) == MotionKind::Straightness {
        0.0
    } else {
        branches.mean_at(file.reference_at(machine.index_of(error.axis)?))
    };
    let mut fitted = Vec::new();
    for (filled, share) in shares(error, &joint_of(machine, error)?.direction) {
        if filled != error && lines_of(file, filled).next().is_some() {
            return Err(CalibrateError::Oblique {
                error,
                files: files_of(&profiles),
                axis: error.axis,
                other: filled,
            });
        }
        let lines = profiles.iter();
        let lines = lines.map(|profile| FittedLine::new(file, filled, profile, (share, zero)));
        fitted.push(Fitted {
            error: filled,
            branches: branches.scaled(share, zero),
            lines: lines.collect(),
        });
    }
    Ok((fitted, profiles))
}

/// The errors that readings of `error` make, with the factor of each: a positioning deviation p of
/// the coordinate enters as δ = u·p (rotary: ε = u·p), u the direction of the axis.
fn shares(error: ErrorName, direction: &Vector3<f64>) -> Vec<(ErrorName, f64)> {
    if MotionKind::of(error) != MotionKind::Positioning {
        return vec![(error, 1.0)];
    }
    let of_kind = |component: &Component| component.is_angular() == error.component.is_angular();
    let components = Component::ALL.into_iter().filter(of_kind);
    let shares = components.map(|component| {
        let name = ErrorName::motion(component, error.axis);
        (name, direction[component.mcs_index()])
    });
    shares.filter(|(_, share)| share.abs() > 1e-12).collect()
}
