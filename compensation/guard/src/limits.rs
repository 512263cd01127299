//! What is allowed.

use core::time::Duration;

use volcomp_vocabulary::{MAX_AXES, PerChannel};

/// What is allowed to one axis: mm, rotary axes rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// The largest correction.
    pub limit: f64,
    /// From here on it is reported.
    pub warn: f64,
    /// The largest change of the correction in a second.
    pub slew_per_s: f64,
    /// The largest change of that in a second; infinite: not limited.
    pub accel_per_s2: f64,
    /// Smallest step of the controller.
    pub resolution: f64,
    /// Whether its reported positions contain the correction.
    pub includes_correction: bool,
}

/// What is allowed to a controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Of each axis; those from `count` on are not there.
    pub axes: [AxisLimits; MAX_AXES],
    /// How many axes.
    pub count: usize,
    /// Nominal time of a cycle.
    pub period: Duration,
    /// Positions older than this: the correction is held.
    pub hold: Duration,
    /// Positions older than this: it ramps to zero.
    pub zero_after: Duration,
    /// How long a ramp takes; at least 20 cycles.
    pub ramp: Duration,
    /// Shift that proves at arming whether positions contain it, mm and rad; 0: not proven. At least four steps
    /// of correction and position.
    pub test_shift: PerChannel<f64>,
    /// How many writes the read-back may be behind, 1 to [`MOST_READ_BACK_CYCLES`].
    pub read_back_cycles: usize,
}

/// How far behind a read-back may be at the most.
pub const MOST_READ_BACK_CYCLES: usize = 32;

/// Limits that make no sense.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{what}: found {found}, expected {expected}")]
pub struct LimitsError {
    /// Which number, and of which axis where there are several.
    pub what: &'static str,
    /// The place of the axis.
    pub axis: Option<usize>,
    /// What was found.
    pub found: f64,
    /// What was expected.
    pub expected: &'static str,
}

impl AxisLimits {
    /// Nothing moves.
    pub const NONE: Self = Self {
        limit: 0.0,
        warn: 0.0,
        slew_per_s: 0.0,
        accel_per_s2: 0.0,
        resolution: 1.0,
        includes_correction: false,
    };

    /// The largest multiple of the resolution within the limit: what the quantiser may say at the most.
    pub(crate) fn reachable(&self) -> f64 {
        // A limit of 0.15 is 150 steps of 0.001, not 149 for a rounding.
        libm::floor(self.limit / self.resolution + 1e-6) * self.resolution
    }

    fn check(&self, axis: usize, test_shift: f64) -> Result<(), LimitsError> {
        let finite = |what, found: f64, expected, good: bool| {
            if good && !found.is_nan() {
                return Ok(());
            }
            Err(LimitsError {
                what,
                axis: Some(axis),
                found,
                expected,
            })
        };
        let positive = |x: f64| x > 0.0 && x.is_finite();
        let expected = "a positive number";
        finite(
            "resolution",
            self.resolution,
            expected,
            positive(self.resolution),
        )?;
        finite(
            "limit",
            self.limit,
            "at least one step of the controller",
            self.limit.is_finite() && self.limit >= self.resolution,
        )?;
        finite(
            "warn",
            self.warn,
            "a number from 0 to the limit",
            (0.0..=self.limit).contains(&self.warn),
        )?;
        finite("slew", self.slew_per_s, expected, positive(self.slew_per_s))?;
        finite(
            "accel",
            self.accel_per_s2,
            expected,
            self.accel_per_s2 > 0.0,
        )?;
        let fits = test_shift == 0.0 || (4.0 * self.resolution..=self.limit).contains(&test_shift);
        finite(
            "test shift",
            test_shift,
            "0, or four steps of the controller up to the limit",
            fits,
        )
    }
}

impl Limits {
    /// Checks every number.
    ///
    /// # Errors
    /// Which one is wrong.
    pub fn check(&self) -> Result<(), LimitsError> {
        let wrong = |what, found: f64, expected| {
            Err(LimitsError {
                what,
                axis: None,
                found,
                expected,
            })
        };
        if !(1..=MAX_AXES).contains(&self.count) {
            return wrong("axes", self.count as f64, "1 to 9");
        }
        for (axis, limits) in self.axes.iter().take(self.count).enumerate() {
            limits.check(axis, self.test_shift[axis])?;
        }
        let period_s = self.period.as_secs_f64();
        if !(1e-5..=10.0).contains(&period_s) {
            return wrong("period, s", period_s, "10 us to 10 s");
        }
        if self.hold < self.period {
            return wrong("hold, s", self.hold.as_secs_f64(), "at least one cycle");
        }
        if self.zero_after < self.hold {
            return wrong(
                "zero after, s",
                self.zero_after.as_secs_f64(),
                "at least as long as hold",
            );
        }
        if !(1..=MOST_READ_BACK_CYCLES).contains(&self.read_back_cycles) {
            return wrong("read-back, cycles", self.read_back_cycles as f64, "1 to 32");
        }
        Ok(())
    }

    /// The share of a ramp that passes in `dt_s`.
    pub(crate) fn ramp_share(&self, dt_s: f64) -> f64 {
        let ramp_s = self
            .ramp
            .as_secs_f64()
            .max(20.0 * self.period.as_secs_f64());
        (dt_s / ramp_s).min(0.05)
    }
}
