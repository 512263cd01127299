//! The compiled machine: plain data, and its properties. Constant errors are folded into the tables of the axes.
//!
//! To first order the error of a chain is a sum of twists, each in the gap between two joints. A displaced axis line is
//! a twist on the fixed side of its joint and the opposite twist on its moving side; an assembly error is a twist in
//! one gap.
//!
//! A constant twist in a gap is added to the table of the axis that has its error motions in this gap. If there is no
//! such axis, the twist is moved to the other side of a neighbouring linear joint and added to the table of that axis.
//! A tilt then also causes a displacement that is linear in the coordinate, and the table includes this slope. At an
//! end of the chain, or between two rotary joints, the twist remains in its gap.

use alloc::vec::Vec;

use arrayvec::ArrayVec;
use volcomp_kinematics::{Chain, Correctors, ErrorMotion, Joint, Side, State, nalgebra::Vector3};
use volcomp_vocabulary::{
    AxisKind, AxisName, Component, ErrorName, MAX_AXES, PerAxis, brought_into, is_within,
};

use crate::{
    Tolerance,
    parts::Branches,
    table::{Bounds, CompiledPatch, Head, LANES, Patch, Tables},
    turn::Along,
};

/// The volumetric error at one pose, first order, in workpiece axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evaluation {
    /// Position error ΔP of the tool tip, mm.
    pub position_mm: [f64; 3],
    /// Rotation error ρ of the tool, a rotation vector in rad.
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

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CompiledAxis {
    pub(crate) joint: Joint,
    pub(crate) travel: [f64; 2],
    pub(crate) modulo: Option<f64>,
    pub(crate) branches: Branches,
    /// The table for each approach, with errors transformed to the tool tip at machine zero and constant errors included.
    pub(crate) heads: [Head; 3],
    pub(crate) patches: Vec<CompiledPatch>,
    /// Vector from the point of the axis to the tool tip at machine zero, mm.
    pub(crate) arm_mm: Vector3<f64>,
    /// True if the errors are on the tool side of the joint.
    pub(crate) before_motion: bool,
    pub(crate) along: Along,
    pub(crate) bounds: Bounds,
    pub(crate) thermal: Thermal,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Thermal {
    /// Offset transformed to the tool tip at machine zero, mm and rad.
    pub(crate) at_tip: [f64; LANES],
    pub(crate) slope_mm: [f64; 3],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Range {
    pub(crate) axis: usize,
    pub(crate) component: Component,
    pub(crate) looked_at: usize,
    pub(crate) domain: [f64; 2],
}

/// A machine whose curves are piecewise cubics and whose constant errors are folded into them: plain data, evaluated to
/// first order without allocation, lock or panic. Thermal terms are those at the time of compilation, or of the last
/// call of [`set_thermal_offset`](Self::set_thermal_offset).
#[derive(Clone, Debug, PartialEq)]
pub struct CompiledMachine {
    pub(crate) chain: Chain,
    pub(crate) location: PerAxis<ErrorMotion>,
    pub(crate) assembly: PerAxis<ErrorMotion>,
    pub(crate) tolerance: Tolerance,
    pub(crate) axes: Vec<CompiledAxis>,
    pub(crate) tables: Tables,
    pub(crate) ranges: Vec<Range>,
    pub(crate) folded: Folded,
    /// True if a constant error remains at the workpiece end.
    pub(crate) at_workpiece: bool,
    /// True if an axis has errors outside its table (over two coordinates, or thermal), or a constant error remains
    /// between two axes.
    pub(crate) patched: bool,
    /// True for three linear axes without errors outside their tables.
    pub(crate) three_slides: bool,
    /// The axes that corrections may move, without duplicates; `correctors` is the selection among them that corrects.
    pub(crate) may_move: ArrayVec<AxisName, MAX_AXES>,
    pub(crate) correctors: Correctors,
}

impl CompiledMachine {
    pub(crate) fn choose_path(&mut self) {
        let plain =
            |axis: &CompiledAxis| axis.patches.is_empty() && axis.thermal == Thermal::default();
        let slides = |axis: &CompiledAxis| axis.joint.kind == AxisKind::Linear;
        let mut between = self.folded.between.iter();
        let nothing_between = between.all(|held| *held == ErrorMotion::ZERO);
        self.patched = !(self.axes.iter().all(plain) && nothing_between);
        self.three_slides = self.axes.len() == 3 && self.axes.iter().all(slides) && !self.patched;
    }

    /// Sets the thermal part of the error motions of the axis at the chain index `index`: `offset` (mm, rad) at the
    /// axis's point, and `slope_mm` per mm of a linear axis's coordinate. It replaces the previous thermal part and is
    /// included in blobs. An index without an axis changes nothing. Does not allocate.
    pub fn set_thermal_offset(&mut self, index: usize, offset: &ErrorMotion, slope_mm: [f64; 3]) {
        let Some(axis) = self.axes.get_mut(index) else {
            return;
        };
        let (tilt, arm_mm) = (offset.angular_rad, axis.arm_mm);
        let at_tip = offset.linear_mm + tilt.cross(&arm_mm);
        axis.thermal =
            Thermal { at_tip: [at_tip.x, at_tip.y, at_tip.z, tilt.x, tilt.y, tilt.z], slope_mm };
        self.choose_path();
    }

    /// The ideal chain, mm and rad.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Maximum deviation of the compiled curves from their sources.
    pub fn tolerance(&self) -> Tolerance {
        self.tolerance
    }

    /// Number of cubic pieces of all tables.
    pub fn pieces(&self) -> usize {
        self.tables.len()
    }

    /// Size of all tables, bytes.
    pub fn bytes(&self) -> usize {
        self.tables.bytes()
    }

    /// Bound of the absolute slope of one error motion at the axis's point, over the whole travel and all branches: mm
    /// or rad per mm or deg.
    pub fn slope_bound(&self, axis: AxisName, component: Component) -> f64 {
        let axis = self.axes.iter().find(|a| a.joint.name == axis);
        axis.map_or(0.0, |axis| axis.slope_bound(component))
    }

    /// The error motions whose curves are evaluated outside their range at a state. Does not allocate.
    pub fn outside_range(&self, state: &State) -> OutsideRange<'_> {
        let mut outside = 0_u64;
        for range in &self.ranges {
            let Some(axis) = self.axes.get(range.looked_at) else {
                continue;
            };
            if !is_within(range.domain, axis.looked_up(state.q[range.looked_at])) {
                outside |= 1 << (range.axis * LANES + range.component.index());
            }
        }
        OutsideRange { names: self.chain.structure().axes(), outside }
    }
}

/// Error motions whose curves were evaluated outside their range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutsideRange<'a> {
    names: &'a [AxisName],
    /// Bit mask: bit 6 × axis + component.
    outside: u64,
}

