//! Evaluates one pose in a real-time cycle: its error and its first-order correction.
//!
//! It uses the widest registers of the processor. A build without the standard library uses those of the compilation
//! target.

#[cfg(feature = "std")]
use pulp::{Arch, Simd, WithSimd};
use volcomp_kinematics::{
    Correctors, State,
    least_norm::{LinearColumns, LinearShares, RotaryGram, normals},
    nalgebra::{Matrix3, Vector2, Vector3},
};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES, PerAxis};

#[cfg(not(feature = "std"))]
use crate::table::Baseline;
use crate::{
    EvaluatorError,
    machine::{CompiledMachine, Evaluation},
    table::Registers,
    turn::Turn,
    walk::Turns,
};
#[cfg(feature = "std")]
use crate::{machine::CompiledAxis, table::Wide};

impl CompiledMachine {
    /// The volumetric error at a state (mm, rad), first order (the `twist` form).
    pub fn evaluate(&self, state: &State) -> Evaluation {
        #[cfg(feature = "std")]
        return one_pose(self, state);
        #[cfg(not(feature = "std"))]
        self.evaluate_with(state, Baseline)
    }

    /// The first-order correction by the axes of [`correctors`](Self::correctors): the rotary axes correct the tool
    /// direction with least norm, then the linear axes correct the position.
    pub fn first_order(&self, state: &State) -> FirstOrder {
        self.first_order_of(state, &self.correctors)
    }

    /// The first-order correction by the axes in `correctors`, for a controller that can write only some axes of the
    /// machine.
    pub fn first_order_of(&self, state: &State, correctors: &Correctors) -> FirstOrder {
        #[cfg(feature = "std")]
        return one_correction(self, state, correctors);
        #[cfg(not(feature = "std"))]
        self.first_order_with::<true>(state, correctors, Baseline)
    }

    /// The first-order correction in parts, for a controller interface that limits, ramps or rounds the rotary shares.
    /// The linear shares can then be matched to the rotary shares that are written.
    pub fn parts_of(&self, state: &State, correctors: &Correctors) -> CorrectionParts {
        #[cfg(feature = "std")]
        return one_in_parts(self, state, correctors);
        #[cfg(not(feature = "std"))]
        self.parts_with::<true>(state, correctors, Baseline)
    }
}

#[cfg(feature = "std")]
fn one_pose(machine: &CompiledMachine, state: &State) -> Evaluation {
    struct Slides<'a>(&'a CompiledMachine, [&'a CompiledAxis; 3], &'a State);
    impl WithSimd for Slides<'_> {
        type Output = Evaluation;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Evaluation {
            let Self(machine, axes, state) = self;
            let (&[x, y, z, ..], &[k, l, m, ..]) = (&state.q.0, &state.approach.0);
            machine.three_slides(axes, [k, l, m], [x, y, z], Wide(simd))
        }
    }
    struct Walk<'a, const PATCHED: bool>(&'a CompiledMachine, &'a State);
    impl<const PATCHED: bool> WithSimd for Walk<'_, PATCHED> {
        type Output = Evaluation;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Evaluation {
            self.0.walk::<PATCHED>(self.1, Wide(simd), &mut ())
        }
    }
    if let (true, [a, b, c]) = (machine.three_slides, &machine.axes[..]) {
        Arch::new().dispatch(Slides(machine, [a, b, c], state))
    } else if machine.patched {
        Arch::new().dispatch(Walk::<true>(machine, state))
    } else {
        Arch::new().dispatch(Walk::<false>(machine, state))
    }
}

/// The first-order correction of one pose, with the widest registers.
#[cfg(feature = "std")]
fn one_correction(machine: &CompiledMachine, state: &State, correctors: &Correctors) -> FirstOrder {
    struct One<'a, const PATCHED: bool>(&'a CompiledMachine, &'a State, &'a Correctors);
    impl<const PATCHED: bool> WithSimd for One<'_, PATCHED> {
        type Output = FirstOrder;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> FirstOrder {
            let Self(machine, state, correctors) = self;
            machine.first_order_with::<PATCHED>(state, correctors, Wide(simd))
        }
    }
    if machine.patched {
        Arch::new().dispatch(One::<true>(machine, state, correctors))
    } else {
        Arch::new().dispatch(One::<false>(machine, state, correctors))
    }
}

#[cfg(feature = "std")]
fn one_in_parts(
    machine: &CompiledMachine,
    state: &State,
    correctors: &Correctors,
) -> CorrectionParts {
    struct One<'a, const PATCHED: bool>(&'a CompiledMachine, &'a State, &'a Correctors);
    impl<const PATCHED: bool> WithSimd for One<'_, PATCHED> {
        type Output = CorrectionParts;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> CorrectionParts {
            let Self(machine, state, correctors) = self;
            machine.parts_with::<PATCHED>(state, correctors, Wide(simd))
        }
    }
    if machine.patched {
        Arch::new().dispatch(One::<true>(machine, state, correctors))
    } else {
        Arch::new().dispatch(One::<false>(machine, state, correctors))
    }
}

