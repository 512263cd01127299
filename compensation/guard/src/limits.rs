use core::time::Duration;

use volcomp_vocabulary::{AxisKind, Displacement, MAX_AXES, PerChannel};

use crate::{ceiling, step::whole_below};

/// The limits of one axis: lengths in mm for linear axes, angles in rad for rotary axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// Linear (all numbers in mm) or rotary (all numbers in rad).
    pub kind: AxisKind,
    /// Largest correction, in either direction: at least one step, and at most [`ceiling::LIMIT`] or [`ceiling::LIMIT_ROTARY`]; or 0 for an axis
    /// that is never corrected ([`AxisLimits::held_at_zero`]).
    pub limit: f64,
    /// Absolute value of the correction above which [`Reasons::WARN`](crate::Reasons::WARN) is reported.
    pub warn: f64,
    /// Largest change of the correction per second; at most [`ceiling::SLEW_PER_S`] or [`ceiling::SLEW_PER_S_ROTARY`].
    pub slew_per_s: f64,
    /// Largest change of the slew per second; infinite: unlimited.
    pub accel_per_s2: f64,
    /// Smallest step of the controller.
    pub resolution: f64,
    /// Whether the reported positions of the axis contain the correction.
    pub includes_correction: bool,
}

/// The limits of a controller: the limits of its axes, and the common times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Limits of each axis (mm, rad), in channel order; entries from `count` on are unused.
    pub axes: [AxisLimits; MAX_AXES],
    /// Number of axes of the controller.
    pub count: usize,
    /// Nominal cycle period, from [`ceiling::SHORTEST_CYCLE`] to [`ceiling::LONGEST_CYCLE`].
    pub period: Duration,
    /// Age of positions from which the correction is held; at most [`ceiling::HOLD`], or [`ceiling::HOLD_THERMAL`] with `only_thermal`.
    pub hold: Duration,
    /// Whether the correction consists of thermal terms alone.
    pub only_thermal: bool,
    /// Age of positions from which the correction ramps to zero.
    pub zero_after: Duration,
    /// Configured ramp time; see [`Limits::ramp_taken`] for the actual ramp time.
    pub ramp: Duration,
    /// Shift of each axis in the test at arming, mm or rad ([`Proof`](crate::Proof)). 0: the axis is not tested;
    /// otherwise at least four steps of the correction and of the reported position.
    pub test_shift: PerChannel<f64>,
    /// Maximum lag of the read-back in writes, 1 to [`MOST_READ_BACK_CYCLES`].
    pub read_back_cycles: usize,
}

/// Maximum allowed lag of a read-back, in writes.
pub const MOST_READ_BACK_CYCLES: usize = 32;
/// Minimum number of cycles of a ramp; a shorter ramp would act as a step.
pub const FEWEST_RAMP_CYCLES: u32 = 20;

/// The limit that a [`LimitsError`] reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Smallest step of an axis, mm or rad.
    Resolution,
    /// Largest correction of an axis, mm or rad.
    Limit,
    /// Correction of an axis above which a warning is reported, mm or rad.
    Warn,
    /// Largest change of the correction of an axis, mm/s or rad/s.
    Slew,
    /// Largest change of the slew of an axis, mm/s² or rad/s².
    Accel,
    /// Test shift of an axis at arming, mm or rad.
    TestShift,
    /// The number of axes.
    Axes,
    /// Cycle period, s.
    Period,
    /// Age of positions from which the correction is held, s.
    Hold,
    /// Age of positions from which the correction ramps to zero, s.
    ZeroAfter,
    /// Maximum lag of the read-back, in writes.
    ReadBack,
}

impl core::fmt::Display for Quantity {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Resolution => "resolution",
            Self::Limit => "limit",
            Self::Warn => "warning",
            Self::Slew => "slew",
            Self::Accel => "acceleration",
            Self::TestShift => "test shift",
            Self::Axes => "number of axes",
            Self::Period => "time of a cycle",
            Self::Hold => "hold",
            Self::ZeroAfter => "zero after",
            Self::ReadBack => "cycles of the read-back",
        })
    }
}

/// A limit that is rejected, with the number found and the allowed numbers.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{what}: found {}, expected {expected}", self.found())]
pub struct LimitsError {
    /// The rejected limit.
    pub what: Quantity,
    /// Index and kind of the axis; `None` for a limit that does not belong to an axis.
    pub axis: Option<(usize, AxisKind)>,
    /// The number, in the unit of the [`Quantity`].
    pub found: f64,
    pub expected: &'static str,
}

