//! Inputs and outputs of a cycle: plain data of fixed size, copied without a lock.

use std::time::Duration;

use volcomp_guard::{
    AxisProof, BarrierMisfit, MAX_PATHS, MAX_SENSORS, Reasons, Request, Scheme, SensorReport, State,
};
use volcomp_vocabulary::PerAxis;

/// Inputs of a cycle. The default requests nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CycleInput {
    /// A request to the guard, such as arming.
    pub request: Option<Request>,
    /// Reasons why arming is forbidden; empty if it is allowed.
    pub forbids: Reasons,
    /// Additional reasons to report, which do not forbid arming.
    pub notes: Reasons,
}

/// Error of the tool at one position, in workpiece axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToolError {
    /// Actual minus ideal position of the tool tip, mm.
    pub position_mm: [f64; 3],
    /// Rotation of the actual relative to the ideal tool, rad about the workpiece axes.
    pub rotation_rad: [f64; 3],
    /// Actual minus ideal direction of the tool axis: the difference of two unit vectors, rad.
    pub axis_rad: [f64; 3],
}

/// State of one path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathReport {
    /// Time since the last answer of the controller; `None`: it never answered.
    pub answered: Option<Duration>,
    /// Age of the positions; `None`: the controller has not reported any.
    pub positions: Option<Duration>,
    /// Time since the applied correction was last confirmed; `None`: never.
    pub confirmed: Option<Duration>,
    /// Method by which the correction is confirmed.
    pub scheme: Scheme,
    /// Whether the controller is known to apply a correction other than zero.
    pub holds: bool,
    /// First value in the barrier of the control that does not fit the limits, axes in the order of the path; `None` if all fit.
    pub barrier_misfit: Option<BarrierMisfit>,
    /// Reasons from the read-back and the interlocks of this path.
    pub reasons: Reasons,
}

/// The report of one cycle. Values by axis are in machine order: mm for linear axes, rad for rotary ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Number of the cycle, from 1.
    pub cycle: u64,
    /// Start of the cycle, on the clock of the cycle.
    pub now: Duration,
    /// State of the guard after this cycle.
    pub state: State,
    /// Reasons for the state, and further reasons to report.
    pub reasons: Reasons,
    /// Index of the active path.
    pub active: usize,
    /// Positions without correction, mm and rad.
    pub positions: PerAxis<f64>,
    /// Bit mask of the axes with a known position: bit 0 is the first axis of the machine.
    pub known: u16,
    /// Bit mask of the axes whose position is rejected as too far outside the travel: bit 0 is the first axis of the machine.
    pub outside_travel: u16,
    /// Bit mask of the axes whose position is rejected as unreachable since the previous one: bit 0 is the first axis of the machine.
    pub jumped: u16,
    /// Bit mask of the axes whose position has jumped and was not accepted since, also while it is unknown or outside the travel: bit 0 is
    /// the first axis of the machine. Set only while armed.
    pub not_believed: u16,
    /// Correction by the model, mm and rad; valid only while `error` is set.
    pub wanted: PerAxis<f64>,
    /// Correction that the control was last confirmed to apply, mm and rad. Zero for axes that are not in `written`.
    pub correction: PerAxis<f64>,
    /// Bit mask of the axes written by the active path: bit 0 is the first axis of the machine.
    pub written: u16,
    /// Whether `correction` was confirmed within the maximum age of positions.
    pub correction_known: bool,
    /// Correction last sent without an error, mm and rad; `None`: none since the start.
    pub sent: Option<PerAxis<f64>>,
    /// Result of the last test shift for each axis that the active path corrects; `None` for other axes.
    pub proven: PerAxis<Option<AxisProof>>,
    /// States of the paths in order of preference, then of the read-only controllers; further entries are unused.
    pub paths: [PathReport; MAX_PATHS],
    /// Error without correction, by the model; `None` while a position is unknown.
    pub error: Option<ToolError>,
    /// Residual error with `correction`, by the model; `None` while a position is unknown.
    pub residual: Option<ToolError>,
    /// Number of cycles so far in which slew or acceleration limited the output.
    pub held_back: u64,
    /// Number of failed exchanges so far, on all paths.
    pub faults: u64,
    /// Number of missed periods so far.
    pub overruns: u64,
    /// Temperatures in the order of the thermometers and their sensors.
    pub sensors: [SensorReport; MAX_SENSORS],
}

impl Default for Report {
    fn default() -> Self {
        Self {
            cycle: 0,
            now: Duration::ZERO,
            state: State::Disarmed,
            reasons: Reasons::NONE,
            active: 0,
            positions: PerAxis::ZERO,
            known: 0,
            outside_travel: 0,
            jumped: 0,
            not_believed: 0,
            wanted: PerAxis::ZERO,
            correction: PerAxis::ZERO,
            written: 0,
            correction_known: false,
            sent: None,
            proven: PerAxis::default(),
            paths: [PathReport::default(); MAX_PATHS],
            error: None,
            residual: None,
            held_back: 0,
            faults: 0,
            overruns: 0,
            sensors: [SensorReport::default(); MAX_SENSORS],
        }
    }
}

/// A change of the guard's state or of the active path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// Number of the cycle with the change.
    pub cycle: u64,
    /// State of the guard from that cycle on.
    pub state: State,
    /// Reasons for the state.
    pub reasons: Reasons,
    /// Index of the active path from that cycle on.
    pub active: usize,
}

/// Durations of one cycle, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// Wake-up latency: from the deadline to the start of the cycle.
    pub wake_ns: u64,
    /// Duration of the whole cycle, including exchanges.
    pub whole_ns: u64,
    /// Duration of the exchanges with controllers.
    pub exchange_ns: u64,
    /// Compute time by the CPU clock of the thread, without exchanges.
    pub own_ns: u64,
    /// Duration of the reference computation on the same clock; 0 if it is off.
    pub reference_ns: u64,
    /// Number of periods missed after this cycle.
    pub missed: u32,
}
