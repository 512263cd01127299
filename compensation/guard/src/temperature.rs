//! Whether a temperature may be used.

use core::time::Duration;

/// A digit of a slow module, or noise: no jump.
const JUMP_DEGC: f64 = 0.5;

/// The limits within which the temperatures of a sensor are believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorLimits {
    /// The lowest and the highest temperature, degC.
    pub range_degc: [f64; 2],
    /// The fastest change; half a degree at once is no change.
    pub max_degc_per_min: f64,
    /// The age beyond which a temperature is stale.
    pub stale: Duration,
}

impl Default for SensorLimits {
    /// -20 to 120 degC, 5 K in a minute, 30 s.
    fn default() -> Self {
        Self {
            range_degc: [-20.0, 120.0],
            max_degc_per_min: 5.0,
            stale: Duration::from_secs(30),
        }
    }
}

/// Why a temperature is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Rejected {
    /// The device says that it is broken, or says nothing.
    #[error("broken or silent")]
    Broken,
    /// The temperature is older than the limit of the sensor.
    #[error("stale")]
    Stale,
    /// No number, or outside the range.
    #[error("out of range")]
    OutOfRange,
    /// The temperature changes faster than the limit of the sensor.
    #[error("jumping")]
    Jumping,
}

/// Checks one sensor: state is the last temperature that was good.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorCheck {
    last: Option<(Duration, f64)>,
}

impl SensorCheck {
    /// A temperature and when it was taken, on the clock of `now`.
    ///
    /// # Errors
    /// Why it is left out.
    pub fn check(
        &mut self,
        now: Duration,
        degc: Option<f64>,
        taken: Option<Duration>,
        limits: &SensorLimits,
    ) -> Result<f64, Rejected> {
        let (Some(degc), Some(taken)) = (degc, taken) else {
            return Err(Rejected::Broken);
        };
        if now.saturating_sub(taken) > limits.stale {
            return Err(Rejected::Stale);
        }
        let [low, high] = limits.range_degc;
        if !(low..=high).contains(&degc) {
            return Err(Rejected::OutOfRange);
        }
        if let Some((before, last)) = self.last {
            let minutes = taken.saturating_sub(before).as_secs_f64() / 60.0;
            if (degc - last).abs() > JUMP_DEGC + limits.max_degc_per_min * minutes {
                return Err(Rejected::Jumping);
            }
            if taken == before {
                return Ok(degc);
            }
        }
        self.last = Some((taken, degc));
        Ok(degc)
    }
}
