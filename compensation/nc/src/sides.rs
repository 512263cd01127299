//! From which side each axis comes to where it is.

use volcomp_model::vocabulary::{Direction, MAX_AXES};

use crate::{
    coordinates::Axes,
    correction::Corrector,
    turns::{Turn, side_of},
};

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

    /// From which side an axis comes, and its furthest place.
    pub(crate) fn side(&self, axis: usize) -> (Option<Direction>, f64) {
        (self.approach[axis], self.furthest[axis])
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

    /// An axis turns.
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
}
