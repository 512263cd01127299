//! Direction of approach of each axis, axis reversals along a motion, and carriage positions within the backlash.

use volcomp_model::vocabulary::{Direction, MAX_AXES};

use crate::{coordinates::Axes, correction::Corrector};

/// Maximum movement of an axis at rest, mm or deg; smaller movements are rounding of coordinates.
pub(crate) const RESTING_WITHIN: f64 = 1e-7;
/// Fractions closer than this are treated as equal.
pub(crate) const SAME_SHARE: f64 = 1e-6;

/// Maximum error, mm, in locating turning points.
const REVERSAL_TOLERANCE_MM: f64 = 5e-5;

const MAX_STEPS: f64 = 1024.0;

/// How often the first and the last step are halved: to 1/16,000 of a turn of an arc.
const END_HALVINGS: i32 = 8;

/// A reversal of an axis. From its fraction of the motion on, the errors of the other direction
/// apply.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reversal {
    /// Fraction of the motion, 0 to 1.
    pub(crate) share: f64,
    pub(crate) axis: usize,
    pub(crate) side: Direction,
    /// Farthest known position of the axis in its new direction.
    pub(crate) furthest: f64,
    /// Farthest position of the axis in its old direction.
    before: f64,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Reversals {
    pub(crate) turns: Vec<Reversal>,
    pub(crate) furthest: Axes,
}

impl Reversals {
    /// Drops the reversals from this fraction on, which belong to the next motion.
    pub(crate) fn keep_before(&mut self, share: f64) {
        while let Some(turn) = self.turns.pop_if(|turn| turn.share >= share) {
            self.furthest[turn.axis] = turn.before;
        }
    }

    /// At the start of a motion, drops each reversal that is followed there by another one of the
    /// same axis.
    pub(crate) fn keep_last_at_start(&mut self) {
        let count = self.turns.iter().take_while(|turn| turn.share == 0.0);
        for place in (0..count.count()).rev() {
            let (turn, after) = (self.turns[place], &self.turns[place + 1..]);
            if (after.iter()).any(|next| next.share == 0.0 && next.axis == turn.axis) {
                self.turns.remove(place);
            }
        }
    }
}

/// Positions of drives and carriages (the play operator of each axis): a carriage rests until a flank of the backlash pushes it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Carriages {
    drive: Axes,
    arrives_from_unknown: Axes<bool>,
    /// Carriage minus drive position, mm or deg: at most half of the backlash. 0 (the middle) while the direction of approach is
    /// unknown.
    pub(crate) off: Axes,
}

impl Carriages {
    pub(crate) fn at(drive: &Axes) -> Self {
        Self { drive: *drive, arrives_from_unknown: [false; MAX_AXES], off: [0.0; 9] }
    }

    /// Sets the axes that arrive from an unknown position, until the next call; their carriages are assumed in the middle of the backlash.
    pub(crate) fn begin_motion(&mut self, from_unknown: &Axes<bool>) {
        self.arrives_from_unknown = *from_unknown;
    }

    /// Adds whole turns, deg, to the coordinates of unchanged rotary positions.
    pub(crate) fn apply_wraps(&mut self, by: &Axes) {
        for (drive, by) in self.drive.iter_mut().zip(by) {
            *drive += by;
        }
    }

    /// Moves the drives to a position; each axis moves in one direction.
    pub(crate) fn move_to(&mut self, truth: &Corrector, to: &Axes) {
        let from = std::mem::replace(&mut self.drive, *to);
        if !truth.play.any {
            return;
        }
        let lost = truth.lost_motion(to);
        for axis in 0..9 {
            if self.arrives_from_unknown[axis] {
                self.off[axis] = 0.0;
                continue;
            }
            let half = 0.5 * lost[axis];
            self.off[axis] = (from[axis] + self.off[axis] - to[axis]).clamp(-half, half);
        }
    }
}

impl Corrector {
    /// Directions of approach and furthest positions, to be restored by `put_back`.
    pub(crate) fn sides(&self) -> (Axes<Option<Direction>>, Axes) {
        (self.approach, self.furthest)
    }

    pub(crate) fn put_back(&mut self, (approach, furthest): (Axes<Option<Direction>>, Axes)) {
        self.version += u64::from(self.approach != approach);
        (self.approach, self.furthest) = (approach, furthest);
    }

    pub(crate) fn start_at(&mut self, at: &Axes) {
        self.approach = [None; MAX_AXES];
        let more = self.without_play(at);
        self.furthest = std::array::from_fn(|axis| at[axis] + more[axis]);
    }

    /// Sets the axes that arrive from an unknown position by the next motion; they lose their direction of approach.
    pub(crate) fn begin_motion(&mut self, from_unknown: &Axes<bool>) {
        if !self.bidirectional {
            return;
        }
        self.arrives_from_unknown = *from_unknown;
        for axis in (0..MAX_AXES).filter(|axis| from_unknown[*axis]) {
            self.version += u64::from(self.approach[axis].take().is_some());
        }
    }

