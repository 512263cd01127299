//! The ideal kinematic chain: joints, tool and workpiece at machine zero, and its state.
//!
//! [`ErrorSource`] is the interface that supplies the errors of its axes.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use volcomp_vocabulary::{AxisKind, AxisName, Component, Direction, ErrorName, MAX_AXES, PerAxis};

use crate::error::{ChainError, InsteadConstant, NoEffect};
use crate::pose::{Pose, Screw, rotation_about_axis};
use crate::structure::{Side, Structure};

/// Frame in which the error motions of a rotary axis are stated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum MotionFrame {
    /// The non-rotating frame, as measured by a spindle analyser or by a measuring device on the bed (ISO 230-7).
    #[default]
    Fixed,
    /// The frame after the joint: the error motions rotate with the axis, as in the model with 60 error twists
    /// (Procedia Engineering 24 (2011) 845–849).
    Turning,
}

/// One axis of the chain, described in MCS at machine zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    pub name: AxisName,
    pub kind: AxisKind,
    /// Whether the axis carries the workpiece or the tool.
    pub side: Side,
    /// Unit direction u of the axis, in MCS.
    pub direction: Vector3<f64>,
    /// Point c, mm in MCS. For a rotary axis, any point of its line; for a linear axis, the point of the carriage at
    /// which its errors are stated.
    pub point_mm: Vector3<f64>,
    /// Frame of the error motions of a rotary axis. The error motions of a linear axis always move with its carriage.
    pub motion_frame: MotionFrame,
}

impl Joint {
    /// Whether the error motions act on the tool side of this joint's own motion. If so, the coordinate of the joint
    /// does not change the lever from `point_mm` to the tool. The error motions of a linear axis move with its
    /// carriage; the error motions of a rotary axis rotate with it only if `motion_frame` is [`MotionFrame::Turning`].
    pub fn errors_on_tool_side(&self) -> bool {
        let ride = self.kind == AxisKind::Linear || self.motion_frame == MotionFrame::Turning;
        ride == (self.side == Side::Tool)
    }

    /// Ideal motion J(q) of the joint at coordinate `q`, mm or rad: Trans(u·q) for a linear axis, Trans(c) Rot(u, q)
    /// Trans(−c) for a rotary axis.
    pub fn motion(&self, q: f64) -> Pose {
        match self.kind {
            AxisKind::Linear => Pose::from_translation(self.direction * q),
            AxisKind::Rotary => {
                Pose::about_point(rotation_about_axis(&self.direction, q), self.point_mm)
            }
        }
    }

    /// The screw of this joint at machine zero.
    pub fn screw(&self) -> Screw {
        match self.kind {
            AxisKind::Linear => Screw::Prismatic { direction: self.direction },
            AxisKind::Rotary => Screw::Revolute {
                direction: self.direction,
                point_mm: self.point_mm,
                pitch_mm: 0.0,
            },
        }
    }
}

/// Kinematic chain of a serial machine from the workpiece to the tool, with tool tip, tool axis and workpiece origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    structure: Structure,
    joints: ArrayVec<Joint, MAX_AXES>,
    tool_tip_mm: Vector3<f64>,
    tool_axis: Vector3<f64>,
    workpiece_origin_mm: Vector3<f64>,
}

impl Chain {
    /// The orthogonal chain of a structure. Axis directions follow from the letters; all points, the tool tip and the
    /// workpiece origin are at the MCS origin; the tool axis is along +Z.
    pub fn new(structure: Structure) -> Self {
        let joints = structure
            .axes()
            .iter()
            .enumerate()
            .map(|(index, &name)| Joint {
                name,
                kind: name.kind(),
                side: structure.side(index),
                direction: letter_direction(name),
                point_mm: Vector3::zeros(),
                motion_frame: MotionFrame::Fixed,
            })
            .collect();
        Self {
            structure,
            joints,
            tool_tip_mm: Vector3::zeros(),
            tool_axis: Vector3::z(),
            workpiece_origin_mm: Vector3::zeros(),
        }
    }

    /// Sets the direction of an axis, in MCS at machine zero. The direction may have any length except 0.
    ///
    /// # Errors
    /// [`ChainError::NoSuchAxis`]; [`ChainError::Direction`] for a zero vector or numbers that are not finite.
    pub fn set_direction(&mut self, axis: AxisName, direction: [f64; 3]) -> Result<(), ChainError> {
        let unit = unit("direction", direction)?;
        self.joint_mut(axis)?.direction = unit;
        Ok(())
    }

