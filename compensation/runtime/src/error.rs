//! Errors of settings, and of starting a correction. Messages name the keys of the gateway's configuration.

use std::time::Duration;

use volcomp_guard::{LimitsError, Quantity};
use volcomp_port::UnfitAxes;
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

/// Reasons why controllers, machine and settings do not fit together. Detected before any device is opened.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    #[error("{device}: axis {axis}: the machine {machine} has the axes {}", letters(.axes))]
    NoSuchAxis { device: String, axis: AxisName, machine: String, axes: Vec<AxisName> },
    #[error("{device}: fixed: axis {axis}: the machine {machine} has the axes {}", letters(.axes))]
    NoSuchFixedAxis { device: String, axis: AxisName, machine: String, axes: Vec<AxisName> },
    /// The axes of the controller are invalid.
    #[error("{device}: {source}")]
    Axes { device: String, source: UnfitAxes },
    #[error("{device}: fixed: axis {axis}: expected a finite {} coordinate", axis.kind())]
    FixedPosition { device: String, axis: AxisName },
    #[error(
        "{device}: fixed: axis {axis}: found {} {unit}, expected a position within its travel, {} to {} {unit}",
        found.mm_or_deg(), travel[0].mm_or_deg(), travel[1].mm_or_deg(),
        unit = axis.kind().coordinate_unit()
    )]
    FixedBeyond {
        device: String,
        axis: AxisName,
        found: Displacement,
        /// Ends of the axis's travel, lower end first.
        travel: [Displacement; 2],
    },
    #[error(
        "{device}: fixed: axis {axis} turns, and its position is unknown: name it in reads = [\"{axis}\"] of a controller that shows its position, or, if no drive turns it, in not_driven = [\"{axis}\"] beside fixed"
    )]
    FixedRotary { device: String, axis: AxisName },
    #[error(
        "{device}: not_driven: axis {axis}: expected a rotary axis whose position fixed states"
    )]
    NotDriven { device: String, axis: AxisName },
    #[error(
        "{device}: fixed: axis {axis} is one of the controller's axes, which shows its position"
    )]
    FixedIsShown { device: String, axis: AxisName },
    /// None of the axes that the controller writes may correct.
    #[error("{device}: axes {}: {}", letters(.axes), match .uncorrected {
        false => format!("the machine {machine} lets none of them correct (key `correct` of the machine file)"),
        true => "none of them corrects: a rotary axis corrects only with three linear directions on the same controller, which take back what it moves the tip, and where half its step moves the tip little enough".to_owned(),
    })]
    NothingToCorrect {
        /// Whether written rotary axes could correct, but would increase the error of the tool.
        uncorrected: bool,
        device: String,
        axes: Vec<AxisName>,
        machine: String,
    },
    #[error(
        "{device}: no fail-safe in the control when the gateway stops: configure a barrier (preferred) or a heartbeat that the control watches, or accept the risk with unwatched = true"
    )]
    Unwatched { device: String },
    /// Driver and settings disagree on whether the control has a barrier.
    #[error("{device}: {}", match .has {
        true => "the control has a barrier: expected the number of the machine and the time of a scan in the setting `barrier`",
        false => "the setting `barrier` is stated: this device carries no frames to a barrier, expected none",
    })]
    Barrier {
        device: String,
        /// Whether the driver uses a barrier.
        has: bool,
    },
    #[error(
        "{device}: found the channel {found:?}, expected {expected:?} like the controllers before: corrections by several channels would add up, and only one controller writes at a time"
    )]
    Channels { device: String, found: String, expected: String },
    #[error(
        "{device}: axis {axis} is not written by {other}, which may take over: a correction of {axis} would stay for good, expected the same axes on both, or a barrier or a time-out on {device} that takes it to zero"
    )]
    LeavesAxis { device: String, axis: AxisName, other: String },
    #[error("{device}: carries thermal terms only, and the machine {machine} has none")]
    NoThermalTerms { device: String, machine: String },
    #[error(
        "{device}: cycle_ms: found {found_ms} ms, expected at least {shortest_ms} ms, the shortest cycle of this device"
    )]
    CycleTooShort { device: String, found_ms: f64, shortest_ms: f64 },
    #[error("{device}: axis {axis} is rotary: [guard] limit_urad and slew_urad_per_s are missing")]
    NoRotaryLimits { device: String, axis: AxisName },
    /// A limit of the guard is invalid.
    #[error("{}", limits_text(.device, *.axis, .source))]
    Limits { device: String, axis: Option<AxisName>, source: LimitsError },
    #[error("{device}: position step of axis {axis}: expected {}", step_of(*.axis))]
    PositionStep { device: String, axis: AxisName },
    #[error(
        "{device}: period of the cycle: found {found:?}, expected {planned:?}, for which this path was planned"
    )]
    Period { device: String, found: Duration, planned: Duration },
    #[error(
        "{device}: [guard] limit_{} of axis {axis}: found {found}, expected at most {largest}, the largest correction that this device carries", axis.kind().micro_unit()
    )]
    BeyondDevice { device: String, axis: AxisName, found: Displacement, largest: Displacement },
    #[error("found {found} temperatures, expected at most {}", crate::MAX_SENSORS)]
    TooManySensors { found: usize },
    #[error("found {found} controllers, expected 1 to {}", volcomp_guard::MAX_PATHS)]
    Paths { found: usize },
}

