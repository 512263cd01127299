//! The direction in which an axis travelled last.

use volcomp_vocabulary::Direction;

/// Where an axis was furthest in its direction: it counts as turned only after a travel back from there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Travel {
    extreme: i32,
    direction: Option<Direction>,
}

impl Travel {
    pub(super) fn at(position: i32) -> Self {
        Self {
            extreme: position,
            direction: None,
        }
    }

    /// The direction at a position, which is within ±1e9 steps.
    pub(super) fn direction(&mut self, position: i32, turned: i32) -> Option<Direction> {
        let beyond = position - self.extreme;
        let (onward, back) = match self.direction {
            Some(Direction::Positive) => (beyond > 0, beyond <= -turned),
            Some(Direction::Negative) => (beyond < 0, beyond >= turned),
            None => (false, beyond.abs() >= turned),
        };
        if back {
            self.direction = if beyond > 0 {
                Some(Direction::Positive)
            } else {
                Some(Direction::Negative)
            };
        }
        if onward || back {
            self.extreme = position;
        }
        self.direction
    }
}