    /// Sets the point of an axis (mm, MCS at machine zero).
    ///
    /// # Errors
    /// [`ChainError::NoSuchAxis`]; [`ChainError::Point`] for numbers that are not finite.
    pub fn set_point(&mut self, axis: AxisName, point_mm: [f64; 3]) -> Result<(), ChainError> {
        let point = finite("point", point_mm)?;
        self.joint_mut(axis)?.point_mm = point;
        Ok(())
    }

    /// Sets the frame in which the error motions of a rotary axis are stated.
    ///
    /// # Errors
    /// [`ChainError::NoSuchAxis`]; [`ChainError::MotionFrame`] for a linear axis, whose error motions move with its
    /// carriage.
    pub fn set_motion_frame(
        &mut self,
        axis: AxisName,
        frame: MotionFrame,
    ) -> Result<(), ChainError> {
        let joint = self.joint_mut(axis)?;
        if joint.kind == AxisKind::Linear {
            return Err(ChainError::MotionFrame { axis });
        }
        joint.motion_frame = frame;
        Ok(())
    }

    /// Sets the tool tip (mm) and the tool axis (from the tip to the spindle, any length except 0), in MCS at machine
    /// zero.
    ///
    /// # Errors
    /// [`ChainError::Point`] for a tip that is not finite; [`ChainError::Direction`] for a zero or non-finite axis.
    pub fn set_tool(&mut self, tip_mm: [f64; 3], axis: [f64; 3]) -> Result<(), ChainError> {
        self.tool_tip_mm = finite("tool tip", tip_mm)?;
        self.tool_axis = unit("tool axis", axis)?;
        Ok(())
    }

    /// Sets the workpiece origin, mm in MCS at machine zero.
    ///
    /// # Errors
    /// [`ChainError::Point`] for numbers that are not finite.
    pub fn set_workpiece_origin(&mut self, origin_mm: [f64; 3]) -> Result<(), ChainError> {
        self.workpiece_origin_mm = finite("workpiece origin", origin_mm)?;
        Ok(())
    }

    fn joint_mut(&mut self, axis: AxisName) -> Result<&mut Joint, ChainError> {
        match self.structure.index_of(axis) {
            Some(index) => Ok(&mut self.joints[index]),
            None => Err(ChainError::NoSuchAxis { axis, structure: self.structure.clone() }),
        }
    }

    pub fn structure(&self) -> &Structure {
        &self.structure
    }

    /// The joints in the order of the chain, from the workpiece to the tool.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Position of the tool tip at machine zero, mm in MCS.
    pub fn tool_tip_mm(&self) -> Vector3<f64> {
        self.tool_tip_mm
    }

    /// Unit vector of the tool axis at machine zero, from the tip to the spindle, in MCS.
    pub fn tool_axis(&self) -> Vector3<f64> {
        self.tool_axis
    }

    /// Position of the workpiece origin at machine zero, mm in MCS.
    pub fn workpiece_origin_mm(&self) -> Vector3<f64> {
        self.workpiece_origin_mm
    }

    /// Arranges values in the order of the chain. There must be exactly one value for each axis of the chain, in any
    /// order.
    ///
    /// # Errors
    /// [`ChainError::NoSuchAxis`], [`ChainError::AxisTwice`] or [`ChainError::AxisMissing`].
    pub fn by_axis<T: Copy + Default>(
        &self,
        values: impl IntoIterator<Item = (AxisName, T)>,
    ) -> Result<PerAxis<T>, ChainError> {
        let mut found = PerAxis::<Option<T>>::default();
        for (axis, value) in values {
            let Some(index) = self.structure.index_of(axis) else {
                return Err(ChainError::NoSuchAxis { axis, structure: self.structure.clone() });
            };
            if found[index].replace(value).is_some() {
                return Err(ChainError::AxisTwice { axis });
            }
        }
        let missing = self.joints.iter().zip(&found).find(|of| of.1.is_none());
        if let Some((joint, _)) = missing {
            return Err(ChainError::AxisMissing {
                axis: joint.name,
                structure: self.structure.clone(),
            });
        }
        Ok(found.map(Option::unwrap_or_default))
    }

