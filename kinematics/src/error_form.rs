//! The three forms of the volumetric error model: `exact`, `htm` and `twist`.
//!
//! Also [`GivenErrors`], a source of constant errors.

use core::fmt;
use core::str::FromStr;

use nalgebra::{Matrix3, Vector3};
use volcomp_vocabulary::{AxisKind, Displacement, ErrorName, MAX_AXES, PerAxis};

use crate::chain::{Chain, ErrorMotion, ErrorSource, Joint, State};
use crate::error::ChainError;
use crate::math::sin_cos;
use crate::pose::{
    Pose, rotation_about_axis, rotation_from_sin_cos, rotation_from_vector, rotation_quotients,
    skew_part, small_rotation, vector_from_rotation,
};
use crate::structure::Side;

/// Form of the model that computes the volumetric error. All forms agree to first order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Form {
    /// Products of exponentials (DOI 10.1177/0954405416663537).
    #[default]
    Exact,
    /// Products of small-angle matrices (DOI 10.1177/0954405414564407).
    Htm,
    /// The sum of the error twists (Procedia Engineering 24 (2011) 845–849).
    Twist,
}

/// A form name other than `exact`, `htm`, `twist`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown model form, expected exact, htm or twist")]
pub struct UnknownForm;

impl FromStr for Form {
    type Err = UnknownForm;

    fn from_str(name: &str) -> Result<Self, UnknownForm> {
        match name {
            "exact" => Ok(Self::Exact),
            "htm" => Ok(Self::Htm),
            "twist" => Ok(Self::Twist),
            _ => Err(UnknownForm),
        }
    }
}

impl fmt::Display for Form {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Exact => "exact",
            Self::Htm => "htm",
            Self::Twist => "twist",
        })
    }
}

/// The volumetric error at one state, in workpiece axes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct VolumetricError {
    /// Actual minus ideal tip position ΔP, mm.
    pub position_mm: Vector3<f64>,
    /// Rotation vector ρ of `R_actual` · `R_idealᵀ`, rad.
    pub rotation_rad: Vector3<f64>,
}

/// Computes the volumetric error at `state` in the given form; all forms agree to first order in the errors.
pub fn volumetric_error<S: ErrorSource>(
    chain: &Chain,
    source: &S,
    state: &State,
    form: Form,
) -> VolumetricError {
    match form {
        Form::Exact => product_form::<Exponential, S>(chain, source, state),
        Form::Htm => product_form::<SmallAngle, S>(chain, source, state),
        Form::Twist => twist_sum(chain, source, state),
    }
}

/// The actual pose `T_actual(q)`: the product of exponentials with all errors.
pub fn actual_pose<S: ErrorSource>(chain: &Chain, source: &S, state: &State) -> Pose {
    actual_product::<Exponential, S>(chain, source, state)
}

/// Image of a tool point under the actual pose, mm. The result equals that of [`actual_pose`]; no matrices are formed,
/// which is faster.
pub fn actual_point_mm<S: ErrorSource>(
    chain: &Chain,
    source: &S,
    state: &State,
    point_mm: &Vector3<f64>,
) -> Vector3<f64> {
    let mut point = *point_mm;
    for (index, joint) in chain.joints().iter().enumerate().rev() {
        let (q, error) = (state.q[index], source.error_motion(index, state));
        let (location, assembly) = (source.location(index), source.assembly(index));
        let direction = rotated(&joint.direction, &location.angular_rad);
        let assemble = |at: Vector3<f64>| rotated(&at, &assembly.angular_rad) + assembly.linear_mm;
        let err = |at: Vector3<f64>| {
            let lever = at - joint.point_mm;
            rotated(&lever, &error.angular_rad) + joint.point_mm + error.linear_mm
        };
        let go = |at: Vector3<f64>| match joint.kind {
            AxisKind::Linear => at + direction * q,
            AxisKind::Rotary => {
                let centre = joint.point_mm + location.linear_mm;
                rotation_about_axis(&direction, q) * (at - centre) + centre
            }
        };
        // The factors of `actual_product` act on the point from right to left.
        point = match (joint.side, joint.errors_on_tool_side()) {
            (Side::Tool, true) => assemble(go(err(point))),
            (Side::Tool, false) => assemble(err(go(point))),
            (Side::Workpiece, true) => go(err(assemble(point))),
            (Side::Workpiece, false) => err(go(assemble(point))),
        };
    }
    point
}

/// The vector exp(r^)·v, computed without the matrix exp(r^).
fn rotated(v: &Vector3<f64>, r_rad: &Vector3<f64>) -> Vector3<f64> {
    let angle_squared = r_rad.norm_squared();
    if angle_squared == 0.0 {
        return *v;
    }
    let (sine_quotient, cosine_quotient) = rotation_quotients(angle_squared);
    let across = r_rad.cross(v);
    v + across * sine_quotient + r_rad.cross(&across) * cosine_quotient
}

trait SmallMotion {
    fn rotation(r_rad: &Vector3<f64>) -> Matrix3<f64>;
    fn tilted(direction: &Vector3<f64>, tilt_rad: &Vector3<f64>, kind: AxisKind) -> Vector3<f64>;
    fn rotation_vector(rotation: &Matrix3<f64>) -> Vector3<f64>;
}