    pub(crate) fn axes_with_unknown_approach(&self) -> impl Iterator<Item = usize> + use<> {
        let (has_directions, approach) = (self.has_directions, self.approach);
        (0..MAX_AXES).filter(move |axis| has_directions[*axis] && approach[*axis].is_none())
    }

    /// True if the axis has lost motion anywhere in its travel.
    pub(crate) fn lags(&self, axis: usize) -> bool {
        self.play.has(axis)
    }

    /// Axes with lost motion whose carriage position is known: it is at the flank of their direction of approach.
    pub(crate) fn axes_at_flank(&self) -> impl Iterator<Item = usize> {
        (0..MAX_AXES).filter(|axis| {
            self.lags(*axis) && self.corrects[*axis] && self.approach[*axis].is_some()
        })
    }

    pub(crate) fn set_furthest(&mut self, furthest: &Axes) {
        for axis in 0..MAX_AXES {
            if self.has(axis) {
                self.furthest[axis] = furthest[axis];
            }
        }
    }

    /// Adds whole turns, deg, to the coordinates of unchanged rotary positions.
    pub(crate) fn apply_wraps(&mut self, by: &Axes) {
        for (furthest, by) in self.furthest.iter_mut().zip(by) {
            *furthest += by;
        }
    }

    pub(crate) fn turn(&mut self, turn: &Reversal) {
        if self.approach[turn.axis] != Some(turn.side) {
            self.version += 1;
        }
        self.approach[turn.axis] = Some(turn.side);
        self.furthest[turn.axis] = turn.furthest;
    }

    /// Correction of the axes with lost motion at a position, without its backlash part. This correction moves the
    /// carriages, so a reversal of it crosses the backlash. 0 for the other axes, whose direction is that of the
    /// uncorrected command.
    pub(crate) fn without_play(&self, at: &Axes) -> Axes {
        if !self.play.any {
            return [0.0; MAX_AXES];
        }
        self.without_play_of(at, &self.at(at).delta)
    }

