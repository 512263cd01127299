//! The free axis: a rotary axis that does not affect the tool direction. Computes the ranges of its coordinate in which
//! the other axes reach the tip within their travels.

use std::f64::consts::{PI, TAU};

use volcomp_kinematics::{State, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, PerAxis};

use crate::machine::Machine;

/// Number of samples over a turn: dense enough that the distance beyond the travels has at most one relevant minimum
/// between two neighbouring samples.
const STEPS: usize = 720;
/// Number of bisection or ternary-search steps for the ends of ranges and for minima.
const SEARCH_STEPS: usize = 60;
/// Tolerance of the travel limits, mm or rad.
const TRAVEL_TOLERANCE: f64 = 1e-10;

/// The target: tip (mm) and tool direction in workpiece axes. The axes in `pair` reach the direction; all other rotary
/// axes keep their coordinates in `held`.
pub(crate) struct Target<'a> {
    pub(crate) tip_mm: &'a Vector3<f64>,
    pub(crate) direction: &'a Vector3<f64>,
    pub(crate) pair: &'a [usize],
    pub(crate) held: &'a State,
    pub(crate) travel: &'a PerAxis<[f64; 2]>,
}

impl Machine {
    /// The ranges of the free axis (index `free`) within one turn, rad, ascending, in which the target is within all travels.
    pub(crate) fn free_ranges(&self, free: usize, target: &Target<'_>) -> Vec<[f64; 2]> {
        let [low, high] = target.travel[free];
        // One turn, as close to −180° to 180° as the travel allows, or the whole travel if it is shorter.
        let from = (-PI).min(high - TAU).max(low);
        let to = high.min(from + TAU);
        let beyond = |q: f64| self.beyond_travel(q, free, target);
        let at = |step: usize| from + (to - from) * (step as f64 / STEPS as f64);
        let mut stations: Vec<(f64, f64)> =
            (0..=STEPS).map(|step| (at(step), beyond(at(step)))).collect();
        for place in 1..STEPS {
            let [before, here, after] =
                [-1, 0, 1].map(|by| stations[place.saturating_add_signed(by)]);
            if here.1 > TRAVEL_TOLERANCE && here.1 <= before.1 && here.1 <= after.1 {
                stations[place] = lowest(before.0, after.0, &beyond);
            }
        }
        // A minimum may also be between an end and its neighbour. For a full turn both ends are the
        // same pose, and each is checked on its side.
        for (end, beside) in [(STEPS, STEPS - 1), (0, 1)] {
            let ([end, beside], place) = ([stations[end], stations[beside]], end.max(beside));
            if end.1 > TRAVEL_TOLERANCE && end.1 <= beside.1 {
                let dip = lowest(end.0.min(beside.0), end.0.max(beside.0), &beyond);
                stations.insert(place, dip);
            }
        }
        let mut ranges: Vec<[f64; 2]> = Vec::new();
        let mut is_open = false;
        for (place, &(q, off)) in stations.iter().enumerate() {
            let before = place.checked_sub(1).map(|before| stations[before].0);
            if off <= TRAVEL_TOLERANCE && !is_open {
                ranges.push([before.map_or(q, |outside| edge(q, outside, &beyond)), q]);
            } else if off > TRAVEL_TOLERANCE
                && is_open
                && let Some(range) = ranges.last_mut()
            {
                range[1] = edge(range[1], q, &beyond);
            } else if let Some(range) = ranges.last_mut().filter(|_| is_open) {
                range[1] = q;
            }
            is_open = off <= TRAVEL_TOLERANCE;
        }
        ranges
    }

    /// The largest distance of an axis beyond its travel, mm or rad, with the free axis at `q`; infinite if the tip or the direction cannot
    /// be reached.
    fn beyond_travel(&self, q: f64, free: usize, target: &Target<'_>) -> f64 {
        let Some(state) = self.with_free(q, free, target) else {
            return f64::INFINITY;
        };
        let joints = self.chain().joints().iter().enumerate();
        let beyond = joints.map(|(place, joint)| {
            let [low, high] = target.travel[place];
            let q = state.q[place];
            match joint.kind {
                AxisKind::Linear => (low - q).max(q - high),
                // Of the equivalent angles, the one nearest to the middle of the travel is used.
                AxisKind::Rotary if place == free => 0.0,
                AxisKind::Rotary => {
                    let turned = q + TAU * ((0.5 * (low + high) - q) / TAU).round();
                    (low - turned).max(turned - high)
                }
            }
        });
        beyond.fold(0.0, f64::max)
    }

    /// The state with the free axis at `q`; `None` if the tool direction cannot be reached with this axis free, or the
    /// linear axes do not reach the tip.
    pub(crate) fn with_free(&self, q: f64, free: usize, target: &Target<'_>) -> Option<State> {
        let mut held = *target.held;
        held.q[free] = q;
        let found = self.chain().pointing(target.direction, target.pair, &held).ok()?;
        let pointing = found.into_iter().find(|pointing| pointing.free == Some(free))?;
        let reached = self.chain().reaching(target.tip_mm, &pointing.state, target.travel);
        reached.ok()
    }
}

pub(crate) fn nearest_to_zero([low, high]: [f64; 2]) -> f64 {
    0.0_f64.max(low).min(high)
}

/// Bisects for the end of a range between a coordinate inside the range and one outside.
fn edge(mut inside: f64, mut outside: f64, beyond: &impl Fn(f64) -> f64) -> f64 {
    for _ in 0..SEARCH_STEPS {
        let middle = 0.5 * (inside + outside);
        if beyond(middle) <= TRAVEL_TOLERANCE {
            inside = middle;
        } else {
            outside = middle;
        }
    }
    inside
}

/// Coordinate and value of the minimum of `beyond` between two coordinates, by ternary search.
fn lowest(mut low: f64, mut high: f64, beyond: &impl Fn(f64) -> f64) -> (f64, f64) {
    for _ in 0..SEARCH_STEPS {
        let [left, right] = [low + (high - low) / 3.0, high - (high - low) / 3.0];
        if beyond(left) <= beyond(right) {
            high = right;
        } else {
            low = left;
        }
    }
    let middle = 0.5 * (low + high);
    (middle, beyond(middle))
}
