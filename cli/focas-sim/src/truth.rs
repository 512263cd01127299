//! True errors of the simulated machine: its tool error without and with the applied shifts.

use std::path::Path;

use serde::Serialize;
use volcomp_kinematics::{Chain, State, actual_pose};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisName, Direction, Displacement};

use crate::error::{SimError, letters};

pub(crate) struct Truth {
    machine: Machine,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Miss {
    /// Actual minus ideal position of the tool tip in workpiece axes, µm.
    pub(crate) position_um: [f64; 3],
    /// Angle between the actual and the ideal tool axis, µrad.
    pub(crate) tool_axis_urad: f64,
}

impl Miss {
    pub(crate) fn distance_um(&self) -> f64 {
        self.position_um.iter().map(|x| x * x).sum::<f64>().sqrt()
    }
}

/// Pose of the machine in the axis order and the units of the control: mm and deg.
pub(crate) struct Place<'a> {
    pub(crate) axes: &'a [AxisName],
    /// Commanded positions, without shifts.
    pub(crate) commanded: &'a [f64],
    pub(crate) shifts: &'a [f64],
    /// Direction of the last travel of each axis that has moved.
    pub(crate) approach: &'a [Option<Direction>],
}

impl Truth {
    pub(crate) fn read(path: &Path) -> Result<Self, SimError> {
        Ok(Self { machine: Machine::read(path)? })
    }

    /// Axes of the machine in the order X Y Z A B C U V W.
    pub(crate) fn axes(&self) -> Vec<AxisName> {
        let has = |name: &AxisName| self.machine.axis(*name).is_some();
        AxisName::ALL.into_iter().filter(has).collect()
    }

    pub(crate) fn check(&self, axes: &[AxisName]) -> Result<(), SimError> {
        match self.axes().iter().find(|name| !axes.contains(name)) {
            None => Ok(()),
            Some(lacking) => Err(SimError::input(
                "--axes",
                letters(axes),
                format!(
                    "the axis {lacking} too: the machine {} of --truth has it",
                    self.machine.name
                ),
            )),
        }
    }

    pub(crate) fn misses(&self, place: &Place<'_>) -> [Miss; 2] {
        let chain = self.machine.chain();
        let commanded = self.state(place, false);
        let ideal = Tool::of(chain, &chain.ideal_pose(&commanded));
        [false, true].map(|shifted| {
            let source = self.machine.source(&Temperatures::new());
            let pose = actual_pose(chain, &source, &self.state(place, shifted));
            Tool::of(chain, &pose).minus(&ideal)
        })
    }

    /// Tool tip of the ideal machine in workpiece axes, mm.
    pub(crate) fn ideal_tip_mm(&self, place: &Place<'_>) -> [f64; 3] {
        let state = self.state(place, false);
        self.machine.chain().ideal_tip_mm(&state).into()
    }

    fn state(&self, place: &Place<'_>, shifted: bool) -> State {
        let mut state = State::default();
        let values = place.commanded.iter().zip(place.shifts);
        for ((axis, (commanded, shift)), approach) in
            place.axes.iter().zip(values).zip(place.approach)
        {
            // Axes that the machine does not have are ignored.
            if let Ok(index) = self.machine.index_of(*axis) {
                let coordinate = commanded + if shifted { *shift } else { 0.0 };
                let coordinate = Displacement::from_coordinate(axis.kind(), coordinate);
                state.q[index] = coordinate.mm_or_rad();
                state.approach[index] = *approach;
            }
        }
        state
    }
}

/// Tool relative to the workpiece: tip (mm) and axis.
struct Tool {
    tip_mm: [f64; 3],
    axis: [f64; 3],
}

impl Tool {
    fn of(chain: &Chain, pose: &volcomp_kinematics::Pose) -> Self {
        Self {
            tip_mm: pose.transform_point(&chain.tool_tip_mm()).into(),
            axis: (pose.rotation * chain.tool_axis()).into(),
        }
    }

    fn minus(&self, ideal: &Self) -> Miss {
        let [x, y, z] = std::array::from_fn(|i| (self.tip_mm[i] - ideal.tip_mm[i]) * 1e3);
        let [i, j, k] = self.axis;
        let [l, m, n] = ideal.axis;
        // The length of the cross product of two unit vectors is the sine of the angle between them.
        let sine = [j * n - k * m, k * l - i * n, i * m - j * l];
        Miss {
            position_um: [x, y, z],
            tool_axis_urad: sine.iter().map(|s| s * s).sum::<f64>().sqrt() * 1e6,
        }
    }
}
