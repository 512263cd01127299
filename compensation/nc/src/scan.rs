//! The characters of a line. Blanks mean nothing outside comments, also within a number, and case means nothing.

use crate::{fault::Fault, number::Digits};

/// A line, read from the left. Places are bytes.
#[derive(Clone, Debug)]
pub(crate) struct Scanner<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Scanner<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub(crate) fn at(&self) -> usize {
        self.at
    }

    pub(crate) fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    pub(crate) fn go_to(&mut self, at: usize) {
        self.at = at.min(self.bytes.len());
    }

    /// The place of the next character as people count.
    pub(crate) fn column(&self) -> usize {
        self.at + 1
    }

    /// The next character as a capital letter, which stays; blanks before it are passed.
    pub(crate) fn peek(&mut self) -> Option<u8> {
        while let Some(byte) = self.bytes.get(self.at) {
            if !matches!(byte, b' ' | b'\t') {
                return Some(byte.to_ascii_uppercase());
            }
            self.at += 1;
        }
        None
    }

    /// The next character as a capital letter.
    pub(crate) fn next(&mut self) -> Option<u8> {
        let byte = self.peek()?;
        self.at += 1;
        Some(byte)
    }

    /// Passes this character where it is the next one.
    pub(crate) fn takes(&mut self, byte: u8) -> bool {
        let is_next = self.peek() == Some(byte);
        self.at += usize::from(is_next);
        is_next
    }

    /// Passes these capital letters where they are next, whatever blanks are between.
    pub(crate) fn takes_all(&mut self, letters: &str) -> bool {
        let before = self.at;
        let all = letters.bytes().all(|letter| self.takes(letter));
        if !all {
            self.at = before;
        }
        all
    }

    /// A decimal number with a sign or without, and its decimals.
    pub(crate) fn number(&mut self) -> Option<(f64, u8)> {
        let before = self.at;
        let mut digits = Digits::default();
        match self.peek() {
            Some(b'-') => {
                digits.negate();
                self.at += 1;
            }
            Some(b'+') => self.at += 1,
            _ => {}
        }
        let mut end = self.at;
        while let Some(byte) = self.peek() {
            if !digits.take(byte) {
                break;
            }
            self.at += 1;
            end = self.at;
        }
        // Blanks after the last digit are not of the number.
        self.at = end;
        let value = digits.value();
        if value.is_none() {
            self.at = before;
        }
        value.map(|value| (value, digits.decimals()))
    }

    /// A name between `<` and `>`, whose `<` is passed already: small letters, without blanks.
    pub(crate) fn name(&mut self) -> Result<String, Fault> {
        let column = self.column();
        let mut name = String::new();
        while let Some(byte) = self.next() {
            if byte == b'>' {
                return Ok(name);
            }
            name.push(char::from(byte.to_ascii_lowercase()));
        }
        Err(Fault::Expression {
            column,
            what: "the name that begins here does not end with >",
        })
    }
}