impl LimitsError {
    /// The number with its unit: µm or µrad for axes, ms for times.
    pub fn found(&self) -> impl core::fmt::Display + use<> {
        Found(*self)
    }
}

struct Found(LimitsError);

impl core::fmt::Display for Found {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self(error) = self;
        let kind = error.axis.map_or(AxisKind::Linear, |(_, kind)| kind);
        let of_axis = Displacement::new(kind, error.found);
        match error.what {
            Quantity::Resolution | Quantity::Limit | Quantity::Warn | Quantity::TestShift => {
                write!(f, "{of_axis}")
            }
            Quantity::Slew => write!(f, "{of_axis}/s"),
            Quantity::Accel => write!(f, "{of_axis}/s²"),
            Quantity::Period | Quantity::Hold | Quantity::ZeroAfter => {
                write!(f, "{} ms", error.found * 1e3)
            }
            Quantity::Axes | Quantity::ReadBack => write!(f, "{}", error.found),
        }
    }
}

impl AxisLimits {
    /// Limits of an unused axis, which does not move.
    pub const NONE: Self = Self {
        kind: AxisKind::Linear,
        limit: 0.0,
        warn: 0.0,
        slew_per_s: 0.0,
        accel_per_s2: 0.0,
        resolution: 1.0,
        includes_correction: false,
    };

    /// Limits of an axis that is not corrected and always written as zero. Its step may exceed the
    /// largest allowed correction. A remaining correction of up to one step returns to zero at the
    /// slew.
    #[must_use]
    pub fn held_at_zero(self) -> Self {
        Self { limit: 0.0, warn: 0.0, ..self }
    }

    /// Largest writable correction, mm or rad: the largest multiple of the resolution within the limit.
    pub fn reachable(&self) -> f64 {
        whole_below(self.limit, self.resolution)
    }

    fn check(&self, axis: usize, test_shift: f64) -> Result<(), LimitsError> {
        use Quantity::{Accel, Limit, Resolution, Slew, TestShift, Warn};
        // Tolerates the rounding of a ceiling converted from µm or µrad.
        let [most, fastest] = ceiling::of(self.kind).map(|ceiling| ceiling * (1.0 + 1e-12));
        let [expected_limit, expected_slew] = match self.kind {
            AxisKind::Linear => [
                "at most 2000 µm, the ceiling that no configuration raises",
                "at most 5000 µm/s, the ceiling that no configuration raises",
            ],
            AxisKind::Rotary => [
                "at most 2000 µrad, the ceiling that no configuration raises",
                "at most 5000 µrad/s, the ceiling that no configuration raises",
            ],
        };
        let Self { limit, warn, slew_per_s, accel_per_s2, resolution, .. } = *self;
        let positive = |x: f64| x > 0.0 && x.is_finite();
        let has_step = limit.is_finite() && (limit >= resolution || limit == 0.0);
        let is_proof = test_shift == 0.0 || (4.0 * resolution..=limit).contains(&test_shift);
        let number = "a positive number";
        let step = "at least one step of the controller";
        let within = "a number from 0 to the limit";
        let shift = "0, or four steps of the controller up to the limit";
        for (what, found, expected, is_good) in [
            (Resolution, resolution, number, positive(resolution)),
            (Limit, limit, step, has_step),
            (Limit, limit, expected_limit, limit <= most),
            (Warn, warn, within, (0.0..=limit).contains(&warn)),
            (Slew, slew_per_s, number, positive(slew_per_s)),
            (Slew, slew_per_s, expected_slew, slew_per_s <= fastest),
            (Accel, accel_per_s2, number, accel_per_s2 > 0.0),
            (TestShift, test_shift, shift, is_proof),
        ] {
            if !is_good || found.is_nan() {
                return Err(LimitsError { what, axis: Some((axis, self.kind)), found, expected });
            }
        }
        Ok(())
    }
}

