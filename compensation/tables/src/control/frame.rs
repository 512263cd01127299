//! The frames that a gateway sends to a control with a map.

use volcomp_guard::protocol::{HEAD_WORDS, Head, Layout, is_whole, seal};

/// Words of a map in one frame.
pub const DATA: usize = 64;
/// Words of a frame: head, body, checksum. Every frame has as many.
pub const FRAME_WORDS: usize = BODY + 2 + DATA + 2;

const BODY: usize = HEAD_WORDS;

/// What a frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// A map comes, beginning with its first word.
    Begin {
        /// The number of the map.
        counter: u16,
        /// How many words it has.
        words: u16,
    },
    /// The next words of the map.
    Words {
        /// The place of the first of them.
        place: u16,
        /// The words; beyond the end of the map zeros.
        data: [u16; DATA],
    },
    /// The map is complete: from now on it is the one in use.
    Swap {
        /// The number of the map.
        counter: u16,
        /// The checksum of its words.
        check: [u16; 2],
    },
    /// The map in use stays valid.
    Keep {
        /// The number of the map.
        counter: u16,
    },
}

/// One frame: what shows that it is meant for now, and what it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// What shows that it is meant for now.
    pub head: Head,
    /// What it says.
    pub body: Body,
}

impl Frame {
    /// The words of the frame for a machine and its corrected axes, checksum and all.
    #[must_use]
    pub fn encode(&self, machine: u16, outputs: Layout) -> [u16; FRAME_WORDS] {
        let mut words = [0; FRAME_WORDS];
        words[..BODY].copy_from_slice(&self.head.words());
        match self.body {
            Body::Begin {
                counter,
                words: count,
            } => {
                words[BODY] = 1;
                words[BODY + 2..BODY + 4].copy_from_slice(&[counter, count]);
            }
            Body::Words { place, data } => {
                words[BODY..BODY + 2].copy_from_slice(&[2, place]);
                words[BODY + 2..BODY + 2 + DATA].copy_from_slice(&data);
            }
            Body::Swap { counter, check } => {
                words[BODY] = 3;
                words[BODY + 2..BODY + 5].copy_from_slice(&[counter, check[0], check[1]]);
            }
            Body::Keep { counter } => {
                words[BODY] = 4;
                words[BODY + 2] = counter;
            }
        }
        seal(machine, outputs, &mut words);
        words
    }
}

/// The words of a mailbox whose checksum fits.
pub(super) struct Found<'a>(&'a [u16; FRAME_WORDS]);

impl<'a> Found<'a> {
    pub(super) fn in_mailbox(
        machine: u16,
        outputs: Layout,
        words: &'a [u16; FRAME_WORDS],
    ) -> Option<Self> {
        is_whole(machine, outputs, words).then_some(Self(words))
    }

    pub(super) fn head(&self) -> Head {
        Head::of([self.0[0], self.0[1], self.0[2], self.0[3]])
    }

    /// 1 begin, 2 words, 3 swap, 4 keep.
    pub(super) fn kind(&self) -> u16 {
        self.0[BODY]
    }

    pub(super) fn place(&self) -> u16 {
        self.0[BODY + 1]
    }

    pub(super) fn data(&self) -> &[u16] {
        &self.0[BODY + 2..BODY + 2 + DATA]
    }
}
