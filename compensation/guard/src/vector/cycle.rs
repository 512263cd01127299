//! One cycle: how far each axis may go in it, and how far axes go that move by one factor.

use volcomp_vocabulary::{AxisKind, MAX_AXES, PerChannel};

use super::{
    ARRIVED_STEPS,
    motion::{allowed_part, braking_part, stopping_part, within},
};
use crate::Limits;

/// The limits of a cycle.
pub(super) struct Cycle<'a> {
    pub(super) limits: &'a Limits,
    pub(super) dt_s: f64,
    /// How far each axis may go, downwards and upwards, mm or rad.
    pub(super) spans: PerChannel<[f64; 2]>,
    /// How far from zero each axis may be, mm or rad: within its limit, or where a limit that was lowered has left it.
    pub(super) reach: PerChannel<f64>,
    /// The acceleration of each axis, 1/s² of mm or rad: its limit, or a higher one that it began to move with.
    pub(super) accel: PerChannel<f64>,
}

/// What may move in a cycle by one factor from 0 to 1.
pub(super) struct Advance {
    /// How far each rotary axis goes with the factor 0, braking as hard as it can, and with the factor 1, rad.
    pub(super) least: PerChannel<f64>,
    pub(super) most: PerChannel<f64>,
    /// Which part of what is left of the ramp passes with the factor 1.
    pub(super) ramp: f64,
}

impl Cycle<'_> {
    /// The places of the axes that there are.
    pub(super) fn places(&self) -> impl Iterator<Item = usize> + use<> {
        0..self.limits.count.min(MAX_AXES)
    }

    /// The places of the axes of a kind.
    pub(super) fn of_kind(&self, kind: AxisKind) -> impl Iterator<Item = usize> + use<'_> {
        let places = self.places();
        places.filter(move |i| self.limits.axes[*i].kind == kind)
    }

    /// The smallest step of an axis, mm or rad.
    pub(super) fn step(&self, axis: usize) -> f64 {
        self.limits.axes[axis].resolution
    }

    /// The acceleration over ways that the axes of a kind go together, 1/s². An axis that is there but for a rounding sets none.
    pub(super) fn accel_over(&self, ways: &PerChannel<f64>, kind: AxisKind) -> f64 {
        self.of_kind(kind)
            .filter(|i| ways[*i].abs() > ARRIVED_STEPS * self.step(*i))
            .map(|i| self.accel[i] / ways[i].abs())
            .fold(f64::INFINITY, f64::min)
    }

    /// The acceleration over ways that all axes go together, 1/s².
    pub(super) fn accel_over_all(&self, ways: &PerChannel<f64>) -> f64 {
        self.accel_over(ways, AxisKind::Linear)
            .min(self.accel_over(ways, AxisKind::Rotary))
    }

    /// Which part of their ways axes go in this cycle by one factor: what the ramp allows and so that they can stop at
    /// their ends, but no less than braking leaves; no more than the span of each allows.
    pub(super) fn part(
        &self,
        ways: &PerChannel<f64>,
        rates: &PerChannel<f64>,
        ramp: f64,
        accel: f64,
    ) -> f64 {
        let rate = self.going(ways, rates) / self.dt_s;
        let part = stopping_part(accel, self.dt_s)
            .min(ramp)
            .max(braking_part(rate, accel, self.dt_s));
        self.places()
            .map(|i| allowed_part(self.spans[i], ways[i]))
            .fold(part, f64::min)
    }

    /// Which part of their ways axes would go by one factor at their rates, or less; 0 where there is no way.
    pub(super) fn going(&self, ways: &PerChannel<f64>, rates: &PerChannel<f64>) -> f64 {
        let part = self
            .places()
            .filter(|i| ways[*i] != 0.0)
            .map(|i| rates[i] / ways[i])
            .fold(f64::INFINITY, f64::min);
        if part.is_finite() {
            part * self.dt_s
        } else {
            0.0
        }
    }

    /// Rotary axes that may go a part of their ways, and a ramp of which a part may pass.
    pub(super) fn advance(&self, ways: &PerChannel<f64>, part: f64, ramp: f64) -> Advance {
        let (mut least, mut most) = (PerChannel::ZERO, PerChannel::ZERO);
        for i in self.of_kind(AxisKind::Rotary) {
            least[i] = within(self.spans[i], 0.0);
            most[i] = within(self.spans[i], part * ways[i]);
        }
        Advance { least, most, ramp }
    }
}
