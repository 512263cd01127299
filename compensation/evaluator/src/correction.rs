//! The first-order correction of a real-time cycle, and a bound of what it neglects.

use volcomp_kinematics::{
    Correctors, State,
    least_norm::{LinearColumns, LinearShares, RotaryGram, normals},
    nalgebra::{Matrix3, Vector2, Vector3},
};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES, PerAxis};

use crate::{
    EvaluatorError,
    machine::{CompiledMachine, Evaluation},
    table::Registers,
    turn::Turn,
    walk::Turns,
};

/// How the rotary axes turned, and the levers from their points to the tip.
struct Passed([Option<(Turn, Vector3<f64>)>; MAX_AXES]);

impl Turns for Passed {
    #[inline(always)]
    fn turned(&mut self, index: usize, turn: Turn, lever_mm: Vector3<f64>) {
        self.0[index] = Some((turn, lever_mm));
    }
}

/// How tip and tool axis move with each axis, in workpiece axes.
struct Directions {
    axes: [Vector3<f64>; MAX_AXES],
    /// How the tip moves with each rotary axis, mm for each rad.
    arms_mm: [Vector3<f64>; MAX_AXES],
    tool_axis: Vector3<f64>,
}

/// The correction of one step in the parts of which a coupled correction is made, and the error that it corrects. The
/// linear shares for rotary shares δ_r, whatever those are (limited, ramped, rounded to steps of the controller), are
/// `position` + Σ `follow[r]`·δ_r; with the δ_r of `rotary` they are those of [`FirstOrder::delta`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectionParts {
    /// The error that is corrected.
    pub error: Evaluation,
    /// What the linear axes take of the position error while no rotary axis moves, −L⁻¹·e_p: mm in chain order, zero
    /// for axes that do not correct.
    pub position: PerAxis<f64>,
    /// The shares of the rotary axes in the direction of the tool axis, rad in chain order, zero for all others.
    pub rotary: PerAxis<f64>,
    /// For each rotary axis, whether it corrects or not, how the linear axes follow it so that the tip stays where it is:
    /// row r of −L⁻¹·P, mm for each rad of the rotary axis at place r, in chain order. All other rows are zero.
    pub follow: PerAxis<PerAxis<f64>>,
    /// As in [`FirstOrder`].
    pub tool_axis_partial: bool,
    /// As in [`FirstOrder`].
    pub near_singular: bool,
    /// Rotary axes between the linear ones have turned two of these nearly into one direction: linear shares are more
    /// than ten times the position error, or one of the axes is left out.
    pub linear_near_singular: bool,
}

impl CorrectionParts {
    /// The whole correction, mm and rad in chain order: linear shares that belong to the rotary shares, and those.
    pub fn delta(&self) -> PerAxis<f64> {
        // Rows of axes that do not turn add nothing.
        let turning = self.follow.iter().zip(&self.rotary);
        let turning = turning.filter(|(_, rotary)| **rotary != 0.0);
        let mut following = PerAxis::ZERO;
        for (row, rotary) in turning {
            for (sum, row) in following.iter_mut().zip(row) {
                *sum += row * rotary;
            }
        }
        PerAxis::from_fn(|index| self.position[index] + following[index] + self.rotary[index])
    }
}

/// The correction of one step, and the error that it corrects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstOrder {
    /// The error that is corrected.
    pub error: Evaluation,
    /// Δq in chain order, mm and rad, to be added to the command.
    pub delta: PerAxis<f64>,
    /// A direction of the tool axis is corrected in part only or not at all: the pose is within about 1° of a singular one,
    /// or fewer than two rotary axes may move.
    pub tool_axis_partial: bool,
    /// Two rotary axes or more may move, and the pose is a singular one or within about 6° of it: see
    /// [`volcomp_kinematics::NEAR_SINGULAR_BELOW`].
    pub near_singular: bool,
}

