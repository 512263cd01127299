//! What the age of the positions leaves of a correction: it belongs to the place where the machine was. State: how fast the
//! axes go.

use std::time::Duration;

use volcomp_guard::{Limits, Reasons, shortest_way};
use volcomp_kinematics::{Correctors, State};
use volcomp_vocabulary::{AxisKind, PerAxis};

use crate::{
    model::{Model, ModelWanted},
    place::Place,
};

/// Speeds are taken over so much time at least: a count of a position says little of the speed.
const BASE: Duration = Duration::from_millis(20);
/// For so long it is told that something was let go: at speed this changes with every place.
const TOLD: Duration = Duration::from_secs(2);
/// Further ahead nobody looks.
const LONGEST: Duration = Duration::from_secs(10);

/// How fast the axes go, and what is let go because of it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lag {
    /// Positions, and when they held.
    before: Option<(PerAxis<f64>, Duration)>,
    /// mm/s and rad/s.
    speed: PerAxis<f64>,
    /// When something was let go last.
    last: Option<Duration>,
    /// The correction goes out, until positions are fresh again.
    goes_out: bool,
}

/// What a model asks for at a place, and what a cycle knows besides.
pub(super) struct Asked<'a> {
    pub(super) model: &'a Model,
    pub(super) correctors: &'a Correctors,
    /// Whether the correction is that of thermal terms alone.
    pub(super) only_thermal: bool,
    pub(super) limits: &'a Limits,
    pub(super) state: &'a State,
    pub(super) wanted: &'a ModelWanted,
    /// The correction that is applied, in machine order.
    pub(super) applied: &'a PerAxis<f64>,
    /// How long a line to zero takes.
    pub(super) way_out: Duration,
}

/// What is kept of a correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Kept {
    /// The part of it that is still better than none.
    pub(super) part: f64,
    /// Positions are stale, and what is held would become worse than none.
    pub(super) let_go: bool,
    pub(super) notes: Reasons,
}

impl Lag {
    /// Takes positions and how fast they change.
    pub(super) fn see(&mut self, place: &Place, model: &Model) {
        let Some(taken) = place.oldest else { return };
        let Some((before, at)) = self.before else {
            self.before = Some((place.positions, taken));
            return;
        };
        let passed = taken.saturating_sub(at);
        if passed < BASE {
            return;
        }
        self.speed = PerAxis::from_fn(|axis| {
            let way = place.positions[axis] - before[axis];
            shortest_way(way, model.turn_of(axis)) / passed.as_secs_f64()
        });
        self.before = Some((place.positions, taken));
    }

    /// Which part of a correction is better than none, `age` being that of the positions: the machine has gone on with its
    /// speed since then, and goes on until the correction is in the axes. On the way there the correction changes by some
    /// distance d. One of the size c is better than none wherever it leads within d as long as d is at most c/2, and
    /// 2·(1 − d/c) of it is for more; at d = c nothing is left.
    pub(super) fn kept(&mut self, asked: &Asked<'_>, age: Duration, now: Duration) -> Kept {
        let limits = asked.limits;
        let stale = age > limits.hold;
        let mut ahead = age.saturating_add(limits.delay());
        if stale {
            // What is held can only go out as fast as it may.
            ahead = ahead.saturating_add(asked.way_out);
        }
        let ahead = ahead.min(LONGEST);
        let part = if self.speed.iter().any(|speed| *speed != 0.0) {
            // Half the way as well: what comes round again is not the same on the way.
            let half = asked.part_after(&self.speed, ahead / 2);
            half.min(asked.part_after(&self.speed, ahead))
        } else {
            1.0
        };
        self.goes_out = stale && (self.goes_out || part < 1.0);
        if part < 1.0 {
            self.last = Some(now);
        }
        let told = self
            .last
            .is_some_and(|last| now.saturating_sub(last) <= TOLD);
        Kept {
            part,
            let_go: self.goes_out,
            notes: Reasons::LET_GO.when(told),
        }
    }
}

impl Asked<'_> {
    /// The part that is better than none when the axes have gone on with this speed for `time`.
    fn part_after(&self, speed: &PerAxis<f64>, time: Duration) -> f64 {
        let mut there = *self.state;
        for (q, speed) in there.q.iter_mut().zip(speed) {
            *q += speed * time.as_secs_f64();
        }
        let (now, then) = (
            self.wanted,
            self.model
                .wanted_by(self.only_thermal, &there, self.correctors, self.applied),
        );
        // What the linear shares of now do to the position there: the levers of the rotary shares are others.
        let does = PerAxis::from_fn(|axis| {
            let rows = now.follow.iter().zip(&then.follow).zip(&now.rotary);
            let lever = |((now, then), share): ((&PerAxis<f64>, &PerAxis<f64>), &f64)| {
                (now[axis] - then[axis]) * share
            };
            now.position[axis] + rows.map(lever).sum::<f64>()
        });
        let position = part(&does, &then.position, self.step(AxisKind::Linear));
        position.min(part(&now.rotary, &then.rotary, self.step(AxisKind::Rotary)))
    }

    /// The largest step of the axes of a kind.
    fn step(&self, kind: AxisKind) -> f64 {
        let axes = self.limits.axes.iter().take(self.limits.count);
        let of_kind = axes.filter(|axis| axis.kind == kind);
        of_kind.map(|axis| axis.resolution).fold(0.0, f64::max)
    }
}

/// The part of a correction that is better than none where another one is needed; a difference of one step is none.
fn part(does: &PerAxis<f64>, needed: &PerAxis<f64>, step: f64) -> f64 {
    let norm = |values: &PerAxis<f64>| values.iter().map(|x| x * x).sum::<f64>().sqrt();
    let size = norm(does);
    let differs = norm(&PerAxis::from_fn(|i| does[i] - needed[i])) - step;
    if differs <= 0.5 * size {
        1.0
    } else {
        (2.0 * (1.0 - differs / size)).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever is needed within the distance, the part that is kept is no further from it than nothing is.
    #[test]
    fn what_is_kept_is_never_worse_than_nothing() {
        let of = |x: f64, y: f64| PerAxis::from_fn(|i| [x, y].get(i).copied().unwrap_or(0.0));
        for distance in [0.0, 0.3, 0.5, 0.6, 0.8, 0.99, 1.0, 1.5] {
            for degree in 0..360 {
                let (sin, cos) = f64::from(degree).to_radians().sin_cos();
                let (does, needed) = (of(1.0, 0.0), of(1.0 + distance * cos, distance * sin));
                let part = part(&does, &needed, 0.0);
                let left = (needed[0] - part).hypot(needed[1]);
                let without = needed[0].hypot(needed[1]);
                assert!(left <= without + 1e-12, "{distance} {degree}: {part}");
                assert_eq!(
                    part > 1.0 - 1e-9,
                    distance <= 0.5,
                    "{distance} {degree}: {part}"
                );
            }
        }
        assert_eq!(part(&of(0.0, 0.0), &of(0.0, 0.0), 0.0), 1.0);
        assert_eq!(
            part(&of(0.0, 0.0), &of(0.5, 0.0), 1.0),
            1.0,
            "within a step"
        );
        assert_eq!(part(&of(0.0, 0.0), &of(2.0, 0.0), 1.0), 0.0);
    }
}