impl OutsideRange<'_> {
    /// True if every curve was within its range.
    pub fn is_empty(&self) -> bool {
        self.outside == 0
    }

    /// The names, axis after axis in chain order.
    pub fn iter(&self) -> impl Iterator<Item = ErrorName> + '_ {
        let (axes, outside) = (self.names.iter().enumerate(), self.outside);
        axes.flat_map(move |(index, &axis)| {
            let named = Component::ALL.into_iter();
            named
                .filter(move |component| outside >> (index * LANES + component.index()) & 1 == 1)
                .map(move |component| ErrorName::motion(component, axis))
        })
    }
}

impl CompiledAxis {
    /// Converts a coordinate (mm, rad) to mm or deg, reduced into travel by a modulo.
    #[inline(always)]
    pub(crate) fn looked_up(&self, q: f64) -> f64 {
        let coordinate = match self.joint.kind {
            AxisKind::Linear => q,
            AxisKind::Rotary => q.to_degrees(),
        };
        match self.modulo {
            Some(period) => brought_into(self.travel, period, coordinate),
            None => coordinate,
        }
    }

    pub(crate) fn slope_bound(&self, component: Component) -> f64 {
        let of_tables = self.bounds.slopes[component.index()];
        let patches = self.patches.iter().map(|compiled| &compiled.patch);
        let patches = patches.filter(|patch| patch.component == component);
        let thermal = self.thermal.slope_mm.get(component.index()).copied();
        of_tables
            + patches.map(Patch::slope_bound).sum::<f64>()
            + libm::fabs(thermal.unwrap_or(0.0))
    }