impl CompiledMachine {
    /// The axes that its corrections move.
    pub fn correctors(&self) -> &Correctors {
        &self.correctors
    }

    /// From now on corrections move these axes and hold all others; the default is every axis. Blobs hold it.
    ///
    /// # Errors
    /// [`EvaluatorError::Chain`] for a name that the chain does not have.
    pub fn set_correctors(&mut self, names: &[AxisName]) -> Result<(), EvaluatorError> {
        self.correctors = Correctors::named(&self.chain, names)?;
        self.may_move.clear();
        for &name in names {
            if !self.may_move.contains(&name) {
                self.may_move.push(name); // nine different letters exist, so nine places are enough
            }
        }
        Ok(())
    }

    /// The axes that correct when only some of the machine's axes can be written: of those that may move, in their
    /// order, the ones in `written`. Allocates nothing.
    pub fn correctors_among(&self, written: &[AxisName]) -> Correctors {
        let mut names = self.may_move.clone();
        names.retain(|name| written.contains(name));
        Correctors::choose(&self.chain, &names)
    }

    #[inline(always)]
    pub(crate) fn first_order_with<const PATCHED: bool>(
        &self,
        state: &State,
        correctors: &Correctors,
        registers: impl Registers,
    ) -> FirstOrder {
        let mut delta = PerAxis::ZERO;
        if self.three_slides {
            let error = self.evaluate_with(state, registers);
            let position = Vector3::from(error.position_mm);
            let column = |index: usize| {
                let axis = self.axes.get(index);
                axis.map_or(Vector3::zeros(), |axis| axis.joint.direction)
            };
            let columns = linear_columns(correctors, column);
            take_position(correctors, &columns.solved(), &position, &mut delta);
            return FirstOrder {
                error,
                delta,
                tool_axis_partial: true,
                near_singular: false,
            };
        }
        let mut passed = Passed([None; MAX_AXES]);
        let error = self.walk::<PATCHED>(state, registers, &mut passed);
        let directions = self.directions(&passed, registers);
        let [tool_axis_partial, near_singular] =
            correct_axis(correctors, &error, &directions, &mut delta);
        let mut position = Vector3::from(error.position_mm);
        for (arm_mm, delta) in directions.arms_mm.iter().zip(&delta) {
            position += arm_mm * *delta;
        }
        let columns = linear_columns(correctors, |index| directions.axes[index]);
        take_position(correctors, &columns.solved(), &position, &mut delta);
        FirstOrder {
            error,
            delta,
            tool_axis_partial,
            near_singular,
        }
    }

    #[inline(always)]
    pub(crate) fn parts_with<const PATCHED: bool>(
        &self,
        state: &State,
        correctors: &Correctors,
        registers: impl Registers,
    ) -> CorrectionParts {
        let mut parts = CorrectionParts {
            error: Evaluation::default(),
            position: PerAxis::ZERO,
            rotary: PerAxis::ZERO,
            follow: PerAxis([PerAxis::ZERO; MAX_AXES]),
            tool_axis_partial: true,
            near_singular: false,
            linear_near_singular: false,
        };
        if self.three_slides {
            parts.error = self.evaluate_with(state, registers);
            let column = |index: usize| {
                let axis = self.axes.get(index);
                axis.map_or(Vector3::zeros(), |axis| axis.joint.direction)
            };
            let columns = linear_columns(correctors, column);
            let position = Vector3::from(parts.error.position_mm);
            take_position(
                correctors,
                &columns.solved(),
                &position,
                &mut parts.position,
            );
            return parts;
        }
        let mut passed = Passed([None; MAX_AXES]);
        parts.error = self.walk::<PATCHED>(state, registers, &mut passed);
        let directions = self.directions(&passed, registers);
        [parts.tool_axis_partial, parts.near_singular] =
            correct_axis(correctors, &parts.error, &directions, &mut parts.rotary);
        let columns = linear_columns(correctors, |index| directions.axes[index]);
        let position = Vector3::from(parts.error.position_mm);
        let solved = columns.solved();
        take_position(correctors, &solved, &position, &mut parts.position);
        parts.linear_near_singular = columns.is_near_singular(correctors.linear().len());
        for (arm_mm, row) in directions.arms_mm.iter().zip(&mut parts.follow) {
            if *arm_mm != Vector3::zeros() {
                take_position(correctors, &solved, arm_mm, row);
            }
        }
        parts
    }

