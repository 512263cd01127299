//! The limits of a controller and of its axes, and the check that they make sense.

use core::time::Duration;

use volcomp_vocabulary::{AxisKind, Displacement, MAX_AXES, PerChannel};

use crate::{ceiling, step::whole_below};

/// The limits of one axis: lengths in mm for linear axes, angles in rad for rotary axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// Whether the axis slides (all numbers in mm) or turns (all numbers in rad).
    pub kind: AxisKind,
    /// The largest correction, in either direction: at least one step, and at most [`ceiling::LIMIT`] or
    /// [`ceiling::LIMIT_ROTARY`]; or 0 for an axis that is never corrected ([`AxisLimits::held_at_zero`]).
    pub limit: f64,
    /// A correction that is larger than this, in either direction, is reported.
    pub warn: f64,
    /// The largest change of the correction in a second; at most [`ceiling::SLEW_PER_S`] or
    /// [`ceiling::SLEW_PER_S_ROTARY`].
    pub slew_per_s: f64,
    /// The largest change of the slew in a second; infinite: not limited.
    pub accel_per_s2: f64,
    /// The smallest step of the controller.
    pub resolution: f64,
    /// Whether its reported positions contain the correction.
    pub includes_correction: bool,
}

/// The limits of a controller: those of its axes, and the times that hold for all of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// The limits of each axis (mm, rad), in channel order; places from `count` on are not used.
    pub axes: [AxisLimits; MAX_AXES],
    /// How many axes the controller has.
    pub count: usize,
    /// The nominal time of a cycle, from [`ceiling::SHORTEST_CYCLE`] to [`ceiling::LONGEST_CYCLE`].
    pub period: Duration,
    /// When positions are older than this, the correction is held; at most [`ceiling::HOLD`], or
    /// [`ceiling::HOLD_THERMAL`] where `only_thermal` says so.
    pub hold: Duration,
    /// Whether the correction is that of thermal terms alone.
    pub only_thermal: bool,
    /// When positions are older than this, the correction ramps to zero.
    pub zero_after: Duration,
    /// The configured time of a ramp; it takes [`Limits::ramp_taken`].
    pub ramp: Duration,
    /// Shift that proves at arming whether positions contain it, mm and rad; 0: not proven. At least four steps
    /// of correction and position.
    pub test_shift: PerChannel<f64>,
    /// How many writes the read-back may be behind, 1 to [`MOST_READ_BACK_CYCLES`].
    pub read_back_cycles: usize,
}

/// The largest number of writes that a read-back may be behind.
pub const MOST_READ_BACK_CYCLES: usize = 32;
/// The smallest number of cycles over which a ramp goes: a shorter one would be a step.
pub const FEWEST_RAMP_CYCLES: u32 = 20;

/// One number of the limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// The smallest step of an axis, mm or rad.
    Resolution,
    /// The largest correction of an axis, mm or rad.
    Limit,
    /// The correction of an axis above which it is reported, mm or rad.
    Warn,
    /// The largest change of the correction of an axis, mm/s or rad/s.
    Slew,
    /// The largest change of the slew of an axis, mm/s² or rad/s².
    Accel,
    /// The shift of an axis that is made at arming, mm or rad.
    TestShift,
    /// The number of axes.
    Axes,
    /// The time of a cycle, s.
    Period,
    /// The age from which positions are held, s.
    Hold,
    /// The age from which positions ramp the correction to zero, s.
    ZeroAfter,
    /// How many writes the read-back may be behind.
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

/// A number of the limits that a guard refuses.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{what}: found {}, expected {expected}", self.found())]
pub struct LimitsError {
    /// Which number is wrong.
    pub what: Quantity,
    /// The place of the axis and its kind, where the number is that of an axis.
    pub axis: Option<(usize, AxisKind)>,
    /// The number that was found, in the unit of the [`Quantity`].
    pub found: f64,
    /// The numbers that are allowed, in words.
    pub expected: &'static str,
}

