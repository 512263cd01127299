//! The compiled machine: what it is made of and what it answers about itself.

use crate::parts::branch_index;
use alloc::vec::Vec;

use volcomp_kinematics::{Chain, ErrorMotion, ErrorSource, Joint, State, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, AxisName, Direction, MAX_AXES};

use crate::{
    EvaluatorError, Tolerance,
    fold::{Folded, errors_before_motion, fold},
    parts::{AxisParts, Branches, MachineParts, ToTable},
    patch::{CompiledPatch, Patch},
    table::{Baseline, Bounds, Head, LANES, Piece, Registers, Tables, WIDE},
    turn::Along,
};

/// The volumetric error at one pose, first order, in workpiece axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evaluation {
    /// ΔP, mm.
    pub position_mm: [f64; 3],
    /// ρ, rad.
    pub rotation_rad: [f64; 3],
}

impl Evaluation {
    /// ΔP (mm), then ρ (rad).
    #[inline(always)]
    pub fn into_six(self) -> [f64; 6] {
        let ([x, y, z], [a, b, c]) = (self.position_mm, self.rotation_rad);
        [x, y, z, a, b, c]
    }
}

/// One axis, ready to evaluate.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CompiledAxis {
    pub(crate) joint: Joint,
    pub(crate) travel: [f64; 2],
    pub(crate) modulo: Option<f64>,
    pub(crate) branches: Branches,
    /// The table for each approach. Errors are carried to the tool tip at machine zero, constant errors
    /// are in.
    pub(crate) heads: [Head; 3],
    pub(crate) patches: Vec<CompiledPatch>,
    /// From the axis's point to the tool tip at machine zero, mm.
    pub(crate) arm_mm: Vector3<f64>,
    /// Whether the errors stand on the tool side of the joint.
    pub(crate) before_motion: bool,
    pub(crate) along: Along,
    pub(crate) bounds: Bounds,
    pub(crate) warmth: Warmth,
}

/// What temperature adds to the error motions of an axis for now.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Warmth {
    /// Carried to the tool tip at machine zero: mm, rad.
    at_tip: [f64; LANES],
    /// Displacement for each mm of the coordinate.
    slope_mm: [f64; 3],
}

/// What an axis has besides its joint and what follows from it.
pub(crate) struct AxisTables {
    pub(crate) travel: [f64; 2],
    pub(crate) modulo: Option<f64>,
    /// Pieces of one table, or of forward, backward and mean.
    pub(crate) tables: Vec<Vec<Piece>>,
    pub(crate) patches: Vec<Patch>,
}

/// Where the curve of one component is defined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Range {
    pub(crate) axis: usize,
    pub(crate) component: usize,
    /// The axis whose coordinate counts, and its range in mm or deg.
    pub(crate) looked_at: usize,
    pub(crate) domain: [f64; 2],
}

/// A machine without its tables.
pub(crate) struct Frame {
    pub(crate) chain: Chain,
    pub(crate) location: [ErrorMotion; MAX_AXES],
    pub(crate) assembly: [ErrorMotion; MAX_AXES],
    pub(crate) tolerance: Tolerance,
    folded: Folded,
}

impl Frame {
    pub(crate) fn new(
        chain: Chain,
        location: &[ErrorMotion; MAX_AXES],
        assembly: &[ErrorMotion; MAX_AXES],
        tolerance: Tolerance,
    ) -> Self {
        Self {
            folded: fold(&chain, location, assembly),
            chain,
            location: *location,
            assembly: *assembly,
            tolerance,
        }
    }
}

/// A machine whose curves are piecewise cubics and whose constants are folded: plain data, evaluated to
/// first order without allocation, lock or panic. Thermal terms are in as they stood when it was made, or
/// as [`set_warmth`](Self::set_warmth) said last.
#[derive(Clone, Debug, PartialEq)]
pub struct CompiledMachine {
    pub(crate) chain: Chain,
    pub(crate) location: [ErrorMotion; MAX_AXES],
    pub(crate) assembly: [ErrorMotion; MAX_AXES],
    pub(crate) tolerance: Tolerance,
    pub(crate) axes: Vec<CompiledAxis>,
    pub(crate) tables: Tables,
    pub(crate) ranges: Vec<Range>,
    pub(crate) folded: Folded,
    /// Whether something is left at the workpiece end.
    pub(crate) at_workpiece: bool,
    /// Whether an axis has errors besides its table: over two coordinates, or of temperature.
    pub(crate) patched: bool,
    /// Three linear axes and nothing besides their tables.
    pub(crate) three_slides: bool,
    /// The linear axes that correct: of each direction the first.
    pub(crate) correcting: Vec<usize>,
}

