//! Where the carriages of a virtual machine are while its drives go where they are commanded.

use crate::{coordinates::Axes, correction::Corrector};

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
