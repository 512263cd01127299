//! Chains with rotary axes: from the tool to the workpiece, as the `twist` form goes.

use volcomp_kinematics::{ErrorMotion, JointKind, MAX_AXES, Side, State, nalgebra::Vector3};

use crate::{
    machine::{Along, CompiledAxis, CompiledMachine, Evaluation},
    table::Registers,
};

/// What is told on the way.
pub(crate) trait Path {
    /// A joint is passed: `direction` of its motion before it.
    fn passed(&mut self, index: usize, direction: &Vector3<f64>);
    /// Everything passed so far is turned; `arm_mm` is how the tip goes with the turn, a mm for each rad.
    fn turned(&mut self, index: usize, turn: &Turn, arm_mm: Vector3<f64>);
}

/// Nobody wants to know.
impl Path for () {
    #[inline(always)]
    fn passed(&mut self, _: usize, _: &Vector3<f64>) {}
    #[inline(always)]
    fn turned(&mut self, _: usize, _: &Turn, _: Vector3<f64>) {}
}

/// What the correction needs, in workpiece axes at the end of the way.
pub(crate) struct Directions {
    /// Direction of each axis.
    pub(crate) axes: [Vector3<f64>; MAX_AXES],
    /// How the tip goes with each rotary axis, mm for each rad.
    pub(crate) arms_mm: [Vector3<f64>; MAX_AXES],
    pub(crate) tool_axis: Vector3<f64>,
}

impl Directions {
    pub(crate) fn new(tool_axis: Vector3<f64>) -> Self {
        Self {
            axes: [Vector3::zeros(); MAX_AXES],
            arms_mm: [Vector3::zeros(); MAX_AXES],
            tool_axis,
        }
    }
}

impl Path for Directions {
    #[inline(always)]
    fn passed(&mut self, index: usize, direction: &Vector3<f64>) {
        self.axes[index] = *direction;
    }

    #[inline(always)]
    fn turned(&mut self, index: usize, turn: &Turn, arm_mm: Vector3<f64>) {
        for (axis, arm) in self.axes.iter_mut().zip(&mut self.arms_mm).skip(index + 1) {
            *axis = turn.apply(axis);
            *arm = turn.apply(arm);
        }
        self.tool_axis = turn.apply(&self.tool_axis);
        self.arms_mm[index] = arm_mm;
    }
}

/// A rotation about the direction of an axis.
#[derive(Clone, Copy)]
pub(crate) struct Turn {
    along: Along,
    sin: f64,
    cos: f64,
}

impl Turn {
    fn new(axis: &CompiledAxis, q_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(q_rad);
        Self {
            along: axis.along,
            sin,
            cos,
        }
    }

    /// About a letter two components turn in their plane; else Rodrigues' formula.
    #[inline(always)]
    pub(crate) fn apply(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let (sin, cos) = (self.sin, self.cos);
        match self.along {
            Along::X(sense) => {
                let s = sense * sin;
                Vector3::new(v.x, cos * v.y - s * v.z, s * v.y + cos * v.z)
            }
            Along::Y(sense) => {
                let s = sense * sin;
                Vector3::new(cos * v.x + s * v.z, v.y, cos * v.z - s * v.x)
            }
            Along::Z(sense) => {
                let s = sense * sin;
                Vector3::new(cos * v.x - s * v.y, s * v.x + cos * v.y, v.z)
            }
            Along::Oblique(direction) => {
                let u = Vector3::from(direction);
                v * cos + u.cross(v) * sin + u * (u.dot(v) * (1.0 - cos))
            }
        }
    }
}

/// The tip on its way to the workpiece: how far it is from where it stands at machine zero, and its
/// displacement and rotation so far.
struct Tip {
    from_zero: Vector3<f64>,
    linear: Vector3<f64>,
    angular: Vector3<f64>,
}

impl Tip {
    /// A motion stated at the tip at machine zero.
    #[inline(always)]
    fn add(&mut self, linear: &Vector3<f64>, tilt: &Vector3<f64>) {
        self.linear += linear + tilt.cross(&self.from_zero);
        self.angular += tilt;
    }

    /// Through a rotary joint whose line lies elsewhere. The line does not turn with the joint, the body
    /// does: (I − Ad) of the location twist. Returns the turned lever.
    #[inline(always)]
    fn turn(&mut self, turn: &Turn, location: &ErrorMotion, arm_mm: &Vector3<f64>) -> Vector3<f64> {
        let shift = |lever: &Vector3<f64>| location.linear_mm + location.angular_rad.cross(lever);
        let lever = self.from_zero + arm_mm;
        let turned = turn.apply(&lever);
        self.linear = turn.apply(&(self.linear - shift(&lever))) + shift(&turned);
        self.angular = turn.apply(&(self.angular - location.angular_rad)) + location.angular_rad;
        self.from_zero = turned - arm_mm;
        turned
    }
}

impl CompiledMachine {
    /// The error of a chain with rotary axes or with errors over two coordinates.
    #[inline(always)]
    pub(crate) fn walk(
        &self,
        state: &State,
        registers: impl Registers,
        path: &mut impl Path,
    ) -> Evaluation {
        let mut tip = Tip {
            from_zero: Vector3::zeros(),
            linear: Vector3::zeros(),
            angular: Vector3::zeros(),
        };
        for (index, axis) in self.axes.iter().enumerate().rev() {
            let q = state.q[index];
            let table = axis.table(state.approach[index]);
            let mut twist = registers.value(table, axis.looked_up(q));
            if !axis.patches.is_empty() {
                self.add_patches(&mut twist, index, state);
            }
            let error = Vector3::new(twist[0], twist[1], twist[2]);
            let tilt = Vector3::new(twist[3], twist[4], twist[5]);
            let joint = &axis.joint;
            // A linear axis's errors ride with its carriage, a rotary axis's stay in the frame that does
            // not turn.
            let first = (joint.kind == JointKind::Linear) == (joint.side == Side::Tool);
            if first {
                tip.add(&error, &tilt);
            }
            match joint.kind {
                JointKind::Linear => {
                    tip.linear += axis.slide * q;
                    tip.from_zero += joint.direction * q;
                }
                JointKind::Rotary => {
                    let turn = Turn::new(axis, q);
                    let turned = tip.turn(&turn, &axis.location, &axis.arm_mm);
                    path.turned(index, &turn, joint.direction.cross(&turned));
                }
            }
            path.passed(index, &joint.direction);
            if !first {
                tip.add(&error, &tilt);
            }
        }
        Evaluation {
            position_mm: tip.linear.into(),
            rotation_rad: tip.angular.into(),
        }
    }
}
