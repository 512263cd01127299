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
/// How long a reduction is reported: at speed it changes at every position.
const REPORTED_FOR: Duration = Duration::from_secs(2);
/// The maximum time of a look ahead.
const MAX_AHEAD: Duration = Duration::from_secs(10);

/// The interval at which what was wanted is remembered, and how many of these.
const SPACING: Duration = Duration::from_millis(10);
const REMEMBERED: usize = 3;
/// Nothing is reduced ahead where what was wanted differed from what is wanted now by at most this part of it, on a stretch
/// that is as long as what is ahead; on a longer one, by as much more, up to `MOST_CHANGE`. What changed along the stretch as
/// a parabola does then changes ahead by at most eleven times as much, which is less than half of it.
const CALM_CHANGE: f64 = 1.0 / 32.0;
const MOST_CHANGE: f64 = 1.0 / 8.0;

/// How fast the axes go, and the reduction because of it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lag {
    /// Positions, and when they held.
    before: Option<(PerAxis<f64>, Duration)>,
    /// What was wanted, and when its positions held; the youngest first.
    wanted: [Option<(ModelWanted, Duration)>; REMEMBERED],
    /// mm/s and rad/s.
    speed: PerAxis<f64>,
    /// When the correction was reduced last.
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
        let ahead = ahead.min(MAX_AHEAD);
        let taken = now.saturating_sub(age);
        let moves = self.speed.iter().any(|speed| *speed != 0.0);
        let part = if moves && !self.is_calm(asked, taken, ahead) {
            asked.part_ahead(&self.speed, ahead)
        } else {
            1.0
        };
        self.remember(asked.wanted, taken);
        self.goes_out = stale && (self.goes_out || part < 1.0);
        if part < 1.0 {
            self.last = Some(now);
        }
        let told = self
            .last
            .is_some_and(|last| now.saturating_sub(last) <= REPORTED_FOR);
        Kept {
            part,
            let_go: self.goes_out,
            notes: Reasons::LET_GO.when(told),
        }
    }
}

impl Lag {
    /// Whether what is wanted changed so little on the way to here, positions being those of `taken`, that a look ahead
    /// would find nothing to reduce: it costs as much as all else of a cycle.
    fn is_calm(&self, asked: &Asked<'_>, taken: Duration, ahead: Duration) -> bool {
        let Some((_, begun)) = self.wanted[REMEMBERED - 1] else {
            return false;
        };
        let stretch = taken.saturating_sub(begun);
        // Near a singular pose shares begin and end all at once, and at a node a curve may bend: what was wanted before it
        // says nothing about what comes after it.
        let may_bend = |(axis, (at, speed)): (usize, (&f64, &f64))| {
            let [from, to] = [-stretch.as_secs_f64(), ahead.as_secs_f64()].map(|s| at + speed * s);
            from != to && asked.model.may_bend_between(axis, from, to)
        };
        let mut axes = asked.state.q.iter().zip(&self.speed).enumerate();
        let wanted = asked.wanted;
        if ahead > stretch
            || stretch.is_zero()
            || wanted.near_singular
            || wanted.linear_near_singular
            || axes.any(may_bend)
        {
            return false;
        }
        let part = ahead.as_secs_f64() / stretch.as_secs_f64();
        let most = (CALM_CHANGE / part).min(MOST_CHANGE);
        let mut past = self.wanted.iter().flatten();
        past.all(|(then, _)| {
            asked
                .against(then)
                .iter()
                .all(|against| against.is_within(most))
        })
    }

    fn remember(&mut self, wanted: &ModelWanted, taken: Duration) {
        let is_due = |(_, last): (_, Duration)| taken.saturating_sub(last) >= SPACING;
        if self.wanted[0].is_none_or(is_due) {
            self.wanted.rotate_right(1);
            self.wanted[0] = Some((*wanted, taken));
        }
    }

    /// Another model asks for something else.
    pub(super) fn forget(&mut self) {
        self.wanted = [None; REMEMBERED];
    }
}

impl Asked<'_> {
    /// The part that is better than none wherever the axes are on their way with this speed for this time.
    fn part_ahead(&self, speed: &PerAxis<f64>, ahead: Duration) -> f64 {
        // Half the way as well: what comes round again is not the same on the way.
        let half = self.part_after(speed, ahead / 2);
        half.min(self.part_after(speed, ahead))
    }

    /// The part that is better than none when the axes have gone on with this speed for `time`.
    fn part_after(&self, speed: &PerAxis<f64>, time: Duration) -> f64 {
        let mut there = *self.state;
        for (q, speed) in there.q.iter_mut().zip(speed) {
            *q += speed * time.as_secs_f64();
        }
        let model = self.model;
        let then = model.wanted_by(self.only_thermal, &there, self.correctors, self.applied);
        let [linear, rotary] = self.against(&then).map(|against| against.part());
        linear.min(rotary)
    }

    /// The correction of now where another one is needed, the linear axes and the rotary ones.
    fn against(&self, then: &ModelWanted) -> [Against; 2] {
        let now = self.wanted;
        // What the linear shares of now do to the position there: the levers of the rotary shares are others.
        let mut does = now.position;
        let rows = now.follow.iter().zip(&then.follow).zip(&now.rotary);
        for ((now, then), share) in rows.filter(|(_, share)| **share != 0.0) {
            for ((does, now), then) in does.iter_mut().zip(now).zip(then) {
                *does += (now - then) * share;
            }
        }
        [
            Against::new(&does, &then.position, self.step(AxisKind::Linear)),
            Against::new(&now.rotary, &then.rotary, self.step(AxisKind::Rotary)),
        ]
    }

    /// The largest step of the axes of a kind.
    fn step(&self, kind: AxisKind) -> f64 {
        let axes = self.limits.axes.iter().take(self.limits.count);
        let of_kind = axes.filter(|axis| axis.kind == kind);
        of_kind.map(|axis| axis.resolution).fold(0.0, f64::max)
    }
}

/// A correction where another one is needed; a difference of one step does not count.
struct Against {
    size: f64,
    differs: f64,
    step: f64,
}

impl Against {
    fn new(does: &PerAxis<f64>, needed: &PerAxis<f64>, step: f64) -> Self {
        let norm = |values: &PerAxis<f64>| values.iter().map(|x| x * x).sum::<f64>().sqrt();
        Self {
            size: norm(does),
            differs: norm(&PerAxis::from_fn(|i| does[i] - needed[i])),
            step,
        }
    }

    /// The part of the correction that is better than none.
    fn part(&self) -> f64 {
        let differs = self.differs - self.step;
        if differs <= 0.5 * self.size {
            1.0
        } else {
            (2.0 * (1.0 - differs / self.size)).max(0.0)
        }
    }

    /// Whether it differs by no more than this part, 0.5 being the one above which it is reduced.
    fn is_within(&self, part: f64) -> bool {
        self.differs <= part * (self.size + 2.0 * self.step)
    }
}

#[cfg(test)]
mod tests;