struct RotaryLevers([Option<(Turn, Vector3<f64>)>; MAX_AXES]);

impl Turns for RotaryLevers {
    #[inline(always)]
    fn turned(&mut self, index: usize, turn: Turn, lever_mm: Vector3<f64>) {
        self.0[index] = Some((turn, lever_mm));
    }
}

/// Derivatives of tip and tool axis with respect to each axis, in workpiece axes.
struct Directions {
    axes: [Vector3<f64>; MAX_AXES],
    /// Tip motion per rotary axis, mm per rad.
    arms_mm: [Vector3<f64>; MAX_AXES],
    tool_axis: Vector3<f64>,
}

/// A first-order correction in parts, and the error that it corrects. A share is the displacement of one axis. If the
/// rotary shares are changed to δ_r (limited, ramped, rounded to controller increments), the matching linear shares are
/// `position` + Σ `follow[r]`·δ_r. With the rotary shares in `rotary` the result is [`FirstOrder::delta`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectionParts {
    /// Error without correction.
    pub error: Evaluation,
    /// Linear shares that correct the position error without rotary motion, −L⁻¹·e_p: mm in chain order, zero for axes
    /// that do not correct.
    pub position: PerAxis<f64>,
    /// Rotary shares that correct the tool direction, rad in chain order, zero for all other axes.
    pub rotary: PerAxis<f64>,
    /// Motion of the linear axes that keeps the tip in place while a rotary axis moves: row r of −L⁻¹·P, mm per rad of
    /// the rotary axis at index r, in chain order. Rotary axes that do not correct have a row too. The rows of linear
    /// axes are zero.
    pub follow: PerAxis<PerAxis<f64>>,
    /// See [`FirstOrder::tool_axis_partial`].
    pub tool_axis_partial: bool,
    /// See [`FirstOrder::near_singular`].
    pub near_singular: bool,
    /// True if rotary axes have turned the directions of the correcting linear axes nearly parallel: linear shares may
    /// be more than ten times the position error, or one of the linear axes does not correct.
    pub linear_near_singular: bool,
}

impl CorrectionParts {
    /// Sum of all parts, mm and rad in chain order: the rotary shares and the matching linear shares.
    pub fn delta(&self) -> PerAxis<f64> {
        // The rows of linear axes are zero.
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

/// A first-order correction, and the error that it corrects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstOrder {
    /// Error without correction.
    pub error: Evaluation,
    /// Δq in chain order, mm and rad, to be added to the command.
    pub delta: PerAxis<f64>,
    /// True if one or both components of the tool's tilt are corrected only in part or not at all. The pose is then
    /// within about 1° of a singular pose, or fewer than two rotary axes may move.
    pub tool_axis_partial: bool,
    /// True if at least two rotary axes may move, and the pose is singular or within about 6° of singular; see
    /// [`volcomp_kinematics::NEAR_SINGULAR_BELOW`].
    pub near_singular: bool,
}

impl CompiledMachine {
    /// The axes that corrections of this machine move.
    pub fn correctors(&self) -> &Correctors {
        &self.correctors
    }

    /// Sets the axes that corrections move; the others are held. By default every axis moves. Blobs include this
    /// setting.
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

    /// Selects correctors for a controller that can write only the axes in `written`: those of them that corrections
    /// may move. Does not allocate.
    pub fn correctors_among(&self, written: &[AxisName]) -> Correctors {
        let mut names = self.may_move.clone();
        names.retain(|name| written.contains(name));
        Correctors::choose(&self.chain, &names)
    }

    #[inline(always)]
    fn first_order_with<const PATCHED: bool>(
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
            return FirstOrder { error, delta, tool_axis_partial: true, near_singular: false };
        }
        let mut levers = RotaryLevers([None; MAX_AXES]);
        let error = self.walk::<PATCHED>(state, registers, &mut levers);
        let directions = self.directions(&levers, registers);
        let [tool_axis_partial, near_singular] =
            correct_axis(correctors, &error, &directions, &mut delta);
        let mut position = Vector3::from(error.position_mm);
        for (arm_mm, delta) in directions.arms_mm.iter().zip(&delta) {
            position += arm_mm * *delta;
        }
        let columns = linear_columns(correctors, |index| directions.axes[index]);
        take_position(correctors, &columns.solved(), &position, &mut delta);
        FirstOrder { error, delta, tool_axis_partial, near_singular }
    }

