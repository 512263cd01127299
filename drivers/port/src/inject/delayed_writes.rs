use volcomp_vocabulary::PerChannel;

use crate::Words;

/// Maximum number of delayed writes. Further writes are delivered at once.
const MAX_DELAYED: usize = 8;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Write {
    Frame(Words),
    Values(PerChannel<f64>),
    Levels(u64),
}

impl Write {
    /// Combines the first part of this write with the rest of the previous write, as a control reads them in the middle
    /// of the write. `cut` is the fraction of this write that belongs to the first part, 0 to 1.
    pub(super) fn torn(&self, before: Option<&Self>, cut: f64) -> Self {
        match (*self, before) {
            (Self::Frame(new), Some(Self::Frame(old))) => {
                let mut mixed = new;
                let at = cut_index(cut, mixed.as_slice().len());
                let rest = mixed.as_mut_slice().iter_mut().zip(old.as_slice());
                rest.skip(at).for_each(|(word, old)| *word = *old);
                Self::Frame(mixed)
            }
            (Self::Frame(new), _) => {
                let mut mixed = new;
                let at = cut_index(cut, mixed.as_slice().len());
                mixed.as_mut_slice().iter_mut().skip(at).for_each(|word| *word = 0);
                Self::Frame(mixed)
            }
            (Self::Values(new), before) => {
                let old = match before {
                    Some(Self::Values(old)) => *old,
                    _ => PerChannel::ZERO,
                };
                let at = cut_index(cut, 3);
                Self::Values(PerChannel::from_fn(|i| if i < at { new[i] } else { old[i] }))
            }
            (Self::Levels(new), before) => {
                let old = match before {
                    Some(Self::Levels(old)) => *old,
                    _ => 0,
                };
                let first = (1_u64 << cut_index(cut, 16)) - 1;
                Self::Levels(new & first | old & !first)
            }
        }
    }
}

/// Number of elements before the cut. It is at least 1 and below `count`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "a few words"
)]
fn cut_index(cut: f64, count: usize) -> usize {
    ((cut.clamp(0.0, 1.0) * count as f64) as usize).clamp(1, count.saturating_sub(1).max(1))
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Due {
    After(u32),
    NextWrite,
}

/// The delayed writes. Their order has no meaning, because free slots are reused.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DelayedWrites([Option<(Write, Due)>; MAX_DELAYED]);

impl DelayedWrites {
    /// Delays a write by a number of calls, at least 1. Returns the write if the queue is full.
    pub(super) fn keep(&mut self, write: Write, calls: u32) -> Option<Write> {
        self.put(write, Due::After(calls.max(1)))
    }

    /// Delays a write until the next write was delivered. Returns the write if the queue is full.
    pub(super) fn keep_for_next(&mut self, write: Write) -> Option<Write> {
        self.put(write, Due::NextWrite)
    }

    fn put(&mut self, write: Write, due: Due) -> Option<Write> {
        match self.0.iter_mut().find(|slot| slot.is_none()) {
            Some(slot) => {
                *slot = Some((write, due));
                None
            }
            None => Some(write),
        }
    }

    /// Counts a call that reached the device. Writes that are delayed by a number of calls may become due with this
    /// call.
    pub(super) fn pass(&mut self) {
        for (_, due) in self.0.iter_mut().flatten() {
            if let Due::After(calls) = due {
                *calls = calls.saturating_sub(1);
            }
        }
    }

    pub(super) fn release(&mut self) {
        for (_, due) in self.0.iter_mut().flatten() {
            *due = Due::After(0);
        }
    }

    /// Removes and returns one write that is due; `None` if no write is due. `written` means that a write has just been
    /// delivered, which makes the writes due that are delayed until the next write.
    pub(super) fn take(&mut self, written: bool) -> Option<Write> {
        let due = |slot: &&mut Option<(Write, Due)>| match slot {
            Some((_, Due::After(calls))) => *calls == 0,
            Some((_, Due::NextWrite)) => written,
            None => false,
        };
        let (write, _) = self.0.iter_mut().find(due)?.take()?;
        Some(write)
    }
}
