//! Folds constant errors into the tables of the axes.
//!
//! To first order the error of a chain is a sum of twists, each in the gap between two joints. A displaced axis line is
//! a twist on the fixed side of its joint and the opposite twist on its moving side; an assembly error is a twist in
//! one gap.
//!
//! A constant twist in a gap is added to the table of the axis that has its error motions in this gap. If there is no
//! such axis, the twist is moved to the other side of a neighbouring linear joint and added to the table of that axis.
//! A tilt then also causes a displacement that is linear in the coordinate, and the table includes this slope. At an
//! end of the chain, or between two rotary joints, the twist remains in its gap.

use volcomp_kinematics::{Chain, ErrorMotion, Joint, Side, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, MAX_AXES, PerAxis};

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

/// The same motion, with the displacement of the point at the end of `arm_mm`.
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
