//! The errors beside the best rigid motion of the workpiece: over the nodes of a map, and over poses of all axes.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use volcomp_kinematics::{State, nalgebra::Vector3};
use volcomp_model::{Ensemble, Lengths, Machine, RigidSums};
use volcomp_vocabulary::AxisName;

use super::work::ErrorAt;
use crate::{
    answers::{
        ByAxis,
        map::{AllAxes, AllAxesUncertainty},
    },
    commands::in_degrees,
    failure::Failure,
    progress,
};

/// Poses of all axes.
const POSES: usize = 1000;
/// Seed of the poses: they are the same each time.
const SEED: u64 = 1;

/// How large errors of position are as they are, and beside one rigid motion, mm.
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

/// The errors over poses of all axes, drawn over their travels, and with an ensemble their uncertainty; `None` of a machine that has no axes but X, Y and Z.
pub(super) fn all_axes(
    machine: &Machine,
    errors: &ErrorAt<'_>,
    ensemble: Option<&Ensemble>,
) -> Result<Option<AllAxes>, Failure> {
    let on_grid = [AxisName::X, AxisName::Y, AxisName::Z];
    if machine
        .axes()
        .iter()
        .all(|axis| on_grid.contains(&axis.name))
    {
        return Ok(None);
    }
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let mut drawn = || {
        let axes = machine.axes().iter();
        let at = axes.map(|axis| {
            let [low, high] = axis.travel;
            (axis.name, low + (high - low) * random.random::<f64>())
        });
        machine.state(&at.collect::<Vec<_>>())
    };
    let poses: Vec<State> = (0..POSES).map(|_| drawn()).collect::<Result<_, _>>()?;
    let found: Vec<[f64; 6]> = poses.par_iter().map(errors).collect();
    let chain = machine.chain();
    let tools = poses.iter().map(|pose| {
        let tool_axis = chain.ideal_pose(pose).rotation * chain.tool_axis();
        (chain.ideal_tip_mm(pose), tool_axis)
    });
    let found: Vec<_> = tools.zip(found).collect();
    let mut sums = RigidSums::default();
    for ((tip, _), error) in &found {
        sums.take(tip, &position(error));
    }
    let motion = sums.motion();
    let [mut lengths, mut left] = [Lengths::default(); 2];
    let [mut turns, mut turns_left] = [Turns::default(); 2];
    for ((tip, tool_axis), error) in &found {
        let [.., a, b, c] = *error;
        let turn = Vector3::new(a, b, c);
        lengths.take(&position(error));
        left.take(&motion.left_mm(tip, &position(error)));
        turns.take(&turn, tool_axis);
        turns_left.take(&motion.left_rad(&turn), tool_axis);
    }
    Ok(Some(AllAxes {
        poses: POSES,
        rms_um: 1e3 * lengths.rms(),
        max_um: 1e3 * lengths.max(),
        form_rms_um: 1e3 * left.rms(),
        form_max_um: 1e3 * left.max(),
        rms_urad: 1e6 * turns.whole.rms(),
        form_rms_urad: 1e6 * turns_left.whole.rms(),
        tilt_rms_urad: 1e6 * turns.tilt.rms(),
        form_tilt_rms_urad: 1e6 * turns_left.tilt.rms(),
        about_tool_rms_urad: 1e6 * turns.about_tool.rms(),
        form_about_tool_rms_urad: 1e6 * turns_left.about_tool.rms(),
        uncertainty: ensemble.map(|ensemble| uncertainty(machine, ensemble, &poses)),
    }))
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
    let at = most.map(|(_, pose)| {
        let stands = machine.axes().iter().zip(&pose.q);
        stands.map(|(axis, &q)| (axis.name, in_degrees(axis.name.kind(), q)))
    });
    AllAxesUncertainty {
        rms_um: 1e3 * lengths.rms(),
        largest_um: 1e3 * lengths.max(),
        at: at.into_iter().flatten().collect::<ByAxis>(),
        rms_urad: 1e6 * turns.rms(),
        largest_urad: 1e6 * turns.max(),
    }
}
