//! The plain data of temperatures: what was heard, what is believed, and the limits between them.

use core::time::Duration;

/// The largest number of temperatures of one machine.
pub const MAX_SENSORS: usize = 64;

/// The limits within which the temperatures of a machine are believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorLimits {
    /// The lowest and the highest temperature that may occur on this machine, °C.
    pub range_degc: [f64; 2],
    /// The fastest change of a temperature that is believed, K/min. Half a kelvin at once is the step or the noise of
    /// a module, and no change.
    pub max_degc_per_min: f64,
    /// The age beyond which a temperature is stale and not used.
    pub stale: Duration,
    /// A sensor that told the same digits for this long is told to be stuck, but used; `None`: never.
    pub stuck_after: Option<Duration>,
    /// A sensor farther than this from the median of the others, K, is told to disagree, but used; `None`: not
    /// compared.
    pub neighbours_k: Option<f64>,
}

impl Default for SensorLimits {
    /// −20 to 120 °C, 5 K/min, 30 s, six hours of the same digits, not compared with the other sensors.
    fn default() -> Self {
        Self {
            range_degc: [-20.0, 120.0],
            max_degc_per_min: 5.0,
            stale: Duration::from_secs(30),
            stuck_after: Some(Duration::from_secs(6 * 3600)),
            neighbours_k: None,
        }
    }
}

/// The answer of a device about one of its sensors, as its driver heard it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Heard {
    /// The device does not answer, or has not answered yet.
    #[default]
    Silence,
    /// The device answers, and reports that this sensor is faulty: broken wire, short circuit, over-range.
    Fault,
    /// The device answers with a temperature and reports no fault.
    Temperature {
        /// The temperature as the device tells it, °C.
        degc: f64,
        /// When it was measured, on the clock that the judgement is given.
        taken: Duration,
    },
}

/// Why a temperature is not believed, or is believed with a reservation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SensorFlaw {
    /// The device reports a fault of the sensor, or does not answer: the temperature is not used.
    #[error("broken or silent")]
    Broken,
    /// The temperature is older than [`SensorLimits::stale`]: it is not used.
    #[error("stale")]
    Stale,
    /// The temperature is no number or outside [`SensorLimits::range_degc`]: it is not used.
    #[error("out of range")]
    OutOfRange,
    /// The temperature changed faster than [`SensorLimits::max_degc_per_min`], and has not been re-admitted since: it
    /// is not used.
    #[error("jumped")]
    Jumped,
    /// The same digits for [`SensorLimits::stuck_after`]: the temperature is used.
    #[error("stuck at one value")]
    Stuck,
    /// Farther than [`SensorLimits::neighbours_k`] from the median of the other sensors: the temperature is used.
    #[error("disagrees with its neighbours")]
    Disagrees,
}

impl SensorFlaw {
    /// Whether a temperature with this flaw is used all the same.
    pub fn is_used(self) -> bool {
        matches!(self, Self::Stuck | Self::Disagrees)
    }
}

/// One temperature as it is judged.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorReport {
    /// The temperature, °C; `None` when it is not used.
    pub degc: Option<f64>,
    /// The flaw that was found in it; `None` for a good temperature, and before the first judgement.
    pub flaw: Option<SensorFlaw>,
}
