//! Why a configuration makes no correction, and why a correction does not start.

use volcomp_guard::{LimitsError, Quantity};
use volcomp_port::UnfitAxes;
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

/// Why controllers, machine and settings do not fit together. Found before any device is opened.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// A controller has an axis that the machine lacks.
    #[error("{device}: axis {axis}: the machine {machine} has the axes {}", letters(.axes))]
    NoSuchAxis {
        /// The device as the driver names it.
        device: String,
        /// The axis of the controller.
        axis: AxisName,
        /// The name of the machine.
        machine: String,
        /// The axes of the machine.
        axes: Vec<AxisName>,
    },
    /// The position of an axis is stated that the machine lacks.
    #[error("{device}: fixed: axis {axis}: the machine {machine} has the axes {}", letters(.axes))]
    NoSuchFixedAxis {
        /// The device as the driver names it.
        device: String,
        /// The axis whose position is stated.
        axis: AxisName,
        /// The name of the machine.
        machine: String,
        /// The axes of the machine.
        axes: Vec<AxisName>,
    },
    /// The axes of the controller make no sense.
    #[error("{device}: {source}")]
    Axes {
        /// The device as the driver names it.
        device: String,
        /// Which axis, and what is wrong with it.
        source: UnfitAxes,
    },
    /// The stated position of an axis is no finite coordinate of its kind.
    #[error("{device}: fixed: axis {axis}: expected a finite {} coordinate", axis.kind())]
    FixedPosition {
        /// The device as the driver names it.
        device: String,
        /// The axis whose position is stated.
        axis: AxisName,
    },
    /// The position of an axis is stated although the controller shows where it is.
    #[error(
        "{device}: fixed: axis {axis} is one of the controller's axes, which shows where it stands"
    )]
    FixedIsShown {
        /// The device as the driver names it.
        device: String,
        /// The axis whose position is stated.
        axis: AxisName,
    },
    /// None of the axes that the controller writes may move.
    #[error("{device}: axes {}: the machine {machine} lets none of them correct (key `correct` of the machine file)", letters(.axes))]
    NothingToCorrect {
        /// The device as the driver names it.
        device: String,
        /// The axes of the controller.
        axes: Vec<AxisName>,
        /// The name of the machine.
        machine: String,
    },
    /// Nothing on the control's side notices when the program stops.
    #[error(
        "{device}: nothing at the control ramps the correction out when the gateway stops: name a heartbeat that the control watches, or state unwatched = true"
    )]
    Unwatched {
        /// The device as the driver names it.
        device: String,
    },
    /// The device cannot keep up with the cycle.
    #[error(
        "{device}: cycle_ms: found {found_ms} ms, expected at least {shortest_ms} ms, the shortest cycle of this device"
    )]
    CycleTooShort {
        /// The device as the driver names it.
        device: String,
        /// The configured time of a cycle, ms.
        found_ms: f64,
        /// The shortest time of a cycle of the device, ms.
        shortest_ms: f64,
    },
    /// A rotary axis is to be corrected, and nothing is allowed to rotary axes.
    #[error("{device}: axis {axis} is rotary: [guard] limit_urad and slew_urad_per_s are missing")]
    NoRotaryLimits {
        /// The device as the driver names it.
        device: String,
        /// The axis without limits.
        axis: AxisName,
    },
    /// A limit is not allowed.
    #[error("{}", limits_text(.device, *.axis, .source))]
    Limits {
        /// The device as the driver names it.
        device: String,
        /// The axis, where the limit is that of an axis.
        axis: Option<AxisName>,
        /// Which limit, and what is wrong with it.
        source: LimitsError,
    },
    /// More temperatures than a cycle can carry.
    #[error(
        "found {found} temperatures, expected {} at the most",
        crate::MAX_SENSORS
    )]
    TooManySensors {
        /// How many were found.
        found: usize,
    },
    /// No controller, or more than a cycle can have.
    #[error(
        "found {found} controllers, expected 1 to {}",
        volcomp_guard::MAX_PATHS
    )]
    Paths {
        /// How many were found.
        found: usize,
    },
}

/// Why the control thread does not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// The operating system gives no thread.
    #[error("control thread: {0}")]
    Thread(#[from] std::io::Error),
}

fn letters(axes: &[AxisName]) -> String {
    let letters: Vec<String> = axes.iter().map(ToString::to_string).collect();
    letters.join(" ")
}

/// In the units and by the keys of the configuration.
fn limits_text(device: &str, axis: Option<AxisName>, error: &LimitsError) -> String {
    let kind = axis.map_or(AxisKind::Linear, AxisName::kind);
    let unit = match kind {
        AxisKind::Linear => "um",
        AxisKind::Rotary => "urad",
    };
    let displacement = || Displacement::new(kind, error.found);
    let ms = || format!("{} ms", error.found * 1e3);
    let (key, found) = match error.what {
        Quantity::Resolution => (format!("resolution_{unit}"), displacement().to_string()),
        Quantity::Limit => (format!("limit_{unit}"), displacement().to_string()),
        Quantity::Warn => (format!("warn_{unit}"), displacement().to_string()),
        Quantity::Slew => (
            format!("slew_{unit}_per_s"),
            format!("{}/s", displacement()),
        ),
        Quantity::Accel => (
            format!("accel_{unit}_per_s2"),
            format!("{}/s²", displacement()),
        ),
        Quantity::TestShift => (format!("test_shift_{unit}"), displacement().to_string()),
        Quantity::Axes => ("axes".to_owned(), error.found.to_string()),
        Quantity::Period => ("cycle_ms".to_owned(), ms()),
        Quantity::Hold => ("hold_ms".to_owned(), ms()),
        Quantity::ZeroAfter => ("zero_after_ms".to_owned(), ms()),
        Quantity::ReadBack => ("read-back, cycles".to_owned(), error.found.to_string()),
    };
    let of = axis.map_or(String::new(), |axis| format!(" of axis {axis}"));
    format!(
        "{device}: [guard] {key}{of}: found {found}, expected {}",
        error.expected
    )
}