impl CompiledMachine {
    /// Compiles a machine.
    ///
    /// # Errors
    /// [`EvaluatorError::TooLarge`], [`EvaluatorError::Tolerance`].
    pub fn new(parts: MachineParts<'_>, tolerance: Tolerance) -> Result<Self, EvaluatorError> {
        for found in [tolerance.linear_mm, tolerance.angular_rad] {
            if !(found > 0.0 && found.is_finite()) {
                return Err(EvaluatorError::Tolerance { found });
            }
        }
        let chain = parts.chain.clone();
        let frame = Frame::new(chain, &parts.location, &parts.assembly, tolerance);
        let (mut axes, mut ranges) = (Vec::new(), Vec::new());
        for (index, parts) in parts.axes.into_iter().enumerate() {
            let stated = parts.ranges.iter();
            ranges.extend(stated.map(|&(component, looked_at, domain)| Range {
                axis: index,
                component,
                looked_at,
                domain,
            }));
            axes.push(AxisTables {
                travel: parts.travel,
                modulo: parts.modulo,
                tables: tables(&frame, index, &parts)?,
                patches: parts.patches,
            });
        }
        Ok(Self::from_tables(frame, axes, ranges))
    }

    /// From tables that hold the constants already.
    pub(crate) fn from_tables(frame: Frame, axes: Vec<AxisTables>, ranges: Vec<Range>) -> Self {
        let folded = frame.folded;
        let tip = frame.chain.tool_tip_mm();
        let mut tables = Tables::default();
        let compiled = |(index, (joint, axis)): (usize, (&Joint, AxisTables))| {
            let slide = &folded.slide[index];
            axis.compiled(joint, tip - joint.point_mm, slide, &mut tables)
        };
        let joints = frame.chain.joints().iter();
        let axes: Vec<CompiledAxis> = joints.zip(axes).enumerate().map(compiled).collect();
        let mut machine = Self {
            patched: false,
            three_slides: false,
            at_workpiece: folded.workpiece_end != ErrorMotion::ZERO,
            correcting: crate::correction::correcting(frame.chain.joints()),
            chain: frame.chain,
            location: frame.location,
            assembly: frame.assembly,
            tolerance: frame.tolerance,
            axes,
            tables,
            ranges,
            folded,
        };
        machine.choose_path();
        machine
    }

    /// How its errors are summed.
    fn choose_path(&mut self) {
        let plain =
            |axis: &CompiledAxis| axis.patches.is_empty() && axis.warmth == Warmth::default();
        let slides = |axis: &CompiledAxis| axis.joint.kind == AxisKind::Linear;
        self.patched = !self.axes.iter().all(plain);
        self.three_slides = self.axes.len() == 3 && self.axes.iter().all(slides) && !self.patched;
    }

    /// What temperature adds to the error motions of the axis at `index` from now on: `offset` (mm, rad) at
    /// the axis's point, and `slope_mm` for each mm of a linear axis's coordinate; instead of what was added
    /// before. Allocates nothing. Blobs do not hold it.
    pub fn set_warmth(&mut self, index: usize, offset: &ErrorMotion, slope_mm: [f64; 3]) {
        let Some(axis) = self.axes.get_mut(index) else {
            return;
        };
        let (tilt, arm_mm) = (offset.angular_rad, axis.arm_mm);
        let at_tip = offset.linear_mm + tilt.cross(&arm_mm);
        axis.warmth = Warmth {
            at_tip: [at_tip.x, at_tip.y, at_tip.z, tilt.x, tilt.y, tilt.z],
            slope_mm,
        };
        self.choose_path();
    }

    /// The ideal chain, mm and rad.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// How far its curves may be from their sources.
    pub fn tolerance(&self) -> Tolerance {
        self.tolerance
    }

    /// Cubic pieces of all tables together.
    pub fn pieces(&self) -> usize {
        self.tables.len()
    }

