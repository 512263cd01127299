//! What a model asks for, and which part of it the limits allow.

use volcomp_vocabulary::{AxisKind, MAX_AXES, PerChannel};

use super::cycle::quantised;
use crate::{
    AxisLimits, Limits,
    step::{ROUNDING_STEPS, whole_below},
};

/// Parts of the rotary shares that are tried where no whole steps beside them fit the limits.
const SHARES: u32 = 8;

/// What a model asks for, in channel order. Whatever the rotary shares δ_r are on their way, the linear shares that
/// belong to them are `position` + Σ `follow[r]`·δ_r.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wanted {
    /// What the linear axes take of the position error while no rotary axis moves, mm; zero for rotary axes.
    pub position: PerChannel<f64>,
    /// The shares of the rotary axes, rad; zero for linear axes.
    pub rotary: PerChannel<f64>,
    /// For each rotary axis r and each linear axis l, `follow[r][l]` is how l follows r so that the tool tip stays
    /// where it is, mm for each rad. All other places are zero.
    pub follow: PerChannel<PerChannel<f64>>,
}

/// How a cycle went in which the correction followed what is wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "four answers that do not exclude one another"
)]
pub struct Followed {
    /// Slew or acceleration hold the correction back: the ramp, the rotary axes on the way to their goal, or the linear
    /// axes, which is `behind`.
    pub slewing: bool,
    /// A linear axis is not where it belongs for the rotary shares as they are: only then, and where limits leave no
    /// place for it at all, may the tool be further off than without correction or than where the ramp began, but
    /// for the rounding of the output. It is `slewing`, too.
    pub behind: bool,
    /// A limit allows only a part of what is wanted.
    pub limited: bool,
    /// What is wanted of an axis is above its warning.
    pub warned: bool,
}

impl Wanted {
    /// The correction of a machine whose rotary axes, if it has any, are not corrected.
    pub fn linear(position: PerChannel<f64>) -> Self {
        Self {
            position,
            ..Self::default()
        }
    }

    /// The whole correction without any limit, mm and rad.
    pub fn full(&self) -> PerChannel<f64> {
        let following = self.following(&self.rotary);
        PerChannel::from_fn(|i| self.position[i] + following[i] + self.rotary[i])
    }

    /// What is wanted against the limits, which leave `part` of the position share.
    pub(super) fn judged(&self, part: f64, limits: &Limits) -> Followed {
        let full = self.full();
        let over = |most: fn(&AxisLimits) -> f64| {
            let mut axes = limits.axes.iter().zip(&full).take(limits.count);
            axes.any(|(axis, full)| full.abs() > most(axis) + ROUNDING_STEPS * axis.resolution)
        };
        Followed {
            limited: part < 1.0 || over(|axis| axis.limit),
            warned: over(|axis| axis.warn),
            ..Followed::default()
        }
    }

    /// How the linear axes follow rotary shares, mm.
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

    /// Whether every number is finite.
    pub(crate) fn is_finite(&self) -> bool {
        let finite = |values: &PerChannel<f64>| values.iter().all(|x| x.is_finite());
        finite(&self.position) && finite(&self.rotary) && self.follow.iter().all(finite)
    }

    /// Where the rotary axes go to (rad), `position` being the position share: the largest part of their shares
    /// with which every axis is within its limit, rounded to whole steps about the goal `before`; zero where there is
    /// no such part.
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
            quantised(before[i], exact[i], axis.resolution)
                .max(-most)
                .min(most)
        });
        if self.fits(position, &rounded, &reach) {
            return rounded;
        }
        // Rounding passed the limit of a linear axis: the nearest whole steps that do not, on the way to zero.
        (0..=SHARES)
            .rev()
            .find_map(|share| {
                let part = f64::from(share) / f64::from(SHARES);
                let exact = exact.map(|whole| part * whole);
                self.nearest_steps(position, &exact, limits, &reach)
            })
            .unwrap_or_default()
    }

    /// The whole steps beside rotary shares (rad) with which every axis is within its reach, and which are nearest to the
    /// shares.
    fn nearest_steps(
        &self,
        position: &PerChannel<f64>,
        exact: &PerChannel<f64>,
        limits: &Limits,
        reach: &PerChannel<f64>,
    ) -> Option<PerChannel<f64>> {
        // One bit for each axis that turns: whether it goes to the step above.
        let turning = rotary_of(limits, |i| exact[i]);
        let all = (0..MAX_AXES)
            .filter(|i| turning[*i] != 0.0)
            .fold(0_usize, |all, i| all | 1 << i);
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

    /// The largest part of a position share that leaves every linear axis within its reach while the rotary axes
    /// stand at `rotary`. Where none does, the one between what the axes would allow alone, so that nothing jumps.
    pub(super) fn position_part(
        &self,
        position: &PerChannel<f64>,
        rotary: &PerChannel<f64>,
        reach: &PerChannel<f64>,
    ) -> f64 {
        let following = self.following(rotary);
        let [least, most] = parts(&following, position, reach);
        let part = if least <= most || least.is_infinite() {
            most
        } else {
            0.5 * (least + most)
        };
        part.clamp(0.0, 1.0)
    }
}

/// A value for each rotary axis, zero for all others.
fn rotary_of(limits: &Limits, mut value: impl FnMut(usize) -> f64) -> PerChannel<f64> {
    PerChannel::from_fn(|i| {
        if i < limits.count && limits.axes[i].kind == AxisKind::Rotary {
            value(i)
        } else {
            0.0
        }
    })
}

/// How far each axis may be from zero, mm and rad: its last step within the limit.
pub(super) fn reach(limits: &Limits) -> PerChannel<f64> {
    let mut reach = PerChannel([f64::INFINITY; MAX_AXES]);
    for (reach, axis) in reach.iter_mut().zip(&limits.axes).take(limits.count) {
        *reach = axis.reachable() + ROUNDING_STEPS * axis.resolution;
    }
    reach
}

/// The largest part t in [0, 1] with which `base` + t·`along` is within the reach of every axis.
fn largest_part(
    base: &PerChannel<f64>,
    along: &PerChannel<f64>,
    reach: &PerChannel<f64>,
) -> Option<f64> {
    let [least, most] = parts(base, along, reach);
    (least <= most).then_some(most)
}

/// The least and the largest part t in [0, 1] with which `base` + t·`along` is within the reach of every axis; the
/// least is above the largest where there is none.
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
