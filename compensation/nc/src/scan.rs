//! The characters of a line. Blanks mean nothing outside comments, also within a number, and case means nothing.

use crate::{
    fault::Fault,
    number::{Digits, plain},
};

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
    #[inline]
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
    #[inline]
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
        if let Some((value, decimals, length)) = plain(&self.bytes[self.at..]) {
            self.at += length;
            return Some((value, decimals));
        }
        self.number_with_blanks()
    }

    /// The same for a number with any digits, and blanks between them.
    fn number_with_blanks(&mut self) -> Option<(f64, u8)> {
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

    /// Passes a text in quotation marks where it is next.
    pub(crate) fn takes_text(&mut self) -> Result<bool, Fault> {
        self.peek();
        let column = self.column();
        if !self.takes(b'"') {
            return Ok(false);
        }
        let rest = &self.bytes[self.at..];
        let Some(length) = rest.iter().position(|byte| *byte == b'"') else {
            return Err(Fault::Expression {
                column,
                what: "the text that begins here does not end with \"",
            });
        };
        self.at += length + 1;
        Ok(true)
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

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn texts_are_passed_with_their_marks() {
        let mut scanner = Scanner::new(b"  \"MILL \" X");
        assert_eq!(scanner.takes_text(), Ok(true));
        assert_eq!(
            (scanner.takes_text(), scanner.next()),
            (Ok(false), Some(b'X'))
        );
        let open = Scanner::new(b"  \"MILL").takes_text();
        assert!(
            matches!(open, Err(Fault::Expression { column: 3, .. })),
            "{open:?}"
        );
    }

    /// Texts of the characters that numbers have and may have: one pass over a plain number finds what the reader of single characters
    /// finds, to the last bit.
    #[test]
    fn plain_numbers_are_read_as_character_by_character() {
        let mut draw = ChaCha8Rng::seed_from_u64(7);
        let (mut plainly, mut none) = (0, 0);
        for round in 0..100_000 {
            let letters: &[u8] = if round % 2 == 0 {
                b"0123456789.123456789 "
            } else {
                b"0123456789..--++ \tXe"
            };
            let length = draw.random_range(0..24);
            let text: Vec<u8> = (0..length)
                .map(|_| letters[draw.random_range(0..letters.len())])
                .collect();
            let (mut one, mut other) = (Scanner::new(&text), Scanner::new(&text));
            let (found, expected) = (one.number(), other.number_with_blanks());
            let bits = |found: Option<(f64, u8)>| found.map(|(value, of)| (value.to_bits(), of));
            assert_eq!(bits(found), bits(expected), "{text:?}");
            assert_eq!(one.at(), other.at(), "{text:?}");
            plainly += usize::from(plain(&text).is_some());
            none += usize::from(found.is_none());
        }
        assert!(plainly > 30_000 && none > 10_000, "{plainly} {none}");
    }
}
