use std::path::PathBuf;

use volcomp_vocabulary::AxisName;

use super::{BRIDGE, MAX_JOINTS};

/// A wrong or missing setting in an INI file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// `[HAL]HALFILE` does not load the bridge.
    #[error(
        "[HAL]HALFILE: {BRIDGE} is missing, expected it after the file that loads the motion controller"
    )]
    NoHalFile,
    /// A key of the bridge's section is missing.
    #[error("[VOLCOMP]{key} is missing, expected {expected}")]
    Missing {
        /// Key in the section `[VOLCOMP]`.
        key: &'static str,
        /// Expected value, in words.
        expected: &'static str,
    },
    /// A setting of the bridge differs from the gateway's configuration.
    #[error("[VOLCOMP]{key}: found {found}, expected {expected} as in the gateway's configuration")]
    Other {
        /// Key in the section `[VOLCOMP]`.
        key: &'static str,
        found: String,
        expected: String,
    },
    /// The bridge does not report the position of an axis that the gateway reads.
    #[error(
        "[VOLCOMP]READS: found {}, expected {axis} among them, which the gateway's configuration reads",
        if found.is_empty() { "none" } else { found }
    )]
    NotRead {
        axis: AxisName,
        /// Value of `READS` in the INI file; empty if the key is missing.
        found: String,
    },
    /// A setting of the bridge is not a number. LinuxCNC treats a comment after a value as part of the value.
    #[error("[VOLCOMP]{key}: found {found}, expected {expected} without further text")]
    Number {
        /// Key in the section `[VOLCOMP]`.
        key: &'static str,
        found: String,
        /// Expected value, in words.
        expected: &'static str,
    },
    /// A setting of the bridge is below the gateway's minimum, or less than one count or one scan.
    #[error("[VOLCOMP]{key}: found {found}, expected {expected} or more: {why}")]
    TooSmall {
        /// Key in the section `[VOLCOMP]`.
        key: &'static str,
        /// Value in the INI file, or the default of the key.
        found: f64,
        /// Minimum, in the unit of the key.
        expected: f64,
        /// Reason for the minimum.
        why: &'static str,
    },
    /// A setting of the bridge exceeds the gateway's maximum, or the range of a word.
    #[error("[VOLCOMP]{key}: found {found}, expected {expected} or less: {why}")]
    TooLarge {
        /// Key in the section `[VOLCOMP]`.
        key: &'static str,
        /// Value in the INI file, or the default of the key.
        found: f64,
        /// Maximum, in the unit of the key.
        expected: f64,
        /// Reason for the maximum.
        why: &'static str,
    },
    /// A HAL file is listed after the bridge's HAL file.
    #[error(
        "[HAL]HALFILE: found {found} after {BRIDGE}, expected {BRIDGE} as the last one: pins that it has connected, such as motion.probe-input, take no signal of a later file"
    )]
    Behind { found: String },
    /// A HAL file of the display cannot be read.
    #[error("[HAL]POSTGUI_HALFILE: {file}: {reason}; expected a readable file")]
    PostGui {
        /// Name of the file in the INI file.
        file: String,
        /// Reason why the file cannot be read.
        reason: String,
    },
    /// A HAL file of the display connects a pin that the bridge has already connected.
    #[error(
        "[HAL]POSTGUI_HALFILE: {file}, line {line}: found {pin} connected to {found}, expected {expected}: the pin already has this signal, and accepts no other"
    )]
    Connected {
        /// Name of the file in the INI file.
        file: String,
        /// Line number in the HAL file, from 1.
        line: usize,
        pin: String,
        /// Signal to which the HAL file of the display connects the pin.
        found: String,
        /// Signal to which the pin is already connected.
        expected: String,
    },
    /// The bridge's section contains an unknown key.
    #[error("[VOLCOMP]{key}: unknown key, expected one of {known}")]
    Unknown { key: String, known: String },
    /// The bridge has another key than the gateway.
    #[error("[VOLCOMP]KEY_FILE: {}: found another key than the gateway's", .file.display())]
    OtherKey { file: PathBuf },
    /// The key of the bridge is missing or malformed.
    #[error("[VOLCOMP]KEY_FILE: {reason}; expected a copy of the gateway's key")]
    Key {
        /// Name of the file, and the error.
        reason: String,
    },
    /// An included file cannot be read.
    #[error("#INCLUDE {file}: {reason}; expected a readable file")]
    Include {
        /// Name of the file in the `#INCLUDE` line.
        file: String,
        /// Reason why the file cannot be read.
        reason: String,
    },
    /// The planner cannot move the offset of an axis at the rate of the bridge.
    #[error(
        "[AXIS_{axis}]OFFSET_AV_RATIO: found {found}, expected {expected} or more: of MAX_VELOCITY = {velocity} that is the rate of the bridge, [VOLCOMP]{key}, which the offset has to follow"
    )]
    Slow {
        /// Axis whose `OFFSET_AV_RATIO` is too small.
        axis: AxisName,
        /// `OFFSET_AV_RATIO` in the INI file.
        found: f64,
        /// Minimum `OFFSET_AV_RATIO`, a fraction of `velocity`.
        expected: f64,
        /// Velocity of the axis, mm/s or deg/s.
        velocity: f64,
        /// Key in `[VOLCOMP]` that sets the rate of the bridge.
        key: &'static str,
    },
    /// An axis reserves no fraction of its velocity for its offset.
    #[error(
        "[AXIS_{axis}]OFFSET_AV_RATIO is missing, expected a number such as 0.02: by default LinuxCNC applies no offset"
    )]
    NoRatio { axis: AxisName },
    /// The fraction of its velocity that an axis reserves for its offset is out of range.
    #[error(
        "[AXIS_{axis}]OFFSET_AV_RATIO: found {found}, expected more than 0 and at most 0.2: it is taken from the velocity of programs"
    )]
    Ratio {
        axis: AxisName,
        /// `OFFSET_AV_RATIO` in the INI file.
        found: String,
    },
    /// LinuxCNC has a compensation table for a joint, which would act in addition to the gateway's correction.
    #[error(
        "[JOINT_{joint}]COMP_FILE: found {found}, expected none: its correction and that of the gateway would add up"
    )]
    CompFile {
        /// Number of the joint, as in `[JOINT_0]`.
        joint: String,
        /// Name of the table file in the INI file.
        found: String,
    },
    /// LinuxCNC compensates the backlash of a joint, which would act in addition to the gateway's correction.
    #[error(
        "[JOINT_{joint}]BACKLASH: found {found}, expected none or 0: the model of the machine has the reversal errors, and both would add up"
    )]
    Backlash {
        /// Number of the joint, as in `[JOINT_0]`.
        joint: String,
        found: String,
    },
    /// A soft limit of a joint lies beyond that of its axis. After a jog beyond the axis limit in joint mode, LinuxCNC
    /// would move the axis back within one cycle.
    #[error(
        "[JOINT_{joint}]{key}: found {found}, expected at {} {limit}, [AXIS_{axis}]{key}: where a joint stands beyond it, LinuxCNC takes an axis with an offset back in one cycle",
        if *key == "MIN_LIMIT" { "least" } else { "most" }
    )]
    JointLimit {
        /// Number of the joint, as in `[JOINT_0]`.
        joint: usize,
        /// `MIN_LIMIT` or `MAX_LIMIT`.
        key: &'static str,
        /// The limit of the joint in the INI file, or `none`.
        found: String,
        /// The axis that the joint moves.
        axis: AxisName,
        /// The limit of the axis in the INI file, mm or deg.
        limit: String,
    },
    /// A unit is missing, so LinuxCNC would use its default.
    #[error("[TRAJ]{key} is missing, expected {expected}: the bridge counts in this unit")]
    NoUnits {
        /// Key in the section `[TRAJ]`.
        key: &'static str,
        /// Accepted words for the unit.
        expected: &'static str,
    },
    /// Lengths are not mm, or angles not degrees.
    #[error(
        "[TRAJ]{key}: found {found}, expected {expected}: the bridge counts in this unit, and no other is supported. Do not change this key alone: all lengths or angles of the INI file are in it"
    )]
    Units {
        /// Key in the section `[TRAJ]`.
        key: &'static str,
        found: String,
        /// Accepted words for the unit.
        expected: &'static str,
    },
    /// The number of joints is invalid.
    #[error(
        "[KINS]JOINTS: found {found}, expected the number of joints, 1 to {MAX_JOINTS} without further text"
    )]
    Joints { found: String },
    /// The number of joints is missing.
    #[error("[KINS]JOINTS is missing, expected the number of joints, 1 to {MAX_JOINTS}")]
    NoJoints,
    /// The kinematics module is not `trivkins`.
    #[error(
        "[KINS]KINEMATICS: found {found}, expected trivkins: with other kinematics LinuxCNC adds offsets to coordinates of the workpiece, not of the machine"
    )]
    Kinematics { found: String },
    /// The period of the servo thread differs from the gateway's configuration.
    #[error(
        "[EMCMOT]SERVO_PERIOD: found {found} ns, expected {expected} ns, barrier.scan_ms of the gateway's configuration"
    )]
    Period {
        /// Period in the INI file, ns.
        found: String,
        /// Period in the gateway's configuration, ns.
        expected: f64,
    },
}