    /// Bound of the displacement (mm) of the tool tip and the tilt (rad) from tables and thermal terms.
    pub(crate) fn size_bounds(&self) -> [f64; 2] {
        let [low, high] = self.travel.map(libm::fabs);
        let slope = Vector3::from(self.thermal.slope_mm).norm() * low.max(high);
        let [x, y, z, a, b, c] = self.thermal.at_tip;
        let thermal = [Vector3::new(x, y, z).norm() + slope, Vector3::new(a, b, c).norm()];
        [self.bounds.linear_mm + thermal[0], self.bounds.angular_rad + thermal[1]]
    }
}

/// Constant errors after folding. Displacements are those of the tool tip at machine zero.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Folded {
    /// Constant error between the last joint and the tool, if that joint is rotary and has its errors on its workpiece
    /// side.
    pub(crate) tool_end: ErrorMotion,
    /// Constant error on the tool side of each joint except the last, unless a table includes it.
    pub(crate) between: PerAxis<ErrorMotion>,
    /// Constant error between the workpiece and the first joint, if that joint is rotary and has its errors on its tool
    /// side.
    pub(crate) workpiece_end: ErrorMotion,
    pub(crate) constant: PerAxis<ErrorMotion>,
    /// Slope added to the table of a linear axis: displacement, mm, per mm of its coordinate.
    pub(crate) slide: PerAxis<Vector3<f64>>,
}

pub(crate) fn fold(
    chain: &Chain,
    location: &PerAxis<ErrorMotion>,
    assembly: &PerAxis<ErrorMotion>,
) -> Folded {
    let (joints, tip) = (chain.joints(), chain.tool_tip_mm());
    let mut slide = PerAxis([Vector3::zeros(); MAX_AXES]);
    // Gap i is on the workpiece side of joint i, gap i + 1 on its tool side.
    let mut gaps = [ErrorMotion::ZERO; MAX_AXES + 1];
    for (i, joint) in joints.iter().enumerate() {
        let fixed_to = match joint.side {
            Side::Tool => i,
            Side::Workpiece => i + 1,
        };
        add(&mut gaps[fixed_to], &at_tip(&assembly[i], &tip), 1.0);
        match joint.kind {
            AxisKind::Linear => slide[i] += location[i].angular_rad.cross(&joint.direction),
            AxisKind::Rotary => {
                let line = at_tip(&location[i], &(tip - joint.point_mm));
                add(&mut gaps[i], &line, 1.0);
                add(&mut gaps[i + 1], &line, -1.0);
            }
        }
    }
    let mut constant = PerAxis::default();
    let last = joints.len();
    let (mut tool_end, mut workpiece_end) = (ErrorMotion::ZERO, ErrorMotion::ZERO);
    let mut between = PerAxis::default();
    for (gap, held) in gaps.iter().enumerate().take(last + 1) {
        let inner = joints.get(gap);
        let outer = gap.checked_sub(1).and_then(|i| joints.get(i));
        let linear = |joint: Option<&Joint>| joint.is_some_and(|j| j.kind == AxisKind::Linear);
        let tilt = &held.angular_rad;
        if inner.is_some_and(|joint| !joint.errors_on_tool_side()) {
            add(&mut constant[gap], held, 1.0);
        } else if outer.is_some_and(Joint::errors_on_tool_side) {
            add(&mut constant[gap - 1], held, 1.0);
        } else if let (true, Some(joint)) = (linear(inner), inner) {
            add(&mut constant[gap], held, 1.0);
            slide[gap] += tilt.cross(&joint.direction);
        } else if let (true, Some(joint)) = (linear(outer), outer) {
            add(&mut constant[gap - 1], held, 1.0);
            slide[gap - 1] -= tilt.cross(&joint.direction);
        } else if gap == 0 {
            workpiece_end = *held;
        } else if gap == last {
            tool_end = *held;
        } else {
            between[gap - 1] = *held;
        }
    }
    Folded { tool_end, between, workpiece_end, constant, slide }
}

/// Restates a motion at the point to which `arm_mm` leads from the point where it is stated.
fn at_tip(motion: &ErrorMotion, arm_mm: &Vector3<f64>) -> ErrorMotion {
    ErrorMotion {
        linear_mm: motion.linear_mm + motion.angular_rad.cross(arm_mm),
        angular_rad: motion.angular_rad,
    }
}

fn add(sum: &mut ErrorMotion, motion: &ErrorMotion, factor: f64) {
    sum.linear_mm += motion.linear_mm * factor;
    sum.angular_rad += motion.angular_rad * factor;
}
