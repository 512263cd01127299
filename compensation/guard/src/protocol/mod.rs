//! What every frame between a gateway and a control has in common, whether it brings values (the [barrier](crate::barrier)) or a
//! map that the control looks up itself (map mode of `volcomp-tables`).
//!
//! The wire is taken as a black channel, as in IEC 61784-3: frames may be lost, late, doubled, reordered or torn. Each frame
//! answers the last report of the control, which takes it only while that report is recent, and only from one sender at a time:
//! [`Link`] is the control's half, [`Session`] the sender's.
//!
//! Everything is 16-bit words, because that is what a controller's own program has. Nothing here allocates, waits or reads a
//! clock: the time is the number of scans.

mod checksum;
mod layout;
mod link;
mod session;

pub use checksum::{Checksum, checksum};
pub use layout::{Layout, LayoutError};
pub use link::Link;
pub use session::{Seen, Session};

/// One value for each axis of a channel, in counts of that axis.
pub type Counts = volcomp_vocabulary::PerChannel<i16>;

/// Words of a [`Head`].
pub const HEAD_WORDS: usize = 4;

/// How a frame begins: what shows that it is meant for now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Head {
    /// The epoch that the control published last.
    pub epoch: u16,
    /// The tick that the control published last: how old the sender's knowledge is.
    pub tick: u16,
    /// One more than the sequence that the control published last.
    pub sequence: u16,
    /// The number that the sender drew at its start, never 0.
    pub owner: u16,
}

impl Head {
    /// The words, in the order of the fields.
    #[must_use]
    pub fn words(self) -> [u16; HEAD_WORDS] {
        [self.epoch, self.tick, self.sequence, self.owner]
    }

    /// The head of these words.
    #[must_use]
    pub fn of([epoch, tick, sequence, owner]: [u16; HEAD_WORDS]) -> Self {
        Self {
            epoch,
            tick,
            sequence,
            owner,
        }
    }
}

/// Writes the checksum of the words before the last two into those.
pub fn seal(machine: u16, layout: Layout, words: &mut [u16]) {
    if let Some((body, check)) = words.split_last_chunk_mut() {
        *check = checksum(machine, layout, body).words();
    }
}

/// Whether the last two words are the checksum of those before.
#[must_use]
pub fn is_whole(machine: u16, layout: Layout, words: &[u16]) -> bool {
    (words.split_last_chunk())
        .is_some_and(|(body, check)| checksum(machine, layout, body).words() == *check)
}

/// Why a control did not take the last frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Refusal {
    /// Every frame so far was taken.
    #[default]
    #[error("nothing was refused")]
    None,
    /// The frame is torn, or meant for another machine or another set of axes.
    #[error("its checksum does not fit")]
    Checksum,
    /// The frame was made before the control started anew or timed out.
    #[error("it belongs to an earlier epoch of the control")]
    Epoch,
    /// The frame was made from a report that is older than the control allows.
    #[error("it was made from a report that is too old")]
    Tick,
    /// Another sender holds the control, or the frame names none.
    #[error("another sender holds the control")]
    Owner,
    /// The frame was overtaken by a later one.
    #[error("a later frame has overtaken it")]
    Sequence,
    /// A value is beyond the limit that the control has for the axis. A map has to be begun again.
    #[error("a value is beyond the limit of the control")]
    Value,
    /// A word on plain lines came while a sender of frames holds the control or another correction is applied, or it
    /// changes faster than the axis could follow.
    #[error("a word on the lines came at the wrong time, or changes too fast")]
    Lines,
    /// Words that are not the next ones of the map that is being loaded.
    #[error("its words are not the next ones of the map")]
    Place,
    /// The map does not fit the control: its axes, its steps, its size or its lines. It has to be begun again.
    #[error("the map does not fit this control")]
    Fit,
    /// The checksum of the whole map does not fit, or the map that is to be kept is not the one in use.
    #[error("the map is not the one that is meant")]
    Map,
    /// A kind of frame that this control does not know.
    #[error("its kind is unknown")]
    Kind,
}

impl Refusal {
    /// Its number in the reports of a control whose refusals are these, from 0.
    #[must_use]
    pub fn number_in(self, all: &[Self]) -> u16 {
        let place = all.iter().position(|one| *one == self).unwrap_or(0);
        u16::try_from(place).unwrap_or(0)
    }

    /// The refusal of a number.
    #[must_use]
    pub fn numbered(all: &[Self], number: u16) -> Option<Self> {
        all.get(usize::from(number)).copied()
    }
}

/// Whether `later` lies ahead of `earlier` on a counter of 16 bits that wraps around: by less than half of its range.
fn is_ahead(later: u16, earlier: u16) -> bool {
    (1..1 << 15).contains(&later.wrapping_sub(earlier))
}