/// Reasons why the control thread cannot be started.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// The operating system cannot create a thread.
    #[error("control thread: {0}")]
    Thread(#[from] std::io::Error),
}

fn letters(axes: &[AxisName]) -> String {
    let letters: Vec<String> = axes.iter().map(ToString::to_string).collect();
    letters.join(" ")
}

fn step_of(axis: AxisName) -> &'static str {
    match axis.kind() {
        AxisKind::Linear => "a length of 0 or more",
        AxisKind::Rotary => "an angle of 0 or more",
    }
}

fn limits_text(device: &str, axis: Option<AxisName>, error: &LimitsError) -> String {
    let kind = axis.map_or(AxisKind::Linear, AxisName::kind);
    let unit = kind.micro_unit();
    let key = match error.what {
        Quantity::Resolution => format!("resolution_{unit}"),
        Quantity::Limit => format!("[guard] limit_{unit}"),
        Quantity::Warn => format!("[guard] warn_{unit}"),
        Quantity::Slew => format!("[guard] slew_{unit}_per_s"),
        Quantity::Accel => format!("[guard] accel_{unit}_per_s2"),
        Quantity::TestShift => format!("[guard] test_shift_{unit}"),
        Quantity::Axes => "axes".to_owned(),
        Quantity::Period => "cycle_ms".to_owned(),
        Quantity::Hold => "[guard] hold_ms".to_owned(),
        Quantity::ZeroAfter => "[guard] zero_after_ms".to_owned(),
        Quantity::ReadBack => {
            "cycles until a correction is read back, from [controller.barrier] scan_ms and cycle_ms"
                .to_owned()
        }
    };
    let of = axis.map_or(String::new(), |axis| format!(" of axis {axis}"));
    let step = match (error.what, kind) {
        (Quantity::Limit, _) if !error.expected.contains("step") => String::new(),
        (Quantity::Limit, AxisKind::Linear) => step_key("um", "1 µm"),
        (Quantity::Limit, AxisKind::Rotary) => step_key("urad", "0.001°"),
        _ => String::new(),
    };
    format!("{device}: {key}{of}: found {}, expected {}{step}", error.found(), error.expected)
}

/// Text that names the configuration key or default from which the step of an axis comes.
fn step_key(unit: &str, default: &str) -> String {
    format!(
        ", which is resolution_{unit} ({default} where it is not stated; on CAN the factor in the DBC file)"
    )
}

/// Reasons why a running cycle rejects a model or limits.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OrderRefusal {
    #[error(
        "model: found other axes, or another order of them, expected those of the model that runs"
    )]
    OtherAxes,
    /// The cycle has no path with this index.
    #[error("limits of path {}: found no such path, expected 1 to {paths}", path + 1)]
    NoSuchPath { path: usize, paths: usize },
    #[error(
        "limits of path {}: found a period of {found:?}, expected {expected:?}, that of the cycle",
        path + 1
    )]
    Period {
        /// Index of the path, from 0.
        path: usize,
        found: Duration,
        expected: Duration,
    },
    /// A limit is invalid; lengths in mm, angles in rad.
    #[error("limits of path {}: {source}", path + 1)]
    Limits {
        /// Index of the path, from 0.
        path: usize,
        source: LimitsError,
    },
}
