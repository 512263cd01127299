#![doc = include_str!("../README.md")]

mod clock;
mod cycle;
mod error;
mod model;
mod path;
mod plan;
mod realtime;
mod report;
mod sensors;
mod settings;
mod standby;

pub use clock::{monotonic, thread_time, tick};
pub use cycle::{Cycle, CycleDurations};
pub use error::{OrderRefusal, PlanError, StartError};
pub use model::{
    CoupledCorrection, LargestMove, Model, ModelCorrection, Replacement, rotary_step_error,
};
pub use path::{ControlPath, PositionReader, ReaderPlan, next_owner};
pub use plan::{PathPlan, SHIFT_STEPS, UncorrectedAxis, UncorrectedReason};
pub use realtime::{
    DisarmSwitch, Handle, ManualCycles, Order, Pulse, reference_work, schedule, start, start_manual,
};
pub use report::{Change, CycleInput, PathReport, Report, Timing, ToolError};
pub use sensors::Sensors;
pub use settings::{
    AxisSettings, BarrierSettings, GuardSettings, PathSettings, Rapid, Realtime, WithoutBarrier,
};
/// The guard: requests, states and reasons.
pub use volcomp_guard as guard;
/// Temperature reports.
pub use volcomp_guard::{MAX_SENSORS, SensorFlaw, SensorReport};
/// Chains, states and corrections.
pub use volcomp_kinematics as kinematics;
/// The machine file, from which [`Model`] is compiled.
pub use volcomp_model as machine;
/// The device interfaces, implemented by drivers or by the caller.
pub use volcomp_port as port;
/// Axis letters and units used in settings.
pub use volcomp_vocabulary as vocabulary;