    /// Picks the value of an axis from `values`, which are in the order of the chain. `None` if the chain has no such
    /// axis.
    pub fn of_axis<T: Copy>(&self, axis: AxisName, values: &PerAxis<T>) -> Option<T> {
        self.structure.index_of(axis).map(|index| values[index])
    }

    /// The ideal pose `T_ideal(q)`: maps tool coordinates to workpiece coordinates.
    pub fn ideal_pose(&self, state: &State) -> Pose {
        self.joints
            .iter()
            .zip(state.q)
            .fold(Pose::identity(), |pose, (joint, q)| pose * joint.motion(q))
    }

    /// Distance of the tool tip from the line of the rotary axis at `index`, mm; it equals the displacement of the tip
    /// in mm per rad of this axis. The coordinate of the axis itself has no influence. Zero for a linear axis and for
    /// an index without an axis.
    pub fn lever_mm(&self, index: usize, state: &State) -> f64 {
        let Some(axis) = self.joints.get(index) else {
            return 0.0;
        };
        if axis.kind == AxisKind::Linear {
            return 0.0;
        }
        let tip_mm = self.carried_tip_mm(index + 1, state);
        axis.direction.cross(&(tip_mm - axis.point_mm)).norm()
    }

    /// Motion, in MCS, by which the axes between the bed and the axis at `index` carry this axis. The returned pose
    /// maps the point and the direction of the axis at machine zero to those at `state`. The coordinate of the axis
    /// itself has no influence. The identity for an index without an axis.
    pub fn carrier_pose(&self, index: usize, state: &State) -> Pose {
        let Some(carried) = self.joints.get(index) else {
            return Pose::identity();
        };
        let between = self.joints.iter().zip(state.q).enumerate();
        let carriers = between.filter(|(place, (joint, _))| {
            let is_between = match carried.side {
                Side::Tool => *place < index,
                Side::Workpiece => *place > index,
            };
            joint.side == carried.side && is_between
        });
        let pose = carriers.fold(Pose::identity(), |pose, (_, (joint, q))| pose * joint.motion(q));
        match carried.side {
            Side::Tool => pose,
            // A chain describes the tool relative to the workpiece. Relative to the bed, the motion on the workpiece
            // side is the inverse.
            Side::Workpiece => pose.inverse(),
        }
    }

    /// Ideal position of the tool tip relative to the workpiece origin, mm in workpiece axes: T·tip − origin.
    pub fn ideal_tip_mm(&self, state: &State) -> Vector3<f64> {
        self.carried_tip_mm(0, state) - self.workpiece_origin_mm
    }

    /// Position of the tool tip after the motions of the joints from index `first` to the tool, mm in MCS.
    fn carried_tip_mm(&self, first: usize, state: &State) -> Vector3<f64> {
        let carriers = self.joints.iter().zip(state.q).skip(first).rev();
        carriers.fold(self.tool_tip_mm, |tip_mm, (joint, q)| match joint.kind {
            AxisKind::Linear => tip_mm + joint.direction * q,
            AxisKind::Rotary => joint.motion(q).transform_point(&tip_mm),
        })
    }
}

fn finite(what: &'static str, found: [f64; 3]) -> Result<Vector3<f64>, ChainError> {
    if found.iter().all(|x| x.is_finite()) {
        Ok(Vector3::from(found))
    } else {
        Err(ChainError::Point { what, found })
    }
}

fn unit(what: &'static str, found: [f64; 3]) -> Result<Vector3<f64>, ChainError> {
    // The vector is scaled first, so that the squares of tiny and huge numbers neither underflow nor overflow.
    let largest = found.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    if !found.iter().all(|x| x.is_finite()) || largest == 0.0 {
        return Err(ChainError::Direction { what, found });
    }
    Ok((Vector3::from(found) / largest).normalize())
}

impl State {
    /// Creates a state from one coordinate (mm or rad) for each axis of the chain, in any order. The approach of every
    /// axis is unknown (`None`).
    ///
    /// # Errors
    /// See [`Chain::by_axis`].
    pub fn new(
        chain: &Chain,
        coordinates: impl IntoIterator<Item = (AxisName, f64)>,
    ) -> Result<Self, ChainError> {
        Ok(Self { q: chain.by_axis(coordinates)?, ..Self::default() })
    }
}

