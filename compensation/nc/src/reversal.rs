//! From which side each axis comes to where it is, where axes turn on a way, and where carriages with play are.

use volcomp_model::vocabulary::{Direction, MAX_AXES};

use crate::{coordinates::Axes, correction::Corrector};

/// Shares that are nearer to one another are one.
pub(crate) const SAME: f64 = 1e-6;

/// Turning points are met to this, mm.
const MET_WITHIN_MM: f64 = 5e-5;

const MOST_STEPS: f64 = 1024.0;

/// An axis turns: from here on its errors are those of the other direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Turn {
    /// Where on the way, from 0 to 1.
    pub(crate) share: f64,
    pub(crate) axis: usize,
    pub(crate) side: Direction,
    /// The furthest place of the axis in its new direction that is known so far.
    pub(crate) furthest: f64,
    /// That in its old direction.
    before: f64,
}

/// What axes do on a way.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Turns {
    pub(crate) turns: Vec<Turn>,
    /// The furthest place of each axis in the direction that it has at the end.
    pub(crate) furthest: Axes,
}

impl Turns {
    /// Leaves the turns behind this share to the next motion.
    pub(crate) fn keep_before(&mut self, share: f64) {
        while let Some(turn) = self.turns.pop_if(|turn| turn.share >= share) {
            self.furthest[turn.axis] = turn.before;
        }
    }
}

/// State: the play operator of each axis. A carriage stays where it is until the flank behind or before it takes it along.
#[derive(Clone, Debug, Default)]
pub(crate) struct Carriages {
    drive: Axes,
    /// The carriage from where its drive is, mm or deg: half of the play at the most. In the middle, while it is not known how the
    /// axis came to where it is.
    pub(crate) off: Axes,
}

impl Carriages {
    /// The drives stand here, and it is not known how they came.
    pub(crate) fn at(drive: &Axes) -> Self {
        Self {
            drive: *drive,
            off: [0.0; 9],
        }
    }

    /// Rotary axes are where they were, which has another number now, deg.
    pub(crate) fn wraps(&mut self, by: &Axes) {
        for (drive, by) in self.drive.iter_mut().zip(by) {
            *drive += by;
        }
    }

    /// The drives go to this place; each axis goes in one direction.
    pub(crate) fn go(&mut self, truth: &Corrector, to: &Axes) {
        let from = std::mem::replace(&mut self.drive, *to);
        let lost = truth.lost(to);
        for axis in 0..9 {
            let half = 0.5 * lost[axis];
            self.off[axis] = (from[axis] + self.off[axis] - to[axis]).clamp(-half, half);
        }
    }
}

impl Corrector {
    /// From which side the axes come, to be put back.
    pub(crate) fn sides(&self) -> (Axes<Option<Direction>>, Axes) {
        (self.approach, self.furthest)
    }

    pub(crate) fn put_back(&mut self, (approach, furthest): (Axes<Option<Direction>>, Axes)) {
        self.version += u64::from(self.approach != approach);
        (self.approach, self.furthest) = (approach, furthest);
    }

    /// The axes begin here, with no direction yet.
    pub(crate) fn begins(&mut self, at: &Axes) {
        self.approach = [None; MAX_AXES];
        let more = self.without_play(at);
        self.furthest = std::array::from_fn(|axis| at[axis] + more[axis]);
    }

    /// Whether the carriage of an axis lags somewhere.
    pub(crate) fn lags(&self, axis: usize) -> bool {
        self.play.has(axis)
    }

    /// The axes have been so far, each in its direction.
    pub(crate) fn reaches(&mut self, furthest: &Axes) {
        for axis in 0..MAX_AXES {
            if self.has(axis) {
                self.furthest[axis] = furthest[axis];
            }
        }
    }

    /// Rotary axes are where they were, which has another number now, deg.
    pub(crate) fn wraps(&mut self, by: &Axes) {
        for (furthest, by) in self.furthest.iter_mut().zip(by) {
            *furthest += by;
        }
    }

    pub(crate) fn turn(&mut self, turn: &Turn) {
        if self.approach[turn.axis] != Some(turn.side) {
            self.version += 1;
        }
        self.approach[turn.axis] = Some(turn.side);
        self.furthest[turn.axis] = turn.furthest;
    }

    /// What is added to the axes at a place besides their play: the carriage of an axis that lags goes with it, and where that turns, the
    /// play is to be taken up. 0 for the others, whose direction is that of the command without its correction.
    pub(crate) fn without_play(&self, at: &Axes) -> Axes {
        if !self.play.any {
            return [0.0; MAX_AXES];
        }
        let (delta, lost) = (self.at(at).delta, self.lost(at));
        std::array::from_fn(|axis| {
            if !self.lags(axis) || !self.corrects[axis] {
                return 0.0;
            }
            match self.approach[axis] {
                Some(Direction::Positive) => delta[axis] - 0.5 * lost[axis],
                Some(Direction::Negative) => delta[axis] + 0.5 * lost[axis],
                None => delta[axis],
            }
        })
    }

