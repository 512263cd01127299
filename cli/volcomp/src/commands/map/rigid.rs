//! The errors after alignment of the workpiece: over the nodes of a map, and over poses of all axes.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::{State, nalgebra::Vector3};
use volcomp_model::{
    Ensemble, ErrorField, Lengths, Machine, UNCERTAINTY_POSES, poses_of_all_axes, volumetric,
};

use super::work::ErrorAt;
use crate::{commands::ByAxis, failure::Failure, progress};

/// The volumetric error over poses of all axes, the same ones each time.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct AllAxes {
    /// Number of poses.
    pub(crate) poses: usize,
    /// Root of the mean square of the length of the position error, µm.
    pub(crate) rms_um: f64,
    /// Length of the largest position error, µm.
    pub(crate) max_um: f64,
    /// Root of the mean square after alignment of the workpiece, µm.
    pub(crate) form_rms_um: f64,
    /// Largest error of the tool tip after alignment, searched from the worst poses, µm.
    pub(crate) form_max_um: f64,
    /// The pose of that error, mm and deg.
    pub(crate) at: ByAxis,
    /// Largest tilt of the tool axis after alignment, µrad.
    pub(crate) tilt_max_urad: f64,
    /// Root of the mean square of the rotation error, µrad.
    pub(crate) rms_urad: f64,
    /// The same after alignment, µrad.
    pub(crate) form_rms_urad: f64,
    /// Root of the mean square of the tilt of the tool axis: the part of the rotation error across it, µrad.
    pub(crate) tilt_rms_urad: f64,
    /// The same after alignment, µrad.
    pub(crate) form_tilt_rms_urad: f64,
    /// Root of the mean square of the rotation error about the tool axis, which no tool that turns shows, µrad.
    pub(crate) about_tool_rms_urad: f64,
    /// The same after alignment, µrad.
    pub(crate) form_about_tool_rms_urad: f64,
    /// The standard uncertainty of the errors over these poses; only with `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) uncertainty: Option<AllAxesUncertainty>,
}

/// The standard uncertainty (k = 1) of the errors over poses of all axes.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct AllAxesUncertainty {
    /// Root of the mean square of its length, position, µm.
    pub(crate) rms_um: f64,
    /// The largest length, position, µm.
    pub(crate) largest_um: f64,
    /// The pose with the largest, mm and deg.
    pub(crate) at: ByAxis,
    /// Root of the mean square of its length, rotation, µrad.
    pub(crate) rms_urad: f64,
    /// The largest length, rotation, µrad.
    pub(crate) largest_urad: f64,
}

/// How large errors of position are as they are, and after alignment, mm.
#[derive(Clone, Copy)]
pub(super) struct Beside {
    pub(super) as_they_are: Lengths,
    pub(super) left: Lengths,
}

/// How large rotations are: whole, across the tool axis, which they tilt, and about it, which no tool that turns shows.
#[derive(Clone, Copy, Default)]
struct Turns {
    whole: Lengths,
    tilt: Lengths,
    about_tool: Lengths,
}

impl Turns {
    fn take(&mut self, turn: &Vector3<f64>, tool_axis: &Vector3<f64>) {
        let about = tool_axis * tool_axis.dot(turn);
        self.whole.take(turn);
        self.tilt.take(&(turn - about));
        self.about_tool.take(&about);
    }
}

/// The position part of an error.
pub(super) fn position([x, y, z, ..]: &[f64; 6]) -> Vector3<f64> {
    Vector3::new(*x, *y, *z)
}

/// The errors over poses of all axes, and with an ensemble their uncertainty.
pub(super) fn all_axes(
    machine: &Machine,
    errors: &ErrorAt<'_>,
    ensemble: Option<&Ensemble>,
) -> Result<AllAxes, Failure> {
    let field = ErrorField {
        tool: "",
        machine,
        errors,
    };
    let volumetric = volumetric(&[field])?;
    let motion = volumetric.alignment;
    let poses = poses_of_all_axes(machine)?;
    let found: Vec<[f64; 6]> = poses.par_iter().map(errors).collect();
    let chain = machine.chain();
    let tools = poses
        .iter()
        .map(|pose| chain.ideal_pose(pose).rotation * chain.tool_axis());
    let [mut turns, mut turns_left] = [Turns::default(); 2];
    for (tool_axis, error) in tools.zip(&found) {
        let [.., a, b, c] = *error;
        let turn = Vector3::new(a, b, c);
        let tool_axis = &tool_axis;
        turns.take(&turn, tool_axis);
        turns_left.take(&motion.left_rad(&turn), tool_axis);
    }
    Ok(AllAxes {
        poses: volumetric.poses,
        rms_um: 1e3 * volumetric.rms_mm,
        max_um: 1e3 * volumetric.max_mm,
        form_rms_um: 1e3 * volumetric.position_rms_mm,
        form_max_um: 1e3 * volumetric.position.value,
        at: volumetric.position.at.into_iter().collect(),
        tilt_max_urad: 1e6 * volumetric.tilt.value,
        rms_urad: 1e6 * turns.whole.rms(),
        form_rms_urad: 1e6 * turns_left.whole.rms(),
        tilt_rms_urad: 1e6 * turns.tilt.rms(),
        form_tilt_rms_urad: 1e6 * turns_left.tilt.rms(),
        about_tool_rms_urad: 1e6 * turns.about_tool.rms(),
        form_about_tool_rms_urad: 1e6 * turns_left.about_tool.rms(),
        uncertainty: ensemble.map(|ensemble| {
            uncertainty(
                machine,
                ensemble,
                &poses[..UNCERTAINTY_POSES.min(poses.len())],
            )
        }),
    })
}

/// How uncertain the errors are over poses of all axes.
fn uncertainty(machine: &Machine, ensemble: &Ensemble, poses: &[State]) -> AllAxesUncertainty {
    let bar = progress::bar(poses.len(), "poses");
    let of = |pose: &State| {
        let six = ensemble.standard_uncertainty(pose);
        bar.inc(1);
        six
    };
    let found: Vec<[f64; 6]> = poses.par_iter().map(of).collect();
    bar.finish_and_clear();
    let [mut lengths, mut turns] = [Lengths::default(); 2];
    let mut most: Option<(f64, &State)> = None;
    for (six, pose) in found.iter().zip(poses) {
        let [.., a, b, c] = *six;
        let length = position(six);
        lengths.take(&length);
        turns.take(&Vector3::new(a, b, c));
        if most.is_none_or(|(before, _)| length.norm() > before) {
            most = Some((length.norm(), pose));
        }
    }
    AllAxesUncertainty {
        rms_um: 1e3 * lengths.rms(),
        largest_um: 1e3 * lengths.max(),
        at: most.map_or_else(ByAxis::new, |(_, pose)| machine.coordinates(pose)),
        rms_urad: 1e6 * turns.rms(),
        largest_urad: 1e6 * turns.max(),
    }
}