    /// Like [`without_play`](Self::without_play), with the correction at the position given as `delta`.
    pub(crate) fn without_play_of(&self, at: &Axes, delta: &Axes) -> Axes {
        let lost = self.lost_motion(at);
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

    /// Moves the axes to a position and updates their directions of approach; an axis that arrives from an unknown position gets none.
    /// Returns true if any direction changes.
    pub(crate) fn move_to(&mut self, to: &Axes) -> bool {
        if !self.bidirectional {
            return false;
        }
        let more = self.without_play(to);
        self.moved_to = *to;
        self.move_carriages(&std::array::from_fn(|axis| to[axis] + more[axis]))
    }

    /// Furthest position of each axis in its direction after a motion sampled in one step. `carriages` are the carriage
    /// positions at its end, without backlash. `None` if an axis reverses, or if the motion does not start where the
    /// last one ended.
    pub(crate) fn furthest_after(&self, from: &Axes, carriages: &Axes) -> Option<Axes> {
        if self.moved_to != *from {
            return None;
        }
        let mut furthest = self.furthest;
        for axis in self.axes() {
            let way = carriages[axis] - furthest[axis];
            let sign = self.approach[axis].map_or(-way.signum(), sign_of);
            if sign * way > 0.0 {
                furthest[axis] = carriages[axis];
            } else if way.abs() > self.turned_after[axis] {
                return None;
            }
        }
        Some(furthest)
    }

    /// Moves the axes to a position without a reversal; `furthest` is the result of
    /// [`furthest_after`](Self::furthest_after).
    pub(crate) fn go_on_to(&mut self, to: &Axes, furthest: Axes) {
        (self.moved_to, self.furthest) = (*to, furthest);
    }

    /// Tracks a motion whose end point `to` is not corrected. On an axis with backlash the carriage follows the drive
    /// only after the drive has crossed the backlash. `drives` are the machine coordinates before and after the motion,
    /// with the applied correction.
    pub(crate) fn move_uncorrected(&mut self, to: &Axes, drives: [&Axes; 2]) {
        if !self.bidirectional {
            return;
        }
        let lost = self.lost_motion(to);
        let here = std::array::from_fn(|axis| {
            let [before, after] = drives.map(|drive| drive[axis]);
            let (furthest, half) = (self.furthest[axis], 0.5 * lost[axis]);
            if !self.lags(axis) || !self.corrects[axis] {
                to[axis]
            } else if self.arrives_from_unknown[axis] {
                after
            } else if (after - before).abs() <= RESTING_WITHIN {
                furthest
            } else if self.approach[axis].is_none() {
                after - half.copysign(after - before)
            } else {
                after - (after - furthest).clamp(-half, half)
            }
        });
        self.move_carriages(&here);
    }

    /// Moves the carriages, without their backlash, to a position. Returns true if any axis reverses.
    fn move_carriages(&mut self, to: &Axes) -> bool {
        let before = self.approach;
        for axis in 0..MAX_AXES {
            let after = self.turned_after[axis];
            let here = to[axis];
            if std::mem::take(&mut self.arrives_from_unknown[axis]) {
                self.furthest[axis] = here;
                continue;
            }
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

    /// Carriage positions along a motion with the positions `at`. The positions of axes with lost motion include the
    /// correction, sampled in `steps` steps and interpolated linearly.
    pub(crate) fn carriages(&self, steps: u32, at: impl Fn(f64) -> Axes) -> impl Fn(f64) -> Axes {
        let share = |step: u32| f64::from(step) / f64::from(steps);
        let more: Vec<Axes> = if self.play.any {
            (0..=steps).map(|step| self.without_play(&at(share(step)))).collect()
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

    /// Reversals of the axes along a motion. `at` returns the positions for fractions from 0 to 1,
    /// and is sampled in `steps` steps, closer near the ends. A reversal is located at the extreme position, and is
    /// reported once the axis has moved back by the minimum reverse travel. At the start, the
    /// extreme of the previous motions is used.
    pub(crate) fn turns(&self, steps: u32, at: impl Fn(f64) -> Axes) -> Reversals {
        let mut turns = Vec::new();
        let mut furthest_of = self.furthest;
        if !self.bidirectional {
            return Reversals::default();
        }
        let shares = shares_of(steps);
        let places: Vec<Axes> = shares.iter().map(|share| at(*share)).collect();
        let has_start = |axis: &usize| self.has(*axis) && !self.arrives_from_unknown[*axis];
        for axis in (0..MAX_AXES).filter(has_start) {
            let after = self.turned_after[axis];
            let (side, mut furthest) = (self.approach[axis], self.furthest[axis]);
            let mut side = side;
            let mut of_furthest = 0;
            // Start of the motion, if the axis reverses there but its furthest position is still before the start: the
            // axis first moves on to the start.
            let mut goes_on = None;
            for (step, place) in places.iter().enumerate() {
                let here = place[axis];
                let way = here - furthest;
                let sign = side.map_or(-way.signum(), sign_of);
                if sign * way > 0.0 {
                    if step == 0 && way.abs() > after {
                        goes_on = side.map(|side| (side, here, furthest));
                    }
                    (furthest, of_furthest) = (here, step);
                    continue;
                }
                if way.abs() <= after {
                    continue;
                }
                let value = |share: f64| sign * at(share)[axis];
                // Ternary search around the sample: it brackets a single extremum.
                let (mut low, mut high) =
                    (shares[of_furthest.saturating_sub(1)], shares[(of_furthest + 1).min(step)]);
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
                let share = if low < SAME_SHARE { 0.0 } else { low };
                if let Some((side, furthest, before)) = goes_on.take()
                    && share == 0.0
                {
                    turns.push(Reversal { share, axis, side, furthest, before });
                }
                turns.push(Reversal {
                    share,
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
            if turns[i].share - turns[i - 1].share < SAME_SHARE {
                turns[i].share = turns[i - 1].share;
            }
        }
        let mut found = Reversals { turns, furthest: furthest_of };
        found.keep_before(1.0 - SAME_SHARE);
        found
    }
}

/// Fractions at which a motion is sampled: `steps` equal steps, the first and the last of them halved again and again.
/// Otherwise the sample before the end would hide an extreme between the two, and the reversal behind it.
fn shares_of(steps: u32) -> Vec<f64> {
    let halvings = if steps > 1 { END_HALVINGS } else { 0 };
    let near = |halving: i32| 0.5_f64.powi(halving) / f64::from(steps);
    let within = (1..steps).map(|step| f64::from(step) / f64::from(steps));
    let start = (1..=halvings).rev().map(near);
    let end = (1..=halvings).map(|halving| 1.0 - near(halving));
    [0.0].into_iter().chain(start).chain(within).chain(end).chain([1.0]).collect()
}

/// Number of sampling steps that misses no reversal on a motion whose axes deviate from a straight line by at most
/// `bulge_mm`.
pub(crate) fn steps_of(bulge_mm: f64) -> f64 {
    (bulge_mm / REVERSAL_TOLERANCE_MM).sqrt().clamp(1.0, MAX_STEPS)
}

fn side_of(way: f64) -> Direction {
    if way > 0.0 { Direction::Positive } else { Direction::Negative }
}

fn sign_of(side: Direction) -> f64 {
    match side {
        Direction::Positive => 1.0,
        Direction::Negative => -1.0,
    }
}