/// Coordinates and directions of approach of all axes of a chain, in the order of the chain.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    /// Commanded coordinates: mm for linear axes, rad for rotary axes. Entries beyond the last axis are 0.
    pub q: PerAxis<f64>,
    /// Direction of the last travel of each axis, which selects the branch of a bidirectional curve. `None` is an
    /// unknown direction, for which the mean of both branches applies.
    pub approach: PerAxis<Option<Direction>>,
}

/// Three translations along and three rotations about the axes of the MCS.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ErrorMotion {
    /// Translations δ = (EXN, EYN, EZN), mm.
    pub linear_mm: Vector3<f64>,
    /// Rotations ε = (EAN, EBN, ECN), rad.
    pub angular_rad: Vector3<f64>,
}

impl ErrorMotion {
    pub const ZERO: Self =
        Self { linear_mm: Vector3::new(0.0, 0.0, 0.0), angular_rad: Vector3::new(0.0, 0.0, 0.0) };

    /// Converts errors in the order of ISO 230-1 (X, Y, Z, A, B, C): three in µm, then three in µrad.
    pub fn from_um_urad(six: [f64; 6]) -> Self {
        Self {
            linear_mm: Vector3::new(six[0], six[1], six[2]) * 1e-3,
            angular_rad: Vector3::new(six[3], six[4], six[5]) * 1e-6,
        }
    }
}

/// Source of the errors of all axes of a chain, by chain index.
///
/// Signs and frames are those of ISO 230-1 as defined in the crate documentation: an error motion is a motion of the
/// tool side relative to the workpiece side; a location error is the displacement of the physical axis line.
pub trait ErrorSource {
    /// The six error motions `E?N` of an axis at a state, mm and rad, stated at the point of the axis.
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion;

    /// The location errors `E?0N` of an axis: offset o (mm) and tilt ω (rad) of its line.
    fn location(&self, _axis: usize) -> ErrorMotion {
        ErrorMotion::ZERO
    }

    /// Errors of the assembly between an axis and the axis or bed that carries it: offsets (mm), and angles (rad) about
    /// the MCS origin.
    fn assembly(&self, _axis: usize) -> ErrorMotion {
        ErrorMotion::ZERO
    }
}

impl Default for ErrorMotion {
    fn default() -> Self {
        Self::ZERO
    }
}

impl<S: ErrorSource + ?Sized> ErrorSource for &S {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        (**self).error_motion(axis, state)
    }
    fn location(&self, axis: usize) -> ErrorMotion {
        (**self).location(axis)
    }
    fn assembly(&self, axis: usize) -> ErrorMotion {
        (**self).assembly(axis)
    }
}

/// Unit vector in MCS of an axis letter: the direction of motion of X Y Z U V W, the axis of rotation of A B C.
pub fn letter_direction(name: AxisName) -> Vector3<f64> {
    let mut direction = Vector3::zeros();
    direction[name.mcs_index()] = 1.0;
    direction
}

/// The machine axis (0, 1 or 2 for X, Y or Z) to which a unit vector is parallel, and whether the vector points in its
/// positive direction. `None` if the vector is parallel to none of the three.
pub fn along_machine_axis(direction: &Vector3<f64>) -> Option<(usize, bool)> {
    let place = direction.iter().position(|u| u.abs() > 1.0 - 1e-12)?;
    Some((place, direction[place] > 0.0))
}

impl Joint {
    /// Reason why this component of a location error has no effect on the axis; `None` if it has an effect.
    pub fn no_effect(&self, component: Component) -> Option<NoEffect> {
        let place = component.mcs_index();
        let along = along_machine_axis(&self.direction);
        let along_itself = along.is_some_and(|(along, _)| along == place);
        let instead =
            InsteadConstant { error: ErrorName::motion(component, self.name), side: self.side };
        match (self.kind, component.is_angular()) {
            (AxisKind::Linear, false) => Some(NoEffect::OffsetOfLinearAxis(instead)),
            (AxisKind::Rotary, _) if along_itself => Some(NoEffect::AlongRotaryAxis(instead)),
            (AxisKind::Linear, true) if along_itself => Some(NoEffect::AboutLinearAxis(instead)),
            _ => None,
        }
    }
}
