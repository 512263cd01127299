//! In which direction an axis came to where it is.

use volcomp_vocabulary::Direction;

/// The direction of the last motion of an axis, kept while it stands: it changes only after travel over a
/// threshold from the last extreme, so that neither noise nor a correction turns it. State: the extreme and the
/// direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DirectionMemory {
    extreme: Option<f64>,
    direction: Option<Direction>,
}

impl DirectionMemory {
    /// The axis is at `position` without correction, mm or rad; `None` until it went further than the
    /// threshold.
    pub fn at(&mut self, position: f64, threshold: f64) -> Option<Direction> {
        if !position.is_finite() {
            return self.direction;
        }
        let extreme = *self.extreme.get_or_insert(position);
        let forward = position - extreme;
        match self.direction {
            Some(Direction::Positive) if forward >= 0.0 => self.extreme = Some(position),
            Some(Direction::Negative) if forward <= 0.0 => self.extreme = Some(position),
            _ if forward.abs() > threshold => {
                self.direction = Direction::of(forward);
                self.extreme = Some(position);
            }
            _ => {}
        }
        self.direction
    }
}
