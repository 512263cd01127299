#![doc = include_str!("../README.md")]

mod attendant;
mod clock;
mod cycle;
mod error;
mod model;
mod path;
mod place;
mod plan;
mod reader;
mod realtime;
mod replacement;
mod report;
mod sensors;
mod settings;

pub use clock::{monotonic, thread_time, tick};
pub use cycle::{Cycle, Spent};
pub use error::{OrderRefusal, PlanError, StartError};
pub use model::{LargestMove, Model, ModelCorrection, ModelWanted, rotary_step_error};
pub use path::{ControlPath, next_owner};
pub use plan::{LeftOut, PathPlan, SHIFT_STEPS, WhyLeftOut};
pub use reader::{PositionReader, ReaderPlan};
pub use realtime::{
    ByHand, DisarmSwitch, Handle, Order, Pulse, reference_work, schedule, start, start_by_hand,
};
pub use replacement::Replacement;
pub use report::{Asked, Change, PathReport, Report, Timing, ToolError};
pub use sensors::Sensors;
pub use settings::{
    AxisSettings, BarrierSettings, GuardSettings, PathSettings, Rapid, Realtime, WithoutBarrier,
};

/// Temperature reports.
pub use volcomp_guard::{MAX_SENSORS, SensorFlaw, SensorReport};

/// The guard: requests, states and reasons.
pub use volcomp_guard as guard;
/// Chains, states and corrections.
pub use volcomp_kinematics as kinematics;
/// The machine file, from which [`Model`] is made.
pub use volcomp_model as machine;
/// The device interfaces, implemented by drivers or by the caller.
pub use volcomp_port as port;
/// Axis letters and units used in settings.
pub use volcomp_vocabulary as vocabulary;