struct Exponential;
struct SmallAngle;

impl SmallMotion for Exponential {
    fn rotation(r_rad: &Vector3<f64>) -> Matrix3<f64> {
        rotation_from_vector(r_rad)
    }
    fn tilted(direction: &Vector3<f64>, tilt_rad: &Vector3<f64>, _: AxisKind) -> Vector3<f64> {
        rotation_from_vector(tilt_rad) * direction
    }
    fn rotation_vector(rotation: &Matrix3<f64>) -> Vector3<f64> {
        vector_from_rotation(rotation)
    }
}

impl SmallMotion for SmallAngle {
    fn rotation(r_rad: &Vector3<f64>) -> Matrix3<f64> {
        small_rotation(r_rad)
    }
    fn tilted(direction: &Vector3<f64>, tilt_rad: &Vector3<f64>, kind: AxisKind) -> Vector3<f64> {
        let tilted = direction + tilt_rad.cross(direction);
        match kind {
            AxisKind::Linear => tilted,
            AxisKind::Rotary => tilted.normalize(),
        }
    }
    fn rotation_vector(rotation: &Matrix3<f64>) -> Vector3<f64> {
        skew_part(rotation)
    }
}

fn product_form<M: SmallMotion, S: ErrorSource>(
    chain: &Chain,
    source: &S,
    state: &State,
) -> VolumetricError {
    let ideal = chain.ideal_pose(state);
    let actual = actual_product::<M, S>(chain, source, state);
    let tip = chain.tool_tip_mm();
    VolumetricError {
        position_mm: actual.transform_point(&tip) - ideal.transform_point(&tip),
        rotation_rad: M::rotation_vector(&(actual.rotation * ideal.rotation.transpose())),
    }
}

fn actual_product<M: SmallMotion, S: ErrorSource>(
    chain: &Chain,
    source: &S,
    state: &State,
) -> Pose {
    let mut pose = Pose::identity();
    for (index, (joint, &q)) in chain.joints().iter().zip(&state.q).enumerate() {
        let error = error_pose::<M>(&source.error_motion(index, state), &joint.point_mm);
        let motion = actual_motion::<M>(joint, q, &source.location(index));
        let assembly = source.assembly(index);
        let assembly = Pose {
            rotation: M::rotation(&assembly.angular_rad),
            translation_mm: assembly.linear_mm,
        };
        // The assembly error acts between an axis and the axis that carries it.
        pose = match (joint.side, joint.errors_on_tool_side()) {
            (Side::Tool, true) => pose * assembly * motion * error,
            (Side::Tool, false) => pose * assembly * error * motion,
            (Side::Workpiece, true) => pose * motion * error * assembly,
            (Side::Workpiece, false) => pose * error * motion * assembly,
        };
    }
    pose
}

/// Pose of an error motion stated at the point c: E(q) = Trans(c)·[Rot(ε), δ]·Trans(−c).
fn error_pose<M: SmallMotion>(error: &ErrorMotion, point_mm: &Vector3<f64>) -> Pose {
    let mut pose = Pose::about_point(M::rotation(&error.angular_rad), *point_mm);
    pose.translation_mm += error.linear_mm;
    pose
}

/// Motion M(q) of the joint along or about its actual axis, at coordinate `q`, mm or rad.
fn actual_motion<M: SmallMotion>(joint: &Joint, q: f64, location: &ErrorMotion) -> Pose {
    let direction = M::tilted(&joint.direction, &location.angular_rad, joint.kind);
    match joint.kind {
        AxisKind::Linear => Pose::from_translation(direction * q),
        AxisKind::Rotary => Pose::about_point(
            rotation_about_axis(&direction, q),
            joint.point_mm + location.linear_mm,
        ),
    }
}

/// Computes the sum of the error twists. Each ideal joint, from the tool to the workpiece, transforms the functional
/// point and the accumulated motion. The result equals that of the adjoint of the chain before each axis, but linear
/// joints need no matrix.
fn twist_sum<S: ErrorSource>(chain: &Chain, source: &S, state: &State) -> VolumetricError {
    let mut walk = Walk {
        point: chain.tool_tip_mm(),
        linear_mm: Vector3::zeros(),
        angular_rad: Vector3::zeros(),
    };
    // All sines and cosines are computed first: a call in the loop below would move every vector from registers to
    // memory.
    let mut sines = [(0.0, 1.0); MAX_AXES];
    for ((place, joint), &q) in sines.iter_mut().zip(chain.joints()).zip(&state.q) {
        if joint.kind == AxisKind::Rotary {
            *place = sin_cos(q);
        }
    }
    for (index, joint) in chain.joints().iter().enumerate().rev() {
        let q = state.q[index];
        let error = source.error_motion(index, state);
        let location = source.location(index);
        let assembly = source.assembly(index);
        let on_tool_side = joint.errors_on_tool_side();
        if joint.side == Side::Workpiece {
            walk.add(&assembly, &Vector3::zeros());
        }
        if on_tool_side {
            walk.add(&error, &joint.point_mm);
        }
        match joint.kind {
            AxisKind::Linear => walk.slide(&joint.direction, &location.angular_rad, q),
            AxisKind::Rotary => walk.turn(joint, &location, sines[index]),
        }
        if !on_tool_side {
            walk.add(&error, &joint.point_mm);
        }
        if joint.side == Side::Tool {
            walk.add(&assembly, &Vector3::zeros());
        }
    }
    VolumetricError { position_mm: walk.linear_mm, rotation_rad: walk.angular_rad }
}

