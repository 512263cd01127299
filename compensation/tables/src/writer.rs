//! The sender's half: which frame comes next, by what the control published last.

use crate::{
    Map,
    control::{Body, DATA, Report},
};

/// What a sender does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Write a frame that says this.
    Write(Body),
    /// Read the words of this buffer, 0 or 1, compare them with the map's, and ask again with what was found.
    ReadBack {
        /// The buffer that was loaded.
        buffer: u16,
    },
}

/// What a sender knows of the words that it loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loaded {
    /// They were not read back yet.
    Unknown,
    /// They were read back, and are the map's.
    Same,
    /// They were read back, and are not the map's.
    Other,
}

/// What is to be sent next, so that `map` is in use and stays so. `seen` is what the control published last. Nothing is remembered:
/// after any loss it goes on where the control is.
#[must_use]
pub fn next_write(map: &Map, machine: u16, seen: &Report, loaded: Loaded) -> Next {
    let counter = map.header().counter;
    let words = u16::try_from(map.words().len()).unwrap_or(u16::MAX);
    let body = match seen.loading {
        _ if seen.valid && seen.counter == counter => Body::Keep { counter },
        Some((loading, next)) if loading == counter && loaded != Loaded::Other => {
            if next < words {
                words_from(map, next)
            } else if loaded == Loaded::Same {
                let check = map.checksum(machine);
                Body::Swap { counter, check }
            } else {
                let buffer = 1 - seen.buffer.min(1);
                return Next::ReadBack { buffer };
            }
        }
        _ => Body::Begin { counter, words },
    };
    Next::Write(body)
}

/// Everything that brings a map into a control, in order: its beginning, its words, the swap.
pub fn writes(map: &Map, machine: u16) -> impl Iterator<Item = Body> + '_ {
    let counter = map.header().counter;
    // At most 32767 words.
    let words = u16::try_from(map.words().len()).unwrap_or(u16::MAX);
    let check = map.checksum(machine);
    core::iter::once(Body::Begin { counter, words })
        .chain((0..words).step_by(DATA).map(|place| words_from(map, place)))
        .chain(core::iter::once(Body::Swap { counter, check }))
}

fn words_from(map: &Map, place: u16) -> Body {
    let mut data = [0; DATA];
    let rest = map.words().get(usize::from(place)..).unwrap_or_default();
    for (into, word) in data.iter_mut().zip(rest) {
        *into = *word;
    }
    Body::Words { place, data }
}
