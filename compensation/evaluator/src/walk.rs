//! The walk along the chain from the tool to the workpiece.
//!
//! Every axis adds its errors at the current position of the tip, and then moves the tip.

use volcomp_kinematics::{ErrorMotion, ErrorSource, State, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, Direction};

use crate::{
    machine::{CompiledAxis, CompiledMachine, Evaluation, Thermal},
    parts::branch_index,
    table::{Baseline, Registers, WIDE},
    turn::Turn,
};

/// Receives, for each rotary axis that the walk passes, its rotation and the position of the tip relative to the axis's
/// point.
pub(crate) trait Turns {
    fn turned(&mut self, index: usize, turn: Turn, lever_mm: Vector3<f64>);
}

/// Evaluations without a correction do not need the rotations.
impl Turns for () {
    #[inline(always)]
    fn turned(&mut self, _: usize, _: Turn, _: Vector3<f64>) {}
}

/// The tip during the walk: its offset from its position at machine zero, the sum of the errors, and the displacement
/// due to tilts, mm and rad.
struct Tip<R> {
    registers: R,
    from_zero: Vector3<f64>,
    errors: [f64; WIDE],
    carried: Vector3<f64>,
}

impl<R: Registers> Tip<R> {
    #[inline(always)]
    fn new(registers: R, start: &ErrorMotion) -> Self {
        Self {
            registers,
            from_zero: Vector3::zeros(),
            errors: as_lanes(start),
            carried: Vector3::zeros(),
        }
    }

    /// Adds an error motion whose displacement is stated at the tip at machine zero.
    #[inline(always)]
    fn add(&mut self, error: &[f64; WIDE]) {
        self.errors = self.registers.sum(&self.errors, error);
        self.carry(error);
    }

    /// Adds the displacement that a tilt causes at the tip because of its offset from its position at machine zero.
    #[inline(always)]
    fn carry(&mut self, &[_, _, _, a, b, c, ..]: &[f64; WIDE]) {
        let (p, linear, r) = (self.from_zero, &mut self.carried, self.registers);
        linear.x = r.mul_add(b, p.z, r.mul_add(-c, p.y, linear.x));
        linear.y = r.mul_add(c, p.x, r.mul_add(-a, p.z, linear.y));
        linear.z = r.mul_add(a, p.y, r.mul_add(-b, p.x, linear.z));
    }

    #[inline(always)]
    fn slide(&mut self, direction: &Vector3<f64>, q_mm: f64) {
        let (p, r) = (&mut self.from_zero, self.registers);
        p.x = r.mul_add(direction.x, q_mm, p.x);
        p.y = r.mul_add(direction.y, q_mm, p.y);
        p.z = r.mul_add(direction.z, q_mm, p.z);
    }

    /// Passes a rotary axis; `arm_mm` leads from its point to the tip at machine zero. Returns the rotated lever.
    #[inline(always)]
    fn turn(&mut self, turn: &Turn, arm_mm: &Vector3<f64>) -> Vector3<f64> {
        let [linear, angular] = self.motion();
        let lever = self.from_zero + arm_mm;
        let [linear, angular, turned] = turn.apply(self.registers, [linear, angular, lever]);
        self.errors = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z, 0.0, 0.0];
        self.carried = Vector3::zeros();
        self.from_zero = turned - arm_mm;
        turned
    }

    #[inline(always)]
    fn motion(&self) -> [Vector3<f64>; 2] {
        let [x, y, z, a, b, c, ..] = self.errors;
        [Vector3::new(x, y, z) + self.carried, Vector3::new(a, b, c)]
    }
}

fn as_lanes(motion: &ErrorMotion) -> [f64; WIDE] {
    let (l, a) = (&motion.linear_mm, &motion.angular_rad);
    [l.x, l.y, l.z, a.x, a.y, a.z, 0.0, 0.0]
}

