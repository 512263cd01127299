//! How each language writes a word.

use crate::{block::Manner, dialect::Dialect, words::Number};

/// How a word that the program does not have is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Script {
    pub(crate) dialect: Dialect,
    /// Numbers have decimal commas.
    pub(crate) comma: bool,
    /// Each line with coordinates has its code.
    pub(crate) says_each: bool,
}

/// How a part of a motion goes to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    Straight,
    /// By the polar coordinates of its line.
    AsItIs,
    /// An arc about its centre.
    Centre,
    /// An arc by its radius.
    Radius,
}

/// A word that the program does not have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct NewWord {
    pub(crate) letter: u8,
    pub(crate) manner: Manner,
    pub(crate) number: Number,
}

impl NewWord {
    /// A word that means what is switched on.
    pub(crate) fn plain((letter, number): (u8, Number)) -> Self {
        Self {
            letter,
            manner: Manner::Modal,
            number,
        }
    }
}

impl Script {
    /// Whether the centre of an arc stands in a block of its own before it, and each motion says how it goes.
    pub(crate) fn is_heidenhain(self) -> bool {
        self.dialect == Dialect::Heidenhain
    }

    /// What begins a motion in a line of its own; nothing where that is switched on.
    pub(crate) fn keyword(self, shape: Shape) -> &'static [u8] {
        match shape {
            _ if !self.is_heidenhain() => b"",
            Shape::Straight | Shape::AsItIs => b"L",
            Shape::Centre => b"C",
            Shape::Radius => b"CR",
        }
    }

    /// Writes a word behind what is there: with a blank, unless it begins a line.
    pub(crate) fn write_word(self, word: &NewWord, out: &mut Vec<u8>) {
        if !matches!(out.last(), None | Some(b'\r' | b'\n' | b'/')) {
            out.push(b' ');
        }
        let opens: &[u8] = match (self.dialect, word.manner) {
            (Dialect::Siemens, Manner::Absolute) => b"=AC(",
            (Dialect::Siemens, Manner::Incremental) => b"=IC(",
            (Dialect::Siemens, Manner::Shortest) => b"=DC(",
            (Dialect::Heidenhain, Manner::Incremental) => {
                out.push(b'I');
                b""
            }
            _ => b"",
        };
        match (self.dialect, word.letter) {
            (Dialect::Siemens, b'R') => out.extend_from_slice(b"CR="),
            (_, letter) => out.push(letter),
        }
        out.extend_from_slice(opens);
        self.write_number(word.number, true, out);
        if !opens.is_empty() {
            out.push(b')');
        }
    }

    /// The same with the decimal comma or point of the number that stood there, if it had one.
    pub(crate) fn like(self, before: &[u8]) -> Self {
        let sign = before.iter().find(|byte| matches!(byte, b',' | b'.'));
        Self {
            comma: sign.map_or(self.comma, |sign| *sign == b','),
            ..self
        }
    }

    /// Writes a number; `has_sign`: also a positive one has its sign, where the language writes one.
    pub(crate) fn write_number(self, number: Number, has_sign: bool, out: &mut Vec<u8>) {
        if !self.is_heidenhain() {
            return number.write(out);
        }
        if has_sign && !number.is_negative() {
            out.push(b'+');
        }
        let from = out.len();
        number.write(out);
        if self.comma {
            for byte in &mut out[from..] {
                if *byte == b'.' {
                    *byte = b',';
                }
            }
        }
    }
}