    /// Bytes of all tables together.
    pub fn bytes(&self) -> usize {
        self.tables.bytes()
    }

    /// The volumetric error at a state (mm, rad), first order (the `twist` form).
    pub fn evaluate(&self, state: &State) -> Evaluation {
        #[cfg(feature = "std")]
        return crate::batch::one_pose(self, state);
        #[cfg(not(feature = "std"))]
        self.evaluate_with(state, Baseline)
    }

    #[inline(always)]
    pub(crate) fn evaluate_with(&self, state: &State, registers: impl Registers) -> Evaluation {
        if let (true, [a, b, c]) = (self.three_slides, &self.axes[..]) {
            let (&[x, y, z, ..], &[k, l, m, ..]) = (&state.q.0, &state.approach.0);
            return self.three_slides([a, b, c], [k, l, m], [x, y, z], registers);
        }
        self.walk::<true>(state, registers, &mut ())
    }

    /// Errors over two coordinates and of temperature, carried to the tool tip like those of the tables.
    pub(crate) fn add_patches(&self, twist: &mut [f64; WIDE], index: usize, state: &State) {
        let axis = &self.axes[index];
        let Warmth {
            at_tip, slope_mm, ..
        } = &axis.warmth;
        for (lane, part) in twist.iter_mut().zip(at_tip) {
            *lane += part;
        }
        for (lane, slope) in twist.iter_mut().zip(slope_mm) {
            *lane += slope * state.q[index];
        }
        for compiled in &axis.patches {
            let patch = &compiled.patch;
            let at = patch.axes.map(|looked_at| {
                self.axes
                    .get(looked_at)
                    .map_or(0.0, |axis| axis.looked_up(state.q[looked_at]))
            });
            let value = compiled.value(at) * patch.weights[branch_index(state.approach[index])];
            twist[patch.component] += value;
            if patch.component >= 3 {
                let mut tilt = Vector3::zeros();
                tilt[patch.component - 3] = value;
                let carried = tilt.cross(&axis.arm_mm);
                for (lane, part) in twist.iter_mut().zip(carried.iter()) {
                    *lane += part;
                }
            }
        }
    }

    /// Bound of |dE/dq| of one error motion at the axis's point over all branches, mm or rad for each
    /// mm or deg; `component` 0 to 5.
    pub fn slope_bound(&self, axis: AxisName, component: usize) -> f64 {
        let axis = self.axes.iter().find(|a| a.joint.name == axis);
        axis.map_or(0.0, |axis| axis.slope_bound(component))
    }

    /// The components whose curves are evaluated outside their range, as bits: axis × 6 + component.
    pub fn outside_range(&self, state: &State) -> u64 {
        let mut outside = 0;
        for range in &self.ranges {
            let Some(axis) = self.axes.get(range.looked_at) else {
                continue;
            };
            let [low, high] = range.domain;
            if !(low..=high).contains(&axis.looked_up(state.q[range.looked_at])) {
                outside |= 1 << (range.axis * LANES + range.component);
            }
        }
        outside
    }
}

impl AxisTables {
    /// Ready to evaluate, its tables among those of the machine.
    fn compiled(
        self,
        joint: &Joint,
        arm_mm: Vector3<f64>,
        slide: &Vector3<f64>,
        tables: &mut Tables,
    ) -> CompiledAxis {
        let heads: Vec<Head> = self
            .tables
            .iter()
            .map(|pieces| tables.add(pieces))
            .collect();
        // One table at least: `tables` and a blob have one or three.
        let (branches, heads) = match heads[..] {
            [forward, backward, mean] => (Branches::Three, [forward, backward, mean]),
            _ => (Branches::One, [heads[0]; 3]),
        };
        let all = self.tables.iter().flatten();
        CompiledAxis {
            joint: *joint,
            travel: self.travel,
            modulo: self.modulo,
            branches,
            heads,
            bounds: Bounds::of(all, &arm_mm, slide),
            patches: self.patches.into_iter().map(CompiledPatch::new).collect(),
            arm_mm,
            before_motion: errors_before_motion(joint),
            along: Along::of(&joint.direction),
            warmth: Warmth::default(),
        }
    }
}