    /// The axes go to this place: from now on they come from that side. Whether one of them turns.
    pub(crate) fn goes(&mut self, to: &Axes) -> bool {
        if !self.bidirectional {
            return false;
        }
        let before = self.approach;
        let more = self.without_play(to);
        for axis in 0..MAX_AXES {
            let after = self.turned_after[axis];
            let here = to[axis] + more[axis];
            let way = here - self.furthest[axis];
            let on = match self.approach[axis] {
                Some(Direction::Positive) => way > 0.0 || way < -after,
                Some(Direction::Negative) => way < 0.0 || way > after,
                None => way.abs() > after,
            };
            if on && way != 0.0 {
                self.furthest[axis] = here;
                self.approach[axis] = Some(side_of(way));
            }
        }
        let turns = self.approach != before;
        self.version += u64::from(turns);
        turns
    }

    /// Where the axes are to be on a way whose places `at` gives: with their correction where the carriage lags, which is looked at in so
    /// many steps and goes straight between them.
    pub(crate) fn carriages(&self, steps: u32, at: impl Fn(f64) -> Axes) -> impl Fn(f64) -> Axes {
        let share = |step: u32| f64::from(step) / f64::from(steps);
        let more: Vec<Axes> = if self.play.any {
            (0..=steps)
                .map(|step| self.without_play(&at(share(step))))
                .collect()
        } else {
            Vec::new()
        };
        move |share| {
            let place = at(share);
            let along = share * f64::from(steps);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a share of the steps"
            )]
            let step = along as usize;
            match more.get(step..) {
                Some([before, behind, ..]) => {
                    let of_step = along - step as f64;
                    std::array::from_fn(|axis| {
                        place[axis] + before[axis] + of_step * (behind[axis] - before[axis])
                    })
                }
                Some([last]) => std::array::from_fn(|axis| place[axis] + last[axis]),
                _ => place,
            }
        }
    }

    /// The turns of the axes on a way, whose places `at` gives for shares from 0 to 1, looked at in so many steps. An axis turns where
    /// it is furthest, once it has gone back by what counts as turning; at the beginning, where it was furthest before.
    pub(crate) fn turns(&self, steps: u32, at: impl Fn(f64) -> Axes) -> Turns {
        let mut turns = Vec::new();
        let mut furthest_of = [0.0; MAX_AXES];
        if !self.bidirectional {
            return Turns::default();
        }
        let share = |step: u32| f64::from(step) / f64::from(steps);
        let places: Vec<Axes> = (0..=steps).map(|step| at(share(step))).collect();
        for axis in (0..MAX_AXES).filter(|axis| self.has(*axis)) {
            let after = self.turned_after[axis];
            let (side, mut furthest) = (self.approach[axis], self.furthest[axis]);
            let mut side = side;
            let mut of_furthest = 0;
            for step in 0..=steps {
                let here = places[step as usize][axis];
                let way = here - furthest;
                let sign = side.map_or(-way.signum(), sign_of);
                if sign * way > 0.0 {
                    (furthest, of_furthest) = (here, step);
                    continue;
                }
                if way.abs() <= after {
                    continue;
                }
                let value = |share: f64| sign * at(share)[axis];
                // By thirds around it: one extremum is there.
                let (mut low, mut high) = (
                    share(of_furthest.saturating_sub(1)),
                    share((of_furthest + 1).min(step)),
                );
                let rounds = if steps > 1 { 40 } else { 0 };
                for _ in 0..rounds {
                    let (first, second) = ((2.0 * low + high) / 3.0, (low + 2.0 * high) / 3.0);
                    if value(first) < value(second) {
                        low = first;
                    } else {
                        high = second;
                    }
                }
                let turned = side_of(way);
                turns.push(Turn {
                    share: if low < SAME { 0.0 } else { low },
                    axis,
                    side: turned,
                    furthest: here,
                    before: furthest,
                });
                (side, furthest, of_furthest) = (Some(turned), here, step);
            }
            furthest_of[axis] = furthest;
        }
        turns.sort_by(|a, b| a.share.total_cmp(&b.share));
        for i in 1..turns.len() {
            if turns[i].share - turns[i - 1].share < SAME {
                turns[i].share = turns[i - 1].share;
            }
        }
        let mut found = Turns {
            turns,
            furthest: furthest_of,
        };
        found.keep_before(1.0 - SAME);
        found
    }
}

/// In how many steps a way that bends by this is to be followed so that no turning point is missed.
pub(crate) fn steps_of(bulge_mm: f64) -> f64 {
    (bulge_mm / MET_WITHIN_MM).sqrt().clamp(1.0, MOST_STEPS)
}

fn side_of(way: f64) -> Direction {
    if way > 0.0 {
        Direction::Positive
    } else {
        Direction::Negative
    }
}

fn sign_of(side: Direction) -> f64 {
    match side {
        Direction::Positive => 1.0,
        Direction::Negative => -1.0,
    }
}
