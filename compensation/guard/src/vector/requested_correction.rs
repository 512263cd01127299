//! The correction by a model, and the part of it that the limits allow.

use volcomp_vocabulary::{AxisKind, MAX_AXES, PerChannel};

use super::cycle::quantised;
use crate::{
    AxisLimits, Limits,
    step::{ROUNDING_STEPS, whole_below},
};

/// Number of reduced rotary shares that are tried if no neighbouring whole steps fit the limits.
const SHARES: u32 = 8;

/// The correction by a model, in channel order. A share is the displacement of one axis. For any rotary shares δ_r
/// during a motion, the matching linear shares are `position` + Σ `follow[r]`·δ_r.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RequestedCorrection {
    /// Linear shares of the position error while no rotary axis moves, mm; zero for rotary axes.
    pub position: PerChannel<f64>,
    /// The shares of the rotary axes, rad; zero for linear axes.
    pub rotary: PerChannel<f64>,
    /// For each rotary axis r and linear axis l, `follow[r][l]` is the movement of l per movement
    /// of r that keeps the tool tip in place, mm/rad. All other entries are zero.
    pub follow: PerChannel<PerChannel<f64>>,
}

/// The result of a cycle that followed the requested correction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools, reason = "four answers that do not exclude one another")]
pub struct FollowResult {
    /// Slew or acceleration limits the correction: the ramp, rotary axes on the way to their goal, or linear axes
    /// (`behind`).
    pub slewing: bool,
    /// Whether a linear axis has not reached the position for the present rotary shares. Implies `slewing`. If false,
    /// and if the limits of the linear axes permit this position, the error of the tool exceeds neither the error
    /// without correction nor the error at the start of the ramp, apart from the rounding of the output.
    pub behind: bool,
    /// A limit allows only a part of the requested correction.
    pub limited: bool,
    /// The requested correction of an axis exceeds its warning threshold.
    pub warned: bool,
}

impl RequestedCorrection {
    /// The correction of a machine without corrected rotary axes.
    pub fn linear(position: PerChannel<f64>) -> Self {
        Self { position, ..Self::default() }
    }

    /// The whole correction without limits, mm and rad.
    pub fn full(&self) -> PerChannel<f64> {
        let following = self.following(&self.rotary);
        PerChannel::from_fn(|i| self.position[i] + following[i] + self.rotary[i])
    }

    /// Compares the request with the limits; `part` is the fraction of the position share that the limits allow.
    pub(super) fn judged(&self, part: f64, limits: &Limits) -> FollowResult {
        let full = self.full();
        let over = |most: fn(&AxisLimits) -> f64| {
            let mut axes = limits.axes.iter().zip(&full).take(limits.count);
            axes.any(|(axis, full)| full.abs() > most(axis) + ROUNDING_STEPS * axis.resolution)
        };
        FollowResult {
            limited: part < 1.0 || over(|axis| axis.limit),
            warned: over(|axis| axis.warn),
            ..FollowResult::default()
        }
    }

    /// Movement of the linear axes that follows these rotary shares, mm.
    pub(super) fn following(&self, rotary: &PerChannel<f64>) -> PerChannel<f64> {
        let mut following = PerChannel::ZERO;
        for (row, share) in self.follow.iter().zip(rotary) {
            if *share != 0.0 {
                for (sum, follow) in following.iter_mut().zip(row) {
                    *sum += follow * share;
                }
            }
        }
        following
    }

    pub(crate) fn is_finite(&self) -> bool {
        let finite = |values: &PerChannel<f64>| values.iter().all(|x| x.is_finite());
        finite(&self.position) && finite(&self.rotary) && self.follow.iter().all(finite)
    }

    /// Goal of the rotary axes, rad, in whole steps. It is the largest fraction of their shares with which every axis
    /// stays within its limit while the linear axes also apply `position`; zero if no fraction fits. Steps near the
    /// previous goal `before` are preferred (hysteresis).
    pub(super) fn rotary_goal(
        &self,
        position: &PerChannel<f64>,
        before: &PerChannel<f64>,
        limits: &Limits,
    ) -> PerChannel<f64> {
        let reach = reach(limits);
        let following = self.following(&self.rotary);
        let along = PerChannel::from_fn(|i| following[i] + self.rotary[i]);
        let Some(part) = largest_part(position, &along, &reach) else {
            return PerChannel::ZERO;
        };
        let exact = self.rotary.map(|share| part * share);
        let rounded = rotary_of(limits, |i| {
            let axis = &limits.axes[i];
            let most = axis.reachable();
            quantised(before[i], exact[i], axis.resolution).max(-most).min(most)
        });
        if self.fits(position, &rounded, &reach) {
            return rounded;
        }
        // Rounding exceeded the limit of a linear axis. The nearest whole steps within all limits are used, going
        // towards zero.
        (0..=SHARES)
            .rev()
            .find_map(|share| {
                let part = f64::from(share) / f64::from(SHARES);
                let exact = exact.map(|whole| part * whole);
                self.nearest_steps(position, &exact, limits, &reach)
            })
            .unwrap_or_default()
    }

