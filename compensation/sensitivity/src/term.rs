//! The single errors of a chain, and their decomposition into constant twists in the gaps between the joints.
//!
//! To first order an error of one unit is a twist in one gap of the chain, or in two: a displaced axis line is a twist
//! on the workpiece side of its joint and the opposite twist on its tool side. A gap has six twists, so the 60 errors
//! of five axes are combinations of 36 twists, and only the effects of these change from pose to pose.

use core::fmt;

use nalgebra::{Matrix3, Vector3};
use volcomp_kinematics::{Chain, Side, State};
use volcomp_vocabulary::{AxisKind, AxisName, Component, ErrorName, MAX_AXES};

/// One error of a machine: an error motion, a location error, or an assembly error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ErrorTerm {
    /// An error motion `E?N` or a location error `E?0N`.
    Named(ErrorName),
    /// An assembly error, written `SXX … SCX` for the axis X.
    Assembly(Component, AxisName),
}

impl ErrorTerm {
    /// Component of the error along or about an axis of the machine coordinate system.
    pub fn component(self) -> Component {
        match self {
            Self::Named(name) => name.component,
            Self::Assembly(component, _) => component,
        }
    }

    /// Axis to which the error belongs: the `Y` of `EXY`.
    pub fn axis(self) -> AxisName {
        match self {
            Self::Named(name) => name.axis,
            Self::Assembly(_, axis) => axis,
        }
    }

    /// Name of the coefficient in a null combination: `EXC constant` for an error motion, whose curve has several coefficients; otherwise the name.
    pub fn coefficient(self) -> String {
        match self {
            Self::Named(name) if !name.location => format!("{name} constant"),
            _ => self.to_string(),
        }
    }
}

#[cfg(feature = "schema")]
impl serde::Serialize for ErrorTerm {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for ErrorTerm {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        String::schema_name()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        String::json_schema(generator)
    }
}

impl fmt::Display for ErrorTerm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Named(name) => name.fmt(f),
            Self::Assembly(component, axis) => write!(f, "S{}{axis}", component.letter()),
        }
    }
}

/// Errors of a chain, axis by axis from the workpiece to the tool: six error motions, then the location errors that have an effect. With
/// `assembly`, the six assembly errors replace the location errors; only those in
/// `stated` remain.
pub fn terms(chain: &Chain, assembly: bool, stated: &[ErrorName]) -> Vec<ErrorTerm> {
    let mut terms = Vec::new();
    for joint in chain.joints() {
        for component in Component::ALL {
            terms.push(ErrorTerm::Named(ErrorName::motion(component, joint.name)));
        }
        for component in Component::ALL {
            let name = ErrorName::location(component, joint.name);
            let wanted = !assembly || stated.contains(&name);
            if wanted && joint.no_effect(component).is_none() {
                terms.push(ErrorTerm::Named(name));
            }
        }
        if assembly {
            let six = Component::ALL.map(|component| ErrorTerm::Assembly(component, joint.name));
            terms.extend(six);
        }
    }
    terms
}

/// Maximum number of gaps: one before each axis and one after the last.
const MAX_GAPS: usize = MAX_AXES + 1;

/// A twist about the MCS origin in a gap; gap 0 is between the workpiece and the first axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct InGap {
    pub(crate) gap: usize,
    /// Displacement of a point at the origin: dimensionless for a length error, mm/rad for an angular error.
    pub(crate) linear: Vector3<f64>,
    /// Rotation vector: dimensionless for an angular error, zero for a length error.
    pub(crate) angular: Vector3<f64>,
}

/// Twists of an error of one unit (mm or rad); empty if the chain lacks the axis.
pub(crate) fn twists(chain: &Chain, term: ErrorTerm) -> Vec<InGap> {
    let joints = chain.joints();
    let Some(index) = joints.iter().position(|joint| joint.name == term.axis()) else {
        return Vec::new();
    };
    let joint = &joints[index];
    let mut unit = Vector3::zeros();
    unit[term.component().mcs_index()] = 1.0;
    let at = |gap: usize, point: &Vector3<f64>| {
        if term.component().is_angular() {
            InGap { gap, linear: point.cross(&unit), angular: unit }
        } else {
            InGap { gap, linear: unit, angular: Vector3::zeros() }
        }
    };
    let minus = |twist: InGap| InGap { linear: -twist.linear, angular: -twist.angular, ..twist };
    let origin = Vector3::zeros();
    match term {
        ErrorTerm::Assembly(..) => {
            let on_tool_side = joint.side == Side::Workpiece;
            vec![at(index + usize::from(on_tool_side), &origin)]
        }
        ErrorTerm::Named(name) if name.location => {
            // The line of a linear axis may have any position, so it is taken through the
            // origin.
            let point = match joint.kind {
                AxisKind::Linear => origin,
                AxisKind::Rotary => joint.point_mm,
            };
            vec![at(index, &point), minus(at(index + 1, &point))]
        }
        ErrorTerm::Named(_) => {
            let gap = index + usize::from(joint.errors_on_tool_side());
            vec![at(gap, &joint.point_mm)]
        }
    }
}

/// Position of the gaps relative to workpiece and tool at a pose, from which the effect of twists follows.
#[derive(Clone, Debug)]
pub(crate) struct Gaps {
    /// Rotations from the axes of each gap to the axes of the workpiece.
    pub(crate) turned: [Matrix3<f64>; MAX_GAPS],
    /// Tool tip in the coordinates of each gap, mm.
    pub(crate) tip_mm: [Vector3<f64>; MAX_GAPS],
}

impl Gaps {
    pub(crate) fn at(chain: &Chain, state: &State) -> Self {
        let mut gaps =
            Self { turned: [Matrix3::identity(); MAX_GAPS], tip_mm: [Vector3::zeros(); MAX_GAPS] };
        let joints = chain.joints();
        gaps.tip_mm[joints.len()] = chain.tool_tip_mm();
        for (index, joint) in joints.iter().enumerate().rev() {
            let motion = joint.motion(state.q[index]);
            gaps.tip_mm[index] = motion.transform_point(&gaps.tip_mm[index + 1]);
            // Rotation of this joint alone; the rotations of the previous joints are multiplied below.
            gaps.turned[index + 1] = motion.rotation;
        }
        for index in 1..=joints.len() {
            gaps.turned[index] = gaps.turned[index - 1] * gaps.turned[index];
        }
        gaps
    }

    /// Displacement of the tip (mm per unit) and rotation (rad per unit) caused by the twists of an error, in workpiece axes.
    pub(crate) fn effect(&self, twists: &[InGap]) -> [Vector3<f64>; 2] {
        let mut sum = [Vector3::zeros(); 2];
        for twist in twists {
            let turned = &self.turned[twist.gap];
            let displacement = twist.linear + twist.angular.cross(&self.tip_mm[twist.gap]);
            sum[0] += turned * displacement;
            sum[1] += turned * twist.angular;
        }
        sum
    }
}