impl CompiledMachine {
    /// The error of any chain; machines of three linear axes use [`three_slides`](Self::three_slides).
    #[inline(always)]
    pub(crate) fn evaluate_with(&self, state: &State, registers: impl Registers) -> Evaluation {
        if let (true, [a, b, c]) = (self.three_slides, &self.axes[..]) {
            let (&[x, y, z, ..], &[k, l, m, ..]) = (&state.q.0, &state.approach.0);
            return self.three_slides([a, b, c], [k, l, m], [x, y, z], registers);
        }
        self.walk::<true>(state, registers, &mut ())
    }

    /// The error of any chain. `PATCHED` is true if an axis has errors outside its table, or a constant error remains
    /// between two axes.
    #[inline(always)]
    pub(crate) fn walk<const PATCHED: bool>(
        &self,
        state: &State,
        registers: impl Registers,
        turns: &mut impl Turns,
    ) -> Evaluation {
        let mut tip = Tip::new(registers, &self.folded.tool_end);
        let stands = state.q.iter().zip(&state.approach);
        for (index, (axis, (&q, &approach))) in self.axes.iter().zip(stands).enumerate().rev() {
            let head = &axis.heads[branch_index(approach)];
            let mut error = registers.value(&self.tables, head, axis.looked_up(q));
            if PATCHED {
                self.add_patches(&mut error, index, state);
                if self.folded.between[index] != ErrorMotion::ZERO {
                    tip.add(&as_lanes(&self.folded.between[index]));
                }
            }
            if axis.before_motion {
                tip.add(&error);
            }
            match axis.joint.kind {
                AxisKind::Linear => tip.slide(&axis.joint.direction, q),
                AxisKind::Rotary => {
                    let turn = Turn::new(registers, axis.along, q);
                    let lever_mm = tip.turn(&turn, &axis.arm_mm);
                    turns.turned(index, turn, lever_mm);
                }
            }
            if !axis.before_motion {
                tip.add(&error);
            }
        }
        if self.at_workpiece {
            tip.add(&as_lanes(&self.folded.workpiece_end));
        }
        tip.into()
    }

    /// The error of three linear axes: all tables are evaluated before any sum, so that no operation waits for another.
    #[inline(always)]
    pub(crate) fn three_slides(
        &self,
        axes: [&CompiledAxis; 3],
        approach: [Option<Direction>; 3],
        q_mm: [f64; 3],
        registers: impl Registers,
    ) -> Evaluation {
        // The terms are written out, because a closure that is not inlined would not be compiled for wide registers.
        let heads = [
            &axes[0].heads[branch_index(approach[0])],
            &axes[1].heads[branch_index(approach[1])],
            &axes[2].heads[branch_index(approach[2])],
        ];
        let errors = [
            registers.value(&self.tables, heads[0], q_mm[0]),
            registers.value(&self.tables, heads[1], q_mm[1]),
            registers.value(&self.tables, heads[2], q_mm[2]),
        ];
        let sum = registers.sum(&registers.sum(&errors[0], &errors[1]), &errors[2]);
        // Linear joints leave no constant error at the tool end. Until the first axis has moved the tip from its
        // position at machine zero, a tilt adds no displacement.
        let mut tip = Tip::new(registers, &ErrorMotion::ZERO);
        let mut levered = false;
        for ((axis, &q), error) in axes.iter().zip(&q_mm).zip(&errors).rev() {
            if axis.before_motion && levered {
                tip.carry(error);
            }
            tip.slide(&axis.joint.direction, q);
            if !axis.before_motion {
                tip.carry(error);
            }
            levered = true;
        }
        tip.errors = sum;
        tip.into()
    }
}

impl<R: Registers> From<Tip<R>> for Evaluation {
    #[inline(always)]
    fn from(tip: Tip<R>) -> Self {
        let [linear, angular] = tip.motion();
        Self { position_mm: linear.into(), rotation_rad: angular.into() }
    }
}

impl CompiledMachine {
    /// Adds errors over two coordinates and thermal errors, transformed to the tool tip like those of the tables.
    fn add_patches(&self, twist: &mut [f64; WIDE], index: usize, state: &State) {
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
