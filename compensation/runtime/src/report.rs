//! What goes into a cycle and comes out of it: plain data of fixed size, copied without a lock.

use std::time::Duration;

use volcomp_guard::{
    MAX_PATHS, MAX_SENSORS, Proven, Reasons, Request, Scheme, SensorReport, State,
};
use volcomp_vocabulary::PerAxis;

/// The requests that a cycle receives from outside. The default asks for nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Asked {
    /// A request to the guard, such as arming.
    pub request: Option<Request>,
    /// Why arming is forbidden; empty where it is allowed.
    pub forbids: Reasons,
    /// Further reasons to report, which forbid nothing.
    pub notes: Reasons,
}

/// The error of the tool at one position, in workpiece axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToolError {
    /// Actual minus ideal position of the tool tip, mm.
    pub position_mm: [f64; 3],
    /// Rotation of the actual against the ideal tool, rad about the workpiece axes.
    pub rotation_rad: [f64; 3],
    /// Actual minus ideal direction of the tool axis: the difference of two unit vectors, rad.
    pub axis_rad: [f64; 3],
}

/// How one path is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathReport {
    /// How long ago it answered last; `None`: never.
    pub answered: Option<Duration>,
    /// The age of its positions; `None`: it has not reported any.
    pub positions: Option<Duration>,
    /// How long ago the correction that it applies was confirmed last; `None`: never.
    pub confirmed: Option<Duration>,
    /// How its correction is confirmed.
    pub scheme: Scheme,
    /// Whether it applies a correction other than zero, as far as that is known.
    pub holds: bool,
    /// What is to be known of it.
    pub reasons: Reasons,
}

/// The report of one cycle. Values by axis are in machine order: mm for linear axes, rad for rotary ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// The number of the cycle, from 1.
    pub cycle: u64,
    /// When the cycle began, since the clock of the cycle began.
    pub now: Duration,
    /// The state of the guard.
    pub state: State,
    /// Why the state is what it is, and what else is to be known.
    pub reasons: Reasons,
    /// The place of the path that corrects.
    pub active: usize,
    /// Positions without correction, mm and rad.
    pub positions: PerAxis<f64>,
    /// Which positions are known: bit 0 is the first axis of the machine.
    pub known: u16,
    /// Which of them are too far outside the travel to be believed: bit 0 is the first axis of the machine.
    pub outside_travel: u16,
    /// Which of them are where the axis cannot have come to: bit 0 is the first axis of the machine.
    pub jumped: u16,
    /// The correction that the model asks for, mm and rad.
    pub wanted: PerAxis<f64>,
    /// The correction that the control is known to apply, mm and rad; see `correction_known`. It is reported for the axes in
    /// `written`, and zero for all others.
    pub correction: PerAxis<f64>,
    /// The axes that the path which corrects writes: bit 0 is the first axis of the machine.
    pub written: u16,
    /// Whether that was confirmed within the time for which positions may be held. Otherwise `correction` is what was
    /// confirmed last.
    pub correction_known: bool,
    /// The correction that was sent last without a failure, mm and rad; `None`: none since the start.
    pub sent: Option<PerAxis<f64>>,
    /// What the last test shift showed of each axis that the active path corrects; `None`: the axis is not corrected.
    pub proven: PerAxis<Option<Proven>>,
    /// The paths in the order of preference, then the controllers that are only read; places beyond are not used.
    pub paths: [PathReport; MAX_PATHS],
    /// The error of the model without correction; `None` while a position is not known.
    pub error: Option<ToolError>,
    /// The error that the model leaves with `correction`, axes that are not written holding none; `None` while a position is
    /// not known.
    pub residual: Option<ToolError>,
    /// Cycles so far in which slew or acceleration limits held the output back.
    pub held_back: u64,
    /// Exchanges so far that failed, of every path.
    pub faults: u64,
    /// Periods so far that were missed.
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
    /// The number of the cycle that changed it.
    pub cycle: u64,
    /// The state from that cycle on.
    pub state: State,
    /// Why the state is what it is.
    pub reasons: Reasons,
    /// The place of the path that corrects from that cycle on.
    pub active: usize,
}

/// How long one cycle took, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// From the deadline to the first instruction of the cycle.
    pub wake_ns: u64,
    /// The whole cycle, exchanges included.
    pub whole_ns: u64,
    /// The exchanges with controllers.
    pub exchange_ns: u64,
    /// The cycle's own work by the CPU clock of its thread, without exchanges.
    pub own_ns: u64,
    /// The reference computation by the same clock, where it is made; else 0.
    pub reference_ns: u64,
    /// Periods that were missed after this cycle.
    pub missed: u32,
}