/// The functional point during its transformation from the tool to the workpiece, with its accumulated first-order
/// displacement (mm) and rotation (rad).
///
/// The methods are always inlined. A call would store a vector with one register width and load it with another, which
/// doubled the computation time.
struct Walk {
    point: Vector3<f64>,
    linear_mm: Vector3<f64>,
    angular_rad: Vector3<f64>,
}

#[expect(clippy::inline_always, reason = "measured: see `Walk`")]
impl Walk {
    /// Adds a motion that is stated at the point `about_mm`.
    #[inline(always)]
    fn add(&mut self, motion: &ErrorMotion, about_mm: &Vector3<f64>) {
        let lever = self.point - about_mm;
        self.linear_mm += motion.linear_mm + motion.angular_rad.cross(&lever);
        self.angular_rad += motion.angular_rad;
    }

    #[inline(always)]
    fn slide(&mut self, direction: &Vector3<f64>, tilt_rad: &Vector3<f64>, q_mm: f64) {
        self.point += direction * q_mm;
        self.linear_mm += tilt_rad.cross(direction) * q_mm;
    }

    /// Passes a rotary joint whose line is displaced by `location`. The line does not rotate with the joint, but the
    /// carried body does: the contribution is (I − Ad) of the location twist.
    #[inline(always)]
    fn turn(&mut self, joint: &Joint, location: &ErrorMotion, (sin, cos): (f64, f64)) {
        let turn = rotation_from_sin_cos(&joint.direction, sin, cos);
        let shift = |lever: &Vector3<f64>| location.linear_mm + location.angular_rad.cross(lever);
        let lever = self.point - joint.point_mm;
        let turned = turn * lever;
        self.linear_mm = turn * (self.linear_mm - shift(&lever)) + shift(&turned);
        self.angular_rad = turn * (self.angular_rad - location.angular_rad) + location.angular_rad;
        self.point = turned + joint.point_mm;
    }
}

/// Constant errors, one set for each axis in the order of the chain: for tables of numbers, tests, and controllers that
/// evaluate their curves elsewhere. Axes without values have no error.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GivenErrors {
    /// The error motions `E?N` of each axis, in the order of the chain.
    pub motion: PerAxis<ErrorMotion>,
    /// The location errors `E?0N` of each axis, in the order of the chain.
    pub location: PerAxis<ErrorMotion>,
    /// The assembly errors of each axis, in the order of the chain.
    pub assembly: PerAxis<ErrorMotion>,
}

impl GivenErrors {
    /// Sets one error motion `E?N` or location error `E?0N` of an axis of `chain`, in µm for the components EX, EY and
    /// EZ, in µrad for EA, EB and EC. An error leaves all values unchanged.
    ///
    /// # Errors
    /// [`ChainError::NoSuchAxis`] for an axis that the chain does not contain, [`ChainError::NotFinite`] for a value
    /// that is not finite, [`ChainError::NoEffect`] for a location error that has no effect.
    pub fn set(
        &mut self,
        chain: &Chain,
        name: ErrorName,
        um_or_urad: f64,
    ) -> Result<(), ChainError> {
        let place = chain.structure().index_of(name.axis);
        let (index, joint) =
            place.and_then(|index| Some((index, chain.joints().get(index)?))).ok_or_else(|| {
                ChainError::NoSuchAxis { axis: name.axis, structure: chain.structure().clone() }
            })?;
        if !um_or_urad.is_finite() {
            return Err(ChainError::NotFinite { error: name, found: um_or_urad });
        }
        let no_effect = joint.no_effect(name.component);
        if let Some(reason) = no_effect.filter(|_| name.location) {
            return Err(ChainError::NoEffect { error: name, reason });
        }
        let motions = if name.location { &mut self.location } else { &mut self.motion };
        let motion = &mut motions[index];
        let inside = Displacement::from_micro(name.component.kind(), um_or_urad).mm_or_rad();
        let place = name.component.mcs_index();
        if name.component.is_angular() {
            motion.angular_rad[place] = inside;
        } else {
            motion.linear_mm[place] = inside;
        }
        Ok(())
    }
}

impl ErrorSource for GivenErrors {
    #[inline]
    fn error_motion(&self, axis: usize, _state: &State) -> ErrorMotion {
        self.motion.get(axis).copied().unwrap_or_default()
    }
    #[inline]
    fn location(&self, axis: usize) -> ErrorMotion {
        self.location.get(axis).copied().unwrap_or_default()
    }
    #[inline]
    fn assembly(&self, axis: usize) -> ErrorMotion {
        self.assembly.get(axis).copied().unwrap_or_default()
    }
}
