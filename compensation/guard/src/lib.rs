#![no_std]
#![doc = include_str!("../README.md")]

pub mod barrier;
pub mod ceiling;
mod guard;
mod limits;
mod paths;
mod position;
mod proof;
pub mod protocol;
mod read_back;
mod reasons;
mod state;
mod step;
mod temperature;
mod vector;

pub use guard::Guard;
pub use limits::{
    AxisLimits, FEWEST_RAMP_CYCLES, Limits, LimitsError, MOST_READ_BACK_CYCLES, Quantity,
};
pub use paths::{Choice, Interlock, Interlocks, MAX_PATHS, PathHealth, Selector};
pub use position::{
    DirectionMemory, PositionCheck, PositionFlaw, PositionLimits, reversal_threshold,
};
pub use proof::{AxisProof, MotionHistory, Proof, Verdict};
pub use read_back::{
    BarrierLink, BarrierMisfit, Confirmed, ControlTimeOut, CorrectionReport, RATE_OVER_SLEW,
    ReadBack, ReadBackStatus, Scheme, barrier_misfits, scans_fit,
};
pub use reasons::Reasons;
pub use state::{Cause, End, Hold, Inputs, Output, Phase, Reading, Request, State};
pub use step::{ROUNDING, one_step, shortest_way};
pub use temperature::{
    MAX_SENSORS, SensorCheck, SensorFlaw, SensorLimits, SensorReading, SensorReport,
    judge_temperatures,
};
pub use vector::{FollowResult, RequestedCorrection, Vector};
/// The vocabulary of the public interface: axis letters, values by axis.
pub use volcomp_vocabulary as vocabulary;
