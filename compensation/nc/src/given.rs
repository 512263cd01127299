//! What the words of a block say, each letter once.

use crate::{
    NcError,
    block::{Block, Manner, POLAR, Word},
    coordinates::{Axes, axis_of},
    fault::Fault,
    modal::Modal,
};

/// Larger numbers are no coordinates of a machine tool, and lose their decimals.
pub(crate) const LARGEST: f64 = 1e9;

/// The words of a block that is executed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Given<'a> {
    pub(crate) block: &'a Block,
    /// The place of the word of each axis in the block.
    pub(crate) places: Axes<Option<usize>>,
    /// The places of the distance from the pole and of the angle about it, where the block has polar coordinates.
    pub(crate) polar: Option<[Option<usize>; 2]>,
    /// A bit for each letter that a word of the block has, and one for all that are none from A to Z.
    letters: u32,
    /// The number of the line, counted from 1.
    pub(crate) line: usize,
}

impl<'a> Given<'a> {
    /// What a block says; `are_polar`: its X and Y words are a distance and an angle.
    ///
    /// # Errors
    /// A letter that stands twice.
    pub(crate) fn new(block: &'a Block, line: usize, are_polar: bool) -> Result<Self, NcError> {
        let mut places = [None; 9];
        let mut polar = [None; 2];
        let mut seen = 0_u32;
        for (place, word) in block.words.iter().enumerate() {
            if let Some(axis) = axis_of(word.letter) {
                places[axis] = Some(place);
            }
            let letter = word.letter;
            let of_polar = POLAR.iter().position(|of| *of == letter);
            if let Some(of) = of_polar {
                polar[of] = Some(place);
            }
            // Each of the two may stand once.
            let bit = of_polar.map_or_else(|| bit_of(letter), |of| 1 << (27 + of));
            let stands_once = letter.is_ascii_uppercase() && letter != b'G' && letter != b'M';
            if (stands_once || of_polar.is_some()) && seen & bit != 0 {
                let name = char::from(letter).to_string();
                return Err(NcError::Block {
                    line,
                    fault: Fault::Twice {
                        found: name.clone(),
                        other: name,
                    },
                });
            }
            seen |= bit | bit_of(letter);
        }
        if are_polar {
            polar = [places[0].take(), places[1].take()];
        }
        Ok(Self {
            block,
            places,
            polar: (polar != [None; 2]).then_some(polar),
            letters: seen,
            line,
        })
    }

    /// Whether the block names any axis.
    pub(crate) fn names_axes(&self) -> bool {
        self.places.iter().any(Option::is_some)
    }

    /// Whether the block has a word with this letter.
    pub(crate) fn has(&self, letter: u8) -> bool {
        self.find(letter).is_some()
    }

    /// The last word of the block with this letter.
    pub(crate) fn find(&self, letter: u8) -> Option<&'a Word> {
        if self.letters & bit_of(letter) == 0 {
            return None;
        }
        self.block.word(letter)
    }

    /// The word of an axis.
    pub(crate) fn word(&self, axis: usize) -> Option<&'a Word> {
        self.block.words.get(self.places[axis]?)
    }

    /// Whether the centre of an arc along the axis of a letter is a place, not a way from its beginning.
    pub(crate) fn centre_is_absolute(&self, letter: u8, modal: &Modal) -> bool {
        let word = self.block.word(letter);
        centre_is_absolute(word.map(|word| word.manner), modal)
    }

    /// The value of an axis, in the unit of its word.
    pub(crate) fn axis(&self, axis: usize) -> Result<Option<f64>, NcError> {
        let word = self.word(axis);
        word.map(|word| self.value_of(word)).transpose()
    }

    /// The axes that the block names, and their values in the units of their words.
    pub(crate) fn axes(&self) -> Result<impl Iterator<Item = (usize, f64)> + use<>, NcError> {
        let mut values = [None; 9];
        self.each_axis(|axis, value| values[axis] = Some(value))?;
        Ok((0..9).filter_map(move |axis| Some((axis, values[axis]?))))
    }

    /// Does something with each axis that the block names, and its value in the unit of its word.
    pub(crate) fn each_axis(&self, mut takes: impl FnMut(usize, f64)) -> Result<(), NcError> {
        for axis in 0..9 {
            if let Some(word) = self.word(axis) {
                takes(axis, self.value_of(word)?);
            }
        }
        Ok(())
    }

    /// The value of the word with a letter.
    pub(crate) fn letter(&self, letter: u8) -> Result<Option<f64>, NcError> {
        let word = self.find(letter);
        word.map(|word| self.value_of(word)).transpose()
    }

    /// The value of the word with a letter where it is a whole number up to 99999.
    pub(crate) fn whole(&self, letter: u8) -> Result<Option<u32>, NcError> {
        Ok(self.letter(letter)?.and_then(|value| whole(value, 99_999)))
    }

    /// The word of the distance (0) or of the angle (1) of polar coordinates.
    pub(crate) fn polar_word(&self, of: usize) -> Option<&'a Word> {
        self.block.words.get(self.polar?[of]?)
    }

    /// The value of a word, in its unit.
    pub(crate) fn value_of(&self, word: &Word) -> Result<f64, NcError> {
        let letter = char::from(word.letter);
        let value = word.value.ok_or(NcError::OnlyAtMachine {
            line: self.line,
            word: letter,
        })?;
        if value.abs() > LARGEST {
            let what = format!("{letter} with {value:e}, expected at most {LARGEST:e}");
            return Err(self.refused(&what));
        }
        Ok(value)
    }

    /// The error that this block asks for what cannot be compensated.
    pub(crate) fn refused(&self, what: &str) -> NcError {
        NcError::NotCompensated {
            line: self.line,
            what: what.to_owned(),
        }
    }
}

fn bit_of(letter: u8) -> u32 {
    let place = letter.wrapping_sub(b'A').min(26);
    1 << place
}

/// Whether the word of a centre is a place.
pub(crate) fn centre_is_absolute(manner: Option<Manner>, modal: &Modal) -> bool {
    match manner.unwrap_or_default() {
        Manner::Modal => modal.centre_absolute,
        Manner::Incremental => false,
        Manner::Absolute | Manner::Shortest => true,
    }
}

/// A whole number up to the largest.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the range was looked at before"
)]
pub(crate) fn whole(value: f64, most: u32) -> Option<u32> {
    let rounded = value.round();
    let is_whole = (value - rounded).abs() < 1e-3 && (0.0..=f64::from(most)).contains(&rounded);
    is_whole.then_some(rounded as u32)
}