impl CompiledAxis {
    /// The coordinate (mm, rad) in mm or deg, brought into travel where the axis has a modulo.
    #[inline(always)]
    pub(crate) fn looked_up(&self, q: f64) -> f64 {
        let coordinate = match self.joint.kind {
            AxisKind::Linear => q,
            AxisKind::Rotary => q.to_degrees(),
        };
        match self.modulo {
            Some(period) if !(self.travel[0]..=self.travel[1]).contains(&coordinate) => {
                // The Euclidean remainder, which `core` lacks.
                let rest = (coordinate - self.travel[0]) % period;
                self.travel[0] + if rest < 0.0 { rest + period } else { rest }
            }
            _ => coordinate,
        }
    }

    pub(crate) fn slope_bound(&self, component: usize) -> f64 {
        let of_tables = self.bounds.slopes[component.min(LANES - 1)];
        let patches = self.patches.iter().map(|compiled| &compiled.patch);
        let patches = patches.filter(|patch| patch.component == component);
        let warmth = self.warmth.slope_mm.get(component).copied();
        of_tables + patches.map(Patch::slope_bound).sum::<f64>() + libm::fabs(warmth.unwrap_or(0.0))
    }

    /// Bound of displacement (mm) of the tool tip and tilt (rad) of tables and temperature.
    pub(crate) fn size_bounds(&self) -> [f64; 2] {
        let [low, high] = self.travel.map(libm::fabs);
        let slope = Vector3::from(self.warmth.slope_mm).norm() * low.max(high);
        let [x, y, z, a, b, c] = self.warmth.at_tip;
        let warmth = [
            Vector3::new(x, y, z).norm() + slope,
            Vector3::new(a, b, c).norm(),
        ];
        [
            self.bounds.linear_mm + warmth[0],
            self.bounds.angular_rad + warmth[1],
        ]
    }
}

/// The tables of one axis, errors carried to the tool tip at machine zero and constant errors in.
fn tables(
    frame: &Frame,
    index: usize,
    parts: &AxisParts<'_>,
) -> Result<Vec<Vec<Piece>>, EvaluatorError> {
    let branches: &[Option<Direction>] = match parts.branches {
        Branches::One => &[None],
        // In the order of `branch_index`.
        Branches::Three => &[Some(Direction::Positive), Some(Direction::Negative), None],
    };
    let joint = &frame.chain.joints()[index];
    let slope = frame.folded.slide[index] + Vector3::from(parts.slope_mm);
    let table = |approach: &Option<Direction>| {
        let wanted = ToTable {
            errors: &|x| (parts.errors)(x, *approach),
            breakpoints: &parts.breakpoints,
            arm_mm: frame.chain.tool_tip_mm() - joint.point_mm,
            constant: frame.folded.constant[index],
            tolerance: frame.tolerance,
            axis: joint.name,
        };
        let mut pieces = wanted.fit()?;
        for piece in &mut pieces {
            piece.add_slope(&slope);
        }
        Ok(pieces)
    };
    branches.iter().map(table).collect()
}

impl ErrorSource for CompiledMachine {
    /// The error motion at the axis's point, from its table.
    fn error_motion(&self, index: usize, state: &State) -> ErrorMotion {
        let Some(axis) = self.axes.get(index) else {
            return ErrorMotion::ZERO;
        };
        let (q, head) = (
            state.q[index],
            &axis.heads[branch_index(state.approach[index])],
        );
        let mut twist = Baseline.value(&self.tables, head, axis.looked_up(q));
        self.add_patches(&mut twist, index, state);
        let [x, y, z, a, b, c, ..] = twist;
        let constant = &self.folded.constant[index];
        let tilt = Vector3::new(a, b, c) - constant.angular_rad;
        let at_tip = Vector3::new(x, y, z) - constant.linear_mm - self.folded.slide[index] * q;
        ErrorMotion {
            linear_mm: at_tip - tilt.cross(&axis.arm_mm),
            angular_rad: tilt,
        }
    }

    fn location(&self, index: usize) -> ErrorMotion {
        *self.location.get(index).unwrap_or(&ErrorMotion::ZERO)
    }

    fn assembly(&self, index: usize) -> ErrorMotion {
        *self.assembly.get(index).unwrap_or(&ErrorMotion::ZERO)
    }
}
