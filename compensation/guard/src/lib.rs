#![no_std]
#![doc = include_str!("../README.md")]

mod accepted_range;
pub mod barrier;
pub mod ceiling;
mod corridor;
mod direction;
mod exchange;
mod fallback;
mod guard;
mod interlock;
mod limits;
mod position;
mod proof;
pub mod protocol;
mod read_back;
mod reasons;
mod state;
mod step;
mod temperature;
mod vector;

pub use direction::{DirectionMemory, reversal_threshold};
pub use exchange::{Inputs, Output, Reading};
pub use fallback::{Choice, MAX_PATHS, PathHealth, Selector};
pub use guard::Guard;
pub use interlock::{Interlock, Interlocks};
pub use limits::{
    AxisLimits, FEWEST_RAMP_CYCLES, Limits, LimitsError, MOST_READ_BACK_CYCLES, Quantity,
};
pub use position::{PositionCheck, PositionFlaw, PositionLimits};
pub use proof::{AxisProof, MotionHistory, Proof, Verdict};
pub use read_back::{
    BarrierLink, BarrierMisfit, Confirmed, ControlTimeOut, CorrectionReport, RATE_OVER_SLEW,
    ReadBack, ReadBackStatus, Scheme, barrier_misfits, scans_fit,
};
pub use reasons::Reasons;
pub use state::{Cause, End, Hold, Phase, Request, State};
pub use step::{ROUNDING, one_step, shortest_way};
pub use temperature::{
    MAX_SENSORS, SensorCheck, SensorFlaw, SensorLimits, SensorReading, SensorReport,
    judge_temperatures,
};
pub use vector::{FollowResult, RequestedCorrection, Vector};

/// The vocabulary of the public interface: axis letters, values by axis.
pub use volcomp_vocabulary as vocabulary;