    /// Directions and levers in workpiece axes, from the workpiece to the tool.
    #[inline(always)]
    fn directions(&self, passed: &Passed, registers: impl Registers) -> Directions {
        let mut axes = [Vector3::zeros(); MAX_AXES];
        let mut arms_mm = axes;
        // The unit vectors of the body reached so far.
        let mut frame = Matrix3::identity();
        let joints = self.axes.iter().map(|axis| &axis.joint).zip(&passed.0);
        for (index, (joint, turned)) in joints.enumerate() {
            axes[index] = frame * joint.direction;
            if let Some((turn, lever_mm)) = turned {
                arms_mm[index] = frame * joint.direction.cross(lever_mm);
                frame *= turn.matrix(registers);
            }
        }
        Directions {
            axes,
            arms_mm,
            tool_axis: frame * self.chain.tool_axis(),
        }
    }

    /// The longest lever from a joint to the tip over the travels, mm: a bound.
    pub fn reach_mm(&self) -> f64 {
        let tip = self.chain.tool_tip_mm();
        let mut reach = 0.0_f64;
        let mut travelled = 0.0;
        for axis in &self.axes {
            reach = reach.max((tip - axis.joint.point_mm).norm());
            if axis.joint.kind == AxisKind::Linear {
                travelled += libm::fabs(axis.travel[0]).max(libm::fabs(axis.travel[1]));
            }
        }
        reach + travelled
    }
}

/// Rotary axes, least norm on the two components of the tool-axis error normal to it. Whether a direction is left
/// out, and whether two axes or more are near a singular pose.
#[inline(always)]
fn correct_axis(
    correctors: &Correctors,
    error: &Evaluation,
    directions: &Directions,
    delta: &mut PerAxis<f64>,
) -> [bool; 2] {
    let [first, second] = normals(&directions.tool_axis);
    // (v × t) · n = v · (t × n).
    let seen = |v: &Vector3<f64>| Vector2::new(second.dot(v), -first.dot(v));
    let miss = seen(&Vector3::from(error.rotation_rad));
    let mut gram = RotaryGram::default();
    for &index in correctors.rotary() {
        gram.add(&seen(&directions.axes[index]));
    }
    let (weighted, _) = gram.solve(gram.rank(), &gram.corrected(&miss));
    for &index in correctors.rotary() {
        delta[index] = -seen(&directions.axes[index]).dot(&weighted);
    }
    let near_singular = correctors.rotary().len() >= 2 && gram.is_near_singular();
    [gram.is_singular(), near_singular]
}

/// How the tip moves with the linear axes that correct.
#[inline(always)]
pub(crate) fn linear_columns(
    correctors: &Correctors,
    column: impl Fn(usize) -> Vector3<f64>,
) -> LinearColumns {
    let mut columns = [Vector3::zeros(); 3];
    for (into, &index) in columns.iter_mut().zip(correctors.linear()) {
        *into = column(index);
    }
    LinearColumns::new(columns, correctors.linear().len())
}

/// Linear axes against a displacement of the tip: exactly with three directions, least squares with fewer.
#[inline(always)]
pub(crate) fn take_position(
    correctors: &Correctors,
    solved: &LinearShares,
    position_mm: &Vector3<f64>,
    delta: &mut PerAxis<f64>,
) {
    let shares = solved.of(position_mm);
    for (&index, share) in correctors.linear().iter().zip(shares) {
        delta[index] = -share;
    }
}