    /// The nearest whole steps to the rotary shares (rad) with which every axis stays within its reach.
    fn nearest_steps(
        &self,
        position: &PerChannel<f64>,
        exact: &PerChannel<f64>,
        limits: &Limits,
        reach: &PerChannel<f64>,
    ) -> Option<PerChannel<f64>> {
        // One bit per moving rotary axis: 1 for the step above its share, 0 for the step below.
        let turning = rotary_of(limits, |i| exact[i]);
        let all = (0..MAX_AXES).filter(|i| turning[*i] != 0.0).fold(0_usize, |all, i| all | 1 << i);
        let mut nearest: Option<(f64, PerChannel<f64>)> = None;
        let mut choice = 0_usize;
        loop {
            let mut away = 0.0;
            let steps = rotary_of(limits, |i| {
                let (step, share) = (limits.axes[i].resolution, exact[i]);
                let below = whole_below(share, step);
                let at = below + if choice >> i & 1 == 1 { step } else { 0.0 };
                away += (at - share).abs() / step;
                at
            });
            let is_nearer = nearest.is_none_or(|(least, _)| away < least);
            if is_nearer && self.fits(position, &steps, reach) {
                nearest = Some((away, steps));
            }
            choice = choice.wrapping_sub(all) & all;
            if choice == 0 {
                break;
            }
        }
        nearest.map(|(_, steps)| steps)
    }

    fn fits(
        &self,
        position: &PerChannel<f64>,
        rotary: &PerChannel<f64>,
        reach: &PerChannel<f64>,
    ) -> bool {
        let following = self.following(rotary);
        let all = PerChannel::from_fn(|i| position[i] + following[i] + rotary[i]);
        largest_part(&all, &PerChannel::ZERO, reach).is_some()
    }

    /// The largest fraction of a position share that keeps every linear axis within its reach with the rotary axes at
    /// `rotary`. If no fraction fits, the middle between the conflicting bounds of the axes is used, so that the output
    /// does not jump.
    pub(super) fn position_part(
        &self,
        position: &PerChannel<f64>,
        rotary: &PerChannel<f64>,
        reach: &PerChannel<f64>,
    ) -> f64 {
        let following = self.following(rotary);
        let [least, most] = parts(&following, position, reach);
        let part = if least <= most || least.is_infinite() { most } else { 0.5 * (least + most) };
        part.clamp(0.0, 1.0)
    }
}

/// A value for each rotary axis, zero for all others.
fn rotary_of(limits: &Limits, mut value: impl FnMut(usize) -> f64) -> PerChannel<f64> {
    PerChannel::from_fn(|i| {
        if i < limits.count && limits.axes[i].kind == AxisKind::Rotary { value(i) } else { 0.0 }
    })
}

/// Maximum absolute value of each axis, mm and rad: its last step within the limit.
pub(super) fn reach(limits: &Limits) -> PerChannel<f64> {
    let mut reach = PerChannel([f64::INFINITY; MAX_AXES]);
    for (reach, axis) in reach.iter_mut().zip(&limits.axes).take(limits.count) {
        *reach = axis.reachable() + ROUNDING_STEPS * axis.resolution;
    }
    reach
}

/// The largest fraction t in [0, 1] with which `base` + t·`along` is within the reach of every axis.
fn largest_part(
    base: &PerChannel<f64>,
    along: &PerChannel<f64>,
    reach: &PerChannel<f64>,
) -> Option<f64> {
    let [least, most] = parts(base, along, reach);
    (least <= most).then_some(most)
}

/// The smallest and the largest fraction t in [0, 1] with which `base` + t·`along` is within the reach of every axis.
/// If no fraction fits, the smallest exceeds the largest.
fn parts(base: &PerChannel<f64>, along: &PerChannel<f64>, reach: &PerChannel<f64>) -> [f64; 2] {
    let (mut least, mut most) = (0.0_f64, 1.0_f64);
    for ((base, along), reach) in base.iter().zip(along).zip(reach) {
        if along.abs() > 1e-300 {
            let (low, high) = ((-reach - base) / along, (reach - base) / along);
            least = least.max(low.min(high));
            most = most.min(low.max(high));
        } else if base.abs() > *reach {
            least = f64::INFINITY;
        }
    }
    [least, most]
}
