//! The errors of one axis outside its table, and the compiled machine as an error source.

use volcomp_kinematics::{ErrorMotion, ErrorSource, State, nalgebra::Vector3};

use crate::{
    machine::{CompiledMachine, Thermal},
    parts::branch_index,
    table::{Baseline, Registers, WIDE},
};

impl CompiledMachine {
    /// Adds errors over two coordinates and thermal errors, transformed to the tool tip like those of the tables.
    pub(crate) fn add_patches(&self, twist: &mut [f64; WIDE], index: usize, state: &State) {
        let axis = &self.axes[index];
        let Thermal { at_tip, slope_mm, .. } = &axis.thermal;
        for (lane, part) in twist.iter_mut().zip(at_tip) {
            *lane += part;
        }
        for (lane, slope) in twist.iter_mut().zip(slope_mm) {
            *lane += slope * state.q[index];
        }
        for compiled in &axis.patches {
            let patch = &compiled.patch;
            let at = compiled.looked_at.map(|looked_at| {
                self.axes.get(looked_at).map_or(0.0, |axis| axis.looked_up(state.q[looked_at]))
            });
            let value = compiled.value(at) * patch.weights[branch_index(state.approach[index])];
            twist[patch.component.index()] += value;
            if patch.component.is_angular() {
                let mut tilt = Vector3::zeros();
                tilt[patch.component.mcs_index()] = value;
                let carried = tilt.cross(&axis.arm_mm);
                for (lane, part) in twist.iter_mut().zip(carried.iter()) {
                    *lane += part;
                }
            }
        }
    }
}

impl ErrorSource for CompiledMachine {
    /// The error motion at the axis's point, from its table, its errors over two coordinates and its thermal errors.
    fn error_motion(&self, index: usize, state: &State) -> ErrorMotion {
        let Some(axis) = self.axes.get(index) else {
            return ErrorMotion::ZERO;
        };
        let (q, head) = (state.q[index], &axis.heads[branch_index(state.approach[index])]);
        let mut twist = Baseline.value(&self.tables, head, axis.looked_up(q));
        self.add_patches(&mut twist, index, state);
        let [x, y, z, a, b, c, ..] = twist;
        let constant = &self.folded.constant[index];
        let tilt = Vector3::new(a, b, c) - constant.angular_rad;
        let at_tip = Vector3::new(x, y, z) - constant.linear_mm - self.folded.slide[index] * q;
        ErrorMotion { linear_mm: at_tip - tilt.cross(&axis.arm_mm), angular_rad: tilt }
    }

    fn location(&self, index: usize) -> ErrorMotion {
        *self.location.get(index).unwrap_or(&ErrorMotion::ZERO)
    }

    fn assembly(&self, index: usize) -> ErrorMotion {
        *self.assembly.get(index).unwrap_or(&ErrorMotion::ZERO)
    }
}
