//! Third stage: the slopes of the straightness lines, cleared of what the tilts of held axes add.

use std::collections::BTreeMap;

use volcomp_kinematics::{ErrorSource, nalgebra::Vector3, vector_from_rotation};
use volcomp_model::{Machine, ModelError, Temperatures};
use volcomp_vocabulary::{ErrorName, Urad};

use crate::{abbe::held_state, calibration_file::Line, locations::displaced};

/// The least-squares slope of each measured straightness error, by the coordinate of the machine coordinate system.
pub(crate) type Slopes = BTreeMap<ErrorName, Urad>;

/// The mean slope of the lines of each straightness error, from the slopes that were removed from them.
pub(crate) fn slopes(removed: &[(&Line, Urad)], tilted: &Machine) -> Result<Slopes, ModelError> {
    let mut sums: BTreeMap<ErrorName, (Urad, f64)> = BTreeMap::new();
    for (line, slope) in removed {
        let (sum, count) = sums.entry(line.setup.error).or_default();
        *sum = *sum + (*slope - held_slope(line, tilted)?);
        *count += 1.0;
    }
    let mean = |(error, (sum, count)): (ErrorName, (Urad, f64))| {
        let direction = tilted.chain().joints()[tilted.index_of(error.axis)?].direction;
        let along_mcs = direction[error.axis.mcs_index()].signum();
        Ok((error, Urad(along_mcs * sum.0 / count)))
    };
    sums.into_iter().map(mean).collect()
}

/// Slope that the tilts of the other axes give a line at their held positions.
///
/// A point of the tool, seen from the workpiece, goes along ε × u of every axis between the
/// workpiece and the measured one; a point of the workpiece, seen from the tool, along −ε × u of
/// every axis between the measured one and the tool.
fn held_slope(line: &Line, tilted: &Machine) -> Result<Urad, ModelError> {
    let index = tilted.index_of(line.setup.error.axis)?;
    let joints = tilted.chain().joints();
    let (tilting, sign) = if line.setup.point_is_on_tool_side(joints[index].side) {
        (0..index, 1.0)
    } else {
        (index + 1..joints.len(), -1.0)
    };
    let state = held_state(line, tilted)?;
    let none = Temperatures::new();
    let source = tilted.source(&none);
    // Errors are stated in the frame of what carries their axis; held rotary axes turn these frames.
    let chain = tilted.chain();
    let tilt_mcs = tilting.fold(Vector3::zeros(), |sum: Vector3<f64>, held| {
        let carried = chain.carrier_pose(held, &state).rotation;
        // A rotary axis that is held off 0 and whose line is tilted stands askew.
        let askew = displaced(&joints[held], &source.location(held), state.q[held]);
        let tilt = source.error_motion(held, &state).angular_rad;
        sum + carried * (tilt + vector_from_rotation(&askew.rotation))
    });
    let own = chain.carrier_pose(index, &state).rotation;
    let tilt = own.transpose() * tilt_mcs;
    let slope = tilt.cross(&joints[index].direction) * sign;
    Ok(Urad(slope[line.setup.error.component.mcs_index()] * 1e6))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{line, machine, name};

    /// Two lines of Y with slopes of 10 and 14 µrad, seen from a table that X has yawed by 6 µrad at X = 300 and by
    /// 2 µrad at X = 100: a yaw c about +Z turns the line by −c, so 10 + 6 and 14 + 2 remain.
    #[test]
    fn the_yaw_of_a_held_table_is_taken_off_a_slope() {
        let tilted = machine("ECX = { poly = [0, 0.02] }");
        let mut lines = [line("EXY", |_| 0.0), line("EXY", |_| 0.0)];
        lines[0].setup.at[0] = 300.0;
        lines[1].setup.at[0] = 100.0;
        let removed = [(&lines[0], Urad(10.0)), (&lines[1], Urad(14.0))];
        let found = slopes(&removed, &tilted).unwrap();
        let slope = found[&name("EXY")];
        assert!((slope - Urad(16.0)).abs() < Urad(1e-9), "{slope}");
    }
}
