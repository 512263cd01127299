//! The control's half: which frame it takes, and how long none came.

use super::{Head, Refusal, is_ahead};

/// The numbers that a control publishes and by which it takes frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Link {
    /// Moves on at each start and at each time-out.
    pub epoch: u16,
    /// The number of scans, which wraps around.
    pub tick: u16,
    /// The sender whose frames are taken; 0: anybody's.
    pub owner: u16,
    /// The sequence of the last frame that was taken.
    pub sequence: u16,
    /// The number of scans since a frame was taken; it stands still at the time-out.
    pub silent: u16,
}

impl Link {
    /// The link of a control after power-up or a reset. `epoch` is the one that was kept over power-off: it moves on here, so
    /// that no frame made before can be taken.
    #[must_use]
    pub fn start(epoch: u16, tick: u16) -> Self {
        Self {
            epoch: epoch.wrapping_add(1),
            tick,
            ..Self::default()
        }
    }

    /// Counts a scan.
    pub fn scan(&mut self) {
        self.tick = self.tick.wrapping_add(1);
    }

    /// Whether a whole frame is to be taken, if what it says can be; `false`: it was judged before, or is the one that was taken
    /// last.
    ///
    /// `found` are tick and sequence of the whole frame that was found last in the same mailbox. A frame that nobody overwrites
    /// lies there for ever: judged again it would be taken once tick and sequence have gone round.
    ///
    /// # Errors
    /// Why it is refused.
    pub fn judge(
        &self,
        head: Head,
        found: &mut Option<(u16, u16)>,
        hold_scans: u16,
    ) -> Result<bool, Refusal> {
        let this = Some((head.tick, head.sequence));
        if core::mem::replace(found, this) == this {
            return Ok(false);
        }
        let is_held = self.owner != 0;
        if head.epoch != self.epoch {
            return Err(Refusal::Epoch);
        }
        if head.owner == 0 || is_held && head.owner != self.owner {
            return Err(Refusal::Owner);
        }
        if is_held && head.sequence == self.sequence {
            return Ok(false);
        }
        if self.tick.wrapping_sub(head.tick) > hold_scans {
            return Err(Refusal::Tick);
        }
        if is_held && !is_ahead(head.sequence, self.sequence) {
            return Err(Refusal::Sequence);
        }
        Ok(true)
    }

    /// Takes a frame: from now on its sender holds the control.
    pub fn take(&mut self, head: Head) {
        self.owner = head.owner;
        self.sequence = head.sequence;
    }

    /// Counts a scan in which no frame was taken. At the time-out, once, it sets the control free, begins a new epoch, so that no
    /// frame that was made before can be taken any more, and says so.
    pub fn is_timed_out(&mut self, time_out_scans: u16) -> bool {
        if self.silent >= time_out_scans {
            return false;
        }
        self.silent += 1;
        let is_over = self.silent == time_out_scans;
        if is_over {
            self.epoch = self.epoch.wrapping_add(1);
            self.owner = 0;
        }
        is_over
    }
}