    #[inline(always)]
    fn parts_with<const PATCHED: bool>(
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
            take_position(correctors, &columns.solved(), &position, &mut parts.position);
            return parts;
        }
        let mut levers = RotaryLevers([None; MAX_AXES]);
        parts.error = self.walk::<PATCHED>(state, registers, &mut levers);
        let directions = self.directions(&levers, registers);
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
    fn directions(&self, levers: &RotaryLevers, registers: impl Registers) -> Directions {
        let mut axes = [Vector3::zeros(); MAX_AXES];
        let mut arms_mm = axes;
        // Orientation of the body that the joints up to this one carry, in workpiece axes.
        let mut frame = Matrix3::identity();
        let joints = self.axes.iter().map(|axis| &axis.joint).zip(&levers.0);
        for (index, (joint, turned)) in joints.enumerate() {
            axes[index] = frame * joint.direction;
            if let Some((turn, lever_mm)) = turned {
                arms_mm[index] = frame * joint.direction.cross(lever_mm);
                frame *= turn.matrix(registers);
            }
        }
        Directions { axes, arms_mm, tool_axis: frame * self.chain.tool_axis() }
    }

    /// Upper bound of the lever from any joint to the tip over the travels, mm.
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

/// Corrects the tool-axis error with the rotary axes: least norm on its two components normal to the tool axis. Returns
/// the flags `tool_axis_partial` and `near_singular` of [`FirstOrder`].
#[inline(always)]
fn correct_axis(
    correctors: &Correctors,
    error: &Evaluation,
    directions: &Directions,
    delta: &mut PerAxis<f64>,
) -> [bool; 2] {
    let [first, second] = normals(&directions.tool_axis);
    // A rotation v moves the tool axis t by v × t. Its component along n is (v × t) · n = v · (t × n).
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

#[inline(always)]
fn linear_columns(
    correctors: &Correctors,
    column: impl Fn(usize) -> Vector3<f64>,
) -> LinearColumns {
    let mut columns = [Vector3::zeros(); 3];
    for (into, &index) in columns.iter_mut().zip(correctors.linear()) {
        *into = column(index);
    }
    LinearColumns::new(columns, correctors.linear().len())
}

/// Corrects a displacement of the tip with the linear axes: exact with three directions, least squares with fewer.
#[inline(always)]
fn take_position(
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

/// Precomputed correction of a position error by the linear axes, valid at every pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Slides {
    correctors: Correctors,
    shares: LinearShares,
}

impl CompiledMachine {
    /// The precomputed correction for the correcting axes of the machine; `None` if the machine has a rotary axis.
    pub fn slides(&self) -> Option<Slides> {
        let mut axes = self.axes.iter();
        if axes.any(|axis| axis.joint.kind == AxisKind::Rotary) {
            return None;
        }
        let columns = linear_columns(&self.correctors, |index| {
            let axis = self.axes.get(index);
            axis.map_or(Vector3::zeros(), |axis| axis.joint.direction)
        });
        Some(Slides { correctors: self.correctors.clone(), shares: columns.solved() })
    }
}

impl Slides {
    /// The correction in two steps, mm in chain order: the second step uses the errors at the position corrected by the
    /// first. If the second result is less than half of the first, the errors are unrealistic, and the first result is
    /// returned.
    pub fn two_steps(&self, machine: &CompiledMachine, state: &State) -> PerAxis<f64> {
        #[cfg(feature = "std")]
        return two_steps(machine, state, self);
        #[cfg(not(feature = "std"))]
        self.two_steps_with(machine, state, Baseline)
    }

    #[inline(always)]
    fn two_steps_with(
        &self,
        machine: &CompiledMachine,
        state: &State,
        registers: impl Registers,
    ) -> PerAxis<f64> {
        let mut corrected = *state;
        let first = self.delta(&machine.evaluate_with(state, registers));
        let axes = machine.axes.len();
        for (q, delta) in corrected.q.iter_mut().zip(&first).take(axes) {
            *q += delta;
        }
        let second = self.delta(&machine.evaluate_with(&corrected, registers));
        // If an error grows as fast as its coordinate, the second step is almost zero.
        let size = |delta: &PerAxis<f64>| {
            let sizes = delta.iter().take(axes).map(|delta| libm::fabs(*delta));
            sizes.fold(0.0, |most, size| if size > most { size } else { most })
        };
        if size(&second) < 0.5 * size(&first) { first } else { second }
    }

    /// The correction of an error, as in [`CompiledMachine::first_order`]: mm in chain order.
    #[inline(always)]
    pub fn delta(&self, error: &Evaluation) -> PerAxis<f64> {
        let mut delta = PerAxis::ZERO;
        let position = Vector3::from(error.position_mm);
        take_position(&self.correctors, &self.shares, &position, &mut delta);
        delta
    }
}

#[cfg(feature = "std")]
fn two_steps(machine: &CompiledMachine, state: &State, slides: &Slides) -> PerAxis<f64> {
    struct Two<'a>(&'a CompiledMachine, &'a State, &'a Slides);
    impl WithSimd for Two<'_> {
        type Output = PerAxis<f64>;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> PerAxis<f64> {
            let Self(machine, state, slides) = self;
            slides.two_steps_with(machine, state, Wide(simd))
        }
    }
    Arch::new().dispatch(Two(machine, state, slides))
}