impl LimitsError {
    /// The number that was found, with its unit: µm or µrad for what belongs to an axis, ms for times.
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
    /// The limits of an axis that is not there: it does not move.
    pub const NONE: Self = Self {
        kind: AxisKind::Linear,
        limit: 0.0,
        warn: 0.0,
        slew_per_s: 0.0,
        accel_per_s2: 0.0,
        resolution: 1.0,
        includes_correction: false,
    };

    /// The limits of an axis that is not corrected, and is written with zero: the step of one may be larger than any
    /// correction may be. What is left over there, up to one step, goes back to zero at the slew.
    #[must_use]
    pub fn held_at_zero(self) -> Self {
        Self {
            limit: 0.0,
            warn: 0.0,
            ..self
        }
    }

    /// The largest correction that is really written, mm or rad: the largest multiple of the resolution within the
    /// limit.
    pub fn reachable(&self) -> f64 {
        whole_below(self.limit, self.resolution)
    }

    fn check(&self, axis: usize, test_shift: f64) -> Result<(), LimitsError> {
        use Quantity::{Accel, Limit, Resolution, Slew, TestShift, Warn};
        // A ceiling that was converted from µm or µrad is not missed by a rounding.
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
        let Self {
            limit,
            warn,
            slew_per_s,
            accel_per_s2,
            resolution,
            ..
        } = *self;
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
                return Err(LimitsError {
                    what,
                    axis: Some((axis, self.kind)),
                    found,
                    expected,
                });
            }
        }
        Ok(())
    }
}

impl Limits {
    /// Checks every number of the limits.
    ///
    /// # Errors
    /// The first number that is wrong.
    pub fn check(&self) -> Result<(), LimitsError> {
        let wrong = |what, found: f64, expected| LimitsError {
            what,
            axis: None,
            found,
            expected,
        };
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
            (
                Quantity::Period,
                period,
                "0.25 ms to 100 ms",
                cycles.contains(&period),
            ),
            (Quantity::Hold, hold, "at least one cycle", hold >= period),
            (Quantity::Hold, hold, expected, hold <= longest),
            (
                Quantity::ZeroAfter,
                self.zero_after,
                later,
                self.zero_after >= hold,
            ),
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

    /// Checks every number, and that these limits can take the place of others while the same controller corrects: they are
    /// of the same axes in the same steps.
    ///
    /// # Errors
    /// The first number that is wrong.
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

    /// The places of the axes that there are.
    pub(crate) fn places(&self) -> core::ops::Range<usize> {
        0..self.count.min(MAX_AXES)
    }

    /// The delay of the path: how long after a write its values may be read back.
    #[must_use]
    pub fn delay(&self) -> Duration {
        let cycles = u32::try_from(self.read_back_cycles).unwrap_or(u32::MAX);
        self.period.saturating_mul(cycles)
    }

    /// How long after a write what it replaced may still be read: a cycle more on each side, since a write comes after
    /// the reading of its cycle.
    pub(crate) fn longest_delay(&self) -> Duration {
        self.delay().saturating_add(self.period * 2)
    }

    /// How long after a write no reading of a control without a barrier is from before it, however late: what is older
    /// than `zero_after` would be lost as a position, too.
    pub(crate) fn oldest_reading(&self) -> Duration {
        self.zero_after.saturating_add(self.longest_delay())
    }

    /// A number of each axis, 0 for places without one.
    pub(crate) fn of_axes(&self, number: impl Fn(&AxisLimits) -> f64) -> PerChannel<f64> {
        PerChannel::from_fn(|i| {
            if i < self.count {
                number(&self.axes[i])
            } else {
                0.0
            }
        })
    }

    /// The time that a ramp takes: the configured one, or 20 cycles if that is longer.
    pub fn ramp_taken(&self) -> Duration {
        let fewest = self.period.saturating_mul(FEWEST_RAMP_CYCLES);
        self.ramp.max(fewest)
    }

    /// The share of a ramp that passes in `dt_s`.
    pub(crate) fn ramp_share(&self, dt_s: f64) -> f64 {
        (dt_s / self.ramp_taken().as_secs_f64()).min(1.0 / f64::from(FEWEST_RAMP_CYCLES))
    }
}