impl Limits {
    /// Checks every number of the limits.
    ///
    /// # Errors
    /// The first invalid number.
    pub fn check(&self) -> Result<(), LimitsError> {
        let wrong = |what, found: f64, expected| LimitsError { what, axis: None, found, expected };
        if !(1..=MAX_AXES).contains(&self.count) {
            return Err(wrong(Quantity::Axes, self.count as f64, "1 to 9"));
        }
        for (axis, limits) in self.axes.iter().take(self.count).enumerate() {
            limits.check(axis, self.test_shift[axis])?;
        }
        let (period, hold) = (self.period, self.hold);
        let (longest, expected) = if self.only_thermal {
            let expected = "at most 5 s, the ceiling for thermal terms alone";
            (ceiling::HOLD_THERMAL, expected)
        } else {
            let expected = "at most 200 ms, the ceiling that no configuration raises";
            (ceiling::HOLD, expected)
        };
        let cycles = ceiling::SHORTEST_CYCLE..=ceiling::LONGEST_CYCLE;
        let later = "at least as long as hold";
        for (what, time, expected, is_good) in [
            (Quantity::Period, period, "0.25 ms to 100 ms", cycles.contains(&period)),
            (Quantity::Hold, hold, "at least one cycle", hold >= period),
            (Quantity::Hold, hold, expected, hold <= longest),
            (Quantity::ZeroAfter, self.zero_after, later, self.zero_after >= hold),
        ] {
            if !is_good {
                return Err(wrong(what, time.as_secs_f64(), expected));
            }
        }
        if !(1..=MOST_READ_BACK_CYCLES).contains(&self.read_back_cycles) {
            let found = self.read_back_cycles as f64;
            return Err(wrong(Quantity::ReadBack, found, "1 to 32"));
        }
        Ok(())
    }

    /// Checks every number, and that these limits can replace the limits `before` of the same controller: same axes,
    /// same steps.
    ///
    /// # Errors
    /// The first invalid number.
    pub fn check_in_place_of(&self, before: &Self) -> Result<(), LimitsError> {
        self.check()?;
        let refused = |expected| LimitsError {
            what: Quantity::Axes,
            axis: None,
            found: self.count as f64,
            expected,
        };
        if self.count != before.count {
            return Err(refused("as many as before"));
        }
        let axes = self.axes.iter().zip(&before.axes).take(self.count);
        for (place, (axis, before)) in axes.enumerate() {
            if axis.kind != before.kind {
                return Err(refused("axes of the same kinds as before"));
            }
            if axis.resolution != before.resolution {
                return Err(LimitsError {
                    what: Quantity::Resolution,
                    axis: Some((place, axis.kind)),
                    found: axis.resolution,
                    expected: "the step of before: the control counts in it",
                });
            }
        }
        Ok(())
    }

    /// The indices of the used axes.
    pub(crate) fn places(&self) -> core::ops::Range<usize> {
        0..self.count.min(MAX_AXES)
    }

    /// Delay of the path: maximum time from a write to its read-back.
    #[must_use]
    pub fn delay(&self) -> Duration {
        let cycles = u32::try_from(self.read_back_cycles).unwrap_or(u32::MAX);
        self.period.saturating_mul(cycles)
    }

    /// Maximum time for which a reading may still show the value before a write: the delay plus one cycle on each side,
    /// because a write follows the reading of its cycle.
    pub(crate) fn longest_delay(&self) -> Duration {
        self.delay().saturating_add(self.period * 2)
    }

    /// Maximum age of a reading from a control without a barrier. Positions older than `zero_after` are rejected, so a
    /// reading can be at most one longest delay older.
    pub(crate) fn oldest_reading(&self) -> Duration {
        self.zero_after.saturating_add(self.longest_delay())
    }

    /// The result of `number` for each used axis; 0 for unused axes.
    pub(crate) fn of_axes(&self, number: impl Fn(&AxisLimits) -> f64) -> PerChannel<f64> {
        PerChannel::from_fn(|i| if i < self.count { number(&self.axes[i]) } else { 0.0 })
    }

    /// Actual ramp time: the configured time, but at least 20 cycles.
    pub fn ramp_taken(&self) -> Duration {
        let fewest = self.period.saturating_mul(FEWEST_RAMP_CYCLES);
        self.ramp.max(fewest)
    }

    /// Fraction of a ramp that passes in `dt_s`.
    pub(crate) fn ramp_share(&self, dt_s: f64) -> f64 {
        (dt_s / self.ramp_taken().as_secs_f64()).min(1.0 / f64::from(FEWEST_RAMP_CYCLES))
    }
}
