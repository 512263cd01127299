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

/// What was wanted is remembered so often, and so many times.
const SPACING: Duration = Duration::from_millis(10);
const REMEMBERED: usize = 3;
/// Nothing is let go ahead where what was wanted differed from what is wanted now by this part of it at the most, on a stretch
/// that is as long as what is ahead; on a longer one, by as much more, up to `MOST_CHANGE`. What changed along the stretch as
/// a parabola does then changes ahead by at most eleven times as much, which is less than half of it.
const CALM_CHANGE: f64 = 1.0 / 32.0;
const MOST_CHANGE: f64 = 1.0 / 8.0;

/// How fast the axes go, and what is let go because of it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lag {
    /// Positions, and when they held.
    before: Option<(PerAxis<f64>, Duration)>,
    /// What was wanted, and when its positions held; the youngest first.
    wanted: [Option<(ModelWanted, Duration)>; REMEMBERED],
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
            .is_some_and(|last| now.saturating_sub(last) <= TOLD);
        Kept {
            part,
            let_go: self.goes_out,
            notes: Reasons::LET_GO.when(told),
        }
    }
}

impl Lag {
    /// Whether what is wanted changed so little on the way to here, positions being those of `taken`, that a look ahead
    /// would find nothing to let go: it costs as much as all else of a cycle.
    fn is_calm(&self, asked: &Asked<'_>, taken: Duration, ahead: Duration) -> bool {
        let Some((_, begun)) = self.wanted[REMEMBERED - 1] else {
            return false;
        };
        let stretch = taken.saturating_sub(begun);
        // Near a singular pose shares begin and end all at once, and at a node a curve may bend: what was wanted before it
        // tells nothing of what will be behind it.
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
    /// The part that is better than none wherever the axes are on their way with this speed for so long.
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

/// A correction where another one is needed; a difference of one step is none.
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

    /// Whether it differs by no more than this part, 0.5 being the one above which something is let go.
    fn is_within(&self, part: f64) -> bool {
        self.differs <= part * (self.size + 2.0 * self.step)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use volcomp_guard::AxisLimits;
    use volcomp_model::{Fading, Machine};
    use volcomp_vocabulary::PerChannel;

    use super::*;

    /// Whatever is needed within the distance, the part that is kept is no further from it than nothing is.
    #[test]
    fn what_is_kept_is_never_worse_than_nothing() {
        let of = |x: f64, y: f64| PerAxis::from_fn(|i| [x, y].get(i).copied().unwrap_or(0.0));
        for distance in [0.0, 0.3, 0.5, 0.6, 0.8, 0.99, 1.0, 1.5] {
            for degree in 0..360 {
                let (sin, cos) = f64::from(degree).to_radians().sin_cos();
                let (does, needed) = (of(1.0, 0.0), of(1.0 + distance * cos, distance * sin));
                let part = Against::new(&does, &needed, 0.0).part();
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
        let part = |needed, step| Against::new(&of(0.0, 0.0), &of(needed, 0.0), step).part();
        assert_eq!(part(0.0, 0.0), 1.0);
        assert_eq!(part(0.5, 1.0), 1.0, "within a step");
        assert_eq!(part(2.0, 1.0), 0.0);
    }

    /// A machine with a rotary table and a head, its errors polynomials and waves of some millimetres and degrees.
    fn random_model(random: &mut ChaCha8Rng) -> Model {
        let mut number = |size: f64| random.random_range(-size..=size);
        let mut text =
            "structure = \"w C' X' b Y Z B t\"\n[tool]\ntip = [0.0, 0.0, -120.0]\n".to_owned();
        for (axis, half) in [("X", 400), ("Y", 400), ("Z", 400), ("B", 110), ("C", 180)] {
            let point = [number(200.0), number(200.0), number(200.0)];
            text += &format!("[axes.{axis}]\ntravel = [-{half}, {half}]\npoint = {point:?}\n");
        }
        text += "[errors]\n";
        for (axis, half) in [("X", 400), ("Y", 400), ("Z", 400), ("B", 110), ("C", 180)] {
            let half: i32 = half;
            for error in ["EX", "EY", "EZ", "EA", "EB", "EC"] {
                let size = 10.0 * number(1.0).abs();
                let of = [number(size), number(size), number(size)];
                let kind = number(1.5);
                text += &if kind > 0.5 {
                    let nodes =
                        (-(half / 20)..=half / 20).map(|n| [f64::from(20 * n), number(size)]);
                    let table: Vec<_> = nodes.collect();
                    format!("{error}{axis} = {{ table = {table:?} }}\n")
                } else if kind > -0.5 {
                    let period = 10.0_f64.powf(1.0 + number(1.0).abs());
                    format!("{error}{axis} = {{ fourier = {of:?}, period = {period:?} }}\n")
                } else {
                    format!(
                        "{error}{axis} = {{ chebyshev = {of:?}, domain = [-{half}, {half}] }}\n"
                    )
                };
            }
        }
        let machine = Machine::parse(&text, "m").expect("valid");
        Model::new(&machine, Fading::default()).expect("compiles")
    }

    /// How often a look ahead was spared, and taken; how often it let something go; and the least part that one would have
    /// left where it was spared.
    #[derive(Debug)]
    struct Looks {
        spared: u32,
        taken: u32,
        let_go: u32,
        least: f64,
    }

    /// Looks ahead, or spares it, with the axes here at this time.
    fn look(
        lag: &mut Lag,
        looks: &mut Looks,
        model: &Model,
        q: PerAxis<f64>,
        now: Duration,
        ahead: Duration,
    ) {
        let axes = std::array::from_fn(|i| {
            let axis = AxisLimits::NONE;
            model.axes.get(i).map_or(axis, |name| AxisLimits {
                kind: name.kind(),
                resolution: if name.is_rotary() { 1e-6 } else { 1e-4 },
                ..axis
            })
        });
        let limits = Limits {
            axes,
            count: model.axes.len(),
            period: Duration::from_millis(4),
            hold: Duration::from_millis(50),
            zero_after: Duration::from_millis(500),
            ramp: Duration::from_millis(500),
            test_shift: PerChannel::ZERO,
            read_back_cycles: 1,
            only_thermal: false,
        };
        let place = Place {
            positions: q,
            oldest: Some(now),
            ..Place::default()
        };
        lag.see(&place, model);
        let state = State {
            q,
            ..State::default()
        };
        let correctors = model.correctors_among(&model.axes);
        let wanted = model.wanted(&state, &correctors, &PerAxis::ZERO);
        let asked = Asked {
            model,
            correctors: &correctors,
            only_thermal: false,
            limits: &limits,
            way_out: Duration::ZERO,
            state: &state,
            wanted: &wanted,
            applied: &PerAxis::ZERO,
        };
        let part = asked.part_ahead(&lag.speed, ahead);
        looks.let_go += u32::from(part < 1.0);
        if lag.is_calm(&asked, now, ahead) {
            looks.spared += 1;
            looks.least = looks.least.min(part);
        } else {
            looks.taken += 1;
        }
        lag.remember(&wanted, now);
    }

    const NO_LOOKS: Looks = Looks {
        spared: 0,
        taken: 0,
        let_go: 0,
        least: 1.0,
    };

    /// Where a look ahead is spared it would have let nothing go: on random machines, and on paths with corners and ramps of
    /// speed.
    #[test]
    fn a_look_ahead_that_is_spared_would_let_nothing_go() {
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let mut looks = NO_LOOKS;
        for _ in 0..60 {
            let model = random_model(&mut random);
            for _ in 0..20 {
                let period_s = 10.0_f64.powf(random.random_range(-3.0..-1.8));
                let feed = 10.0_f64.powf(random.random_range(0.0..2.9));
                let ahead = Duration::from_secs_f64(period_s * random.random_range(1.0..8.0));
                let [mut q, mut speed, mut goal] = [PerAxis::ZERO; 3];
                for (q, name) in q.iter_mut().zip(&model.axes) {
                    let most = if name.is_rotary() { 1.5 } else { 300.0 };
                    *q = random.random_range(-most..most);
                }
                let mut lag = Lag::default();
                for cycle in 0..150_u32 {
                    for (axis, name) in model.axes.iter().enumerate() {
                        let scale = if name.is_rotary() { 0.005 } else { 1.0 };
                        if cycle % 40 == 0 {
                            let moves = random.random_bool(0.6);
                            let part = random.random_range(-1.0..1.0);
                            goal[axis] = if moves { part * feed * scale } else { 0.0 };
                        }
                        // With 5 m/s², and as much for rotary axes.
                        let most = 5000.0 * period_s * scale;
                        speed[axis] += (goal[axis] - speed[axis]).clamp(-most, most);
                        q[axis] += speed[axis] * period_s;
                    }
                    let now = Duration::from_secs_f64(1.0 + f64::from(cycle) * period_s);
                    look(&mut lag, &mut looks, &model, q, now, ahead);
                }
            }
        }
        println!("{looks:?}");
        assert!(looks.least >= 1.0, "{looks:?}");
        assert!(looks.spared > 50_000 && looks.let_go > 5_000, "{looks:?}");
    }

    /// A curve that is flat up to a node and steep behind it: what changed until now tells nothing of that.
    #[test]
    fn a_look_ahead_is_not_spared_before_a_curve_bends() {
        let text = "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 400]\nY.travel = [0, 400]\nZ.travel = [0, 400]\n[errors]\nEXX = { table = [[0.0, 10.0], [200.0, 10.0], [204.0, -10.0], [400.0, -10.0]] }\n";
        let machine = Machine::parse(text, "m").expect("valid");
        let model = Model::new(&machine, Fading::default()).expect("compiles");
        let (mut lag, mut looks) = (Lag::default(), NO_LOOKS);
        for ms in 0..1000_u32 {
            let at = f64::from(ms) * 0.3;
            let q = PerAxis::from_fn(|axis| if axis == 0 { at } else { 100.0 });
            let now = Duration::from_millis(u64::from(ms));
            look(
                &mut lag,
                &mut looks,
                &model,
                q,
                now,
                Duration::from_millis(12),
            );
        }
        println!("{looks:?}");
        assert!(looks.least >= 1.0 && looks.let_go > 5, "{looks:?}");
        assert!(looks.spared > 900, "{looks:?}");
    }
}
