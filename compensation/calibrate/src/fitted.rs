//! Curves fitted to the lines of one error, and the readings to which they were fitted.

use volcomp_kinematics::{Joint, nalgebra::Vector3};
use volcomp_metrology::MotionKind;
use volcomp_model::{Axis, Machine, ModelError, Source};
use volcomp_vocabulary::{Component, ErrorName};

use crate::{
    branches::Branches,
    calibration_file::{CalibrationFile, lines_of},
    error::CalibrateError,
    profile::{Profile, files_of},
};

/// A fitted error with its curve for each direction, zero at the reference.
pub(crate) struct Fitted {
    pub(crate) error: ErrorName,
    pub(crate) branches: Branches,
    pub(crate) lines: Vec<FittedLine>,
}

impl Fitted {
    pub(crate) fn set_in(&self, machine: &mut Machine) -> Result<(), ModelError> {
        machine.set_error(self.error, self.branches.clone().into_curve())
    }
}

pub(crate) fn joint_of(machine: &Machine, error: ErrorName) -> Result<Joint, ModelError> {
    Ok(machine.chain().joints()[machine.index_of(error.axis)?])
}

/// Period of errors along an axis, deg; `None` if the axis covers less than a full turn, since the errors at both ends of its travel are then
/// unrelated.
fn period_of(axis: &Axis) -> Option<f64> {
    let [low, high] = axis.travel;
    let turns = axis.name.is_rotary() && high - low >= FULL_TURN_DEG * (1.0 - 1e-9);
    turns.then_some(FULL_TURN_DEG)
}

const FULL_TURN_DEG: f64 = 360.0;

/// Fits the profiles of an error. Returns its curves, zero at the reference (a straightness has
/// already lost its constant with its line), and the aligned profiles. A positioning deviation
/// along an oblique axis gives one curve for each component of the direction of the axis.
pub(crate) fn fit<'a>(
    file: &CalibrationFile,
    error: ErrorName,
    profiles: Vec<Profile<'a>>,
) -> Result<(Vec<Fitted>, Vec<Profile<'a>>), CalibrateError> {
    let machine = &file.machine;
    let profiles = match machine.axis(error.axis) {
        Some(axis) => {
            let profiles = profiles.into_iter();
            profiles.map(|profile| profile.within_travel(axis)).collect()
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

/// Errors to which readings of `error` contribute, each with its factor: a positioning deviation p of the coordinate contributes δ = u·p (rotary:
/// ε = u·p), where u is the direction of the axis.
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

/// One measured line of an error, aligned with its curve.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedLine {
    /// The error that the curve describes.
    pub error: ErrorName,
    /// Index of the line in [`CalibrationFile::measurements`]; `None` if its readings were computed from several other lines.
    pub line: Option<usize>,
    /// Files of the line's readings.
    pub sources: Vec<Source>,
    /// Targets (mm or deg, ascending) and mean readings (µm or µrad), forward and backward. The
    /// contributions of tilts and other axes are subtracted, and for a straightness its line. The
    /// readings are aligned with the first line of the error, and zero at the reference like the
    /// curve. Empty for a direction that was not run.
    pub points: [Vec<(f64, f64)>; 2],
    /// Factor from a difference of readings to a difference of the error: 1, or for an oblique axis the component of its direction.
    pub factor: f64,
}

impl FittedLine {
    pub(crate) fn new(
        file: &CalibrationFile,
        error: ErrorName,
        profile: &Profile<'_>,
        (factor, zero): (f64, f64),
    ) -> Self {
        let mut lines = file.measurements.iter();
        Self {
            error,
            line: lines.position(|line| std::ptr::eq(line, profile.line)),
            sources: profile.line.sources.clone(),
            factor,
            points: profile.points.each_ref().map(|points| {
                let points = points.iter();
                points.map(|(target, value)| (*target, (value - zero) * factor)).collect()
            }),
        }
    }
}
