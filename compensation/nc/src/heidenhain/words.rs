//! Words: a letter and its value, and what M codes do.

use std::ops::Range;

use crate::{
    block::{LAST, Manner, OTHER, Word},
    command::Command,
    coordinates::axis_of,
    fault::Fault,
    formula::{plain_number, takes_name},
    heidenhain::{OWN_RULE, Reader, not_followed},
    parameters::Value,
};

impl Reader<'_, '_> {
    pub(super) fn word(
        &mut self,
        letter: u8,
        at: usize,
        text: Range<usize>,
        value: Value,
        manner: Manner,
        decimals: Option<u8>,
    ) {
        let is_comma = |range: &Range<usize>| self.scanner.bytes()[range.clone()].contains(&b',');
        if decimals.is_some_and(|decimals| decimals > 0) {
            self.block.comma = Some(is_comma(&text));
        }
        self.block.words.push(Word {
            letter,
            at,
            text,
            value,
            decimals,
            manner,
            in_increments: false,
        });
    }

    /// The value behind the letter of a word, as a word of this letter.
    pub(super) fn value_word(
        &mut self,
        letter: u8,
        at: usize,
        manner: Manner,
    ) -> Result<(), Fault> {
        self.scanner.peek();
        let (column, from) = (self.scanner.column(), self.scanner.at());
        let Some((value, decimals)) = self.values.of_word(&mut self.scanner)? else {
            return Err(Fault::NoNumber {
                column,
                letter: char::from(letter),
            });
        };
        let text = from..self.scanner.at();
        self.has_one_sign()?;
        self.word(letter, at, text, value, manner, decimals);
        Ok(())
    }

    /// Controls write decimal commas or points, as they are set; a number with both, or with two of them, has groups of digits or a slip
    /// of the pen in it.
    fn has_one_sign(&self) -> Result<(), Fault> {
        let next = self.scanner.bytes().get(self.scanner.at());
        match next {
            Some(b'.' | b',') => Err(Fault::Expression {
                column: self.scanner.column(),
                what: "found a second decimal comma or point, expected one in a number",
            }),
            _ => Ok(()),
        }
    }

    /// A value that is needed.
    pub(super) fn value(&mut self, what: &'static str) -> Result<Value, Fault> {
        self.scanner.peek();
        let column = self.scanner.column();
        let value = self.values.of_word(&mut self.scanner)?;
        let (value, _) = value.ok_or(Fault::Expression { column, what })?;
        self.has_one_sign()?;
        Ok(value)
    }

    /// Words of axes, with an I before them where they are ways.
    pub(super) fn axis_word(&mut self) -> Result<bool, Fault> {
        self.scanner.peek();
        let at = self.scanner.at();
        let is_way = self.scanner.takes(b'I');
        let letter = self.scanner.peek();
        let Some(letter) = letter.filter(|letter| axis_of(*letter).is_some()) else {
            self.scanner.go_to(at);
            return Ok(false);
        };
        self.scanner.next();
        let manner = if is_way {
            Manner::Incremental
        } else {
            Manner::Modal
        };
        self.value_word(letter, at, manner)?;
        Ok(true)
    }

    /// M codes up to the end of the line.
    pub(super) fn m_words(&mut self) -> Result<(), Fault> {
        while self.scanner.peek() == Some(b'M') {
            self.m_word()?;
        }
        Ok(())
    }

    /// An M code, which is next.
    pub(super) fn m_word(&mut self) -> Result<(), Fault> {
        let (at, column) = (self.scanner.at(), self.scanner.column());
        self.scanner.next();
        let from = self.scanner.at();
        let number = plain_number(&mut self.scanner, b"");
        let code = number.and_then(|(number, _)| crate::given::whole(number, 9999));
        let Some(code) = code else {
            return Err(Fault::NoNumber {
                column,
                letter: 'M',
            });
        };
        let refused = |why| Err(not_followed(column, &format!("M{code}"), why));
        let command = match code {
            2 | 30 => Some(Command::Ends),
            91 => Some(Command::InMachine),
            99 => Some(Command::CallsDefined),
            126 => Some(Command::Shorter(true)),
            127 => Some(Command::Shorter(false)),
            128 => {
                // The feed of the motions that make up for the rotary axes.
                if self.scanner.takes(b'F') && !takes_name(&mut self.scanner, "MAX") {
                    self.value("expected a feed behind F")?;
                }
                Some(Command::CentrePoint(true))
            }
            129 => Some(Command::CentrePoint(false)),
            89 => return refused("a cycle behind each motion is not followed"),
            92 => return refused("places that count from a point which only the control knows"),
            94 => return refused("another number for where a rotary axis is"),
            104 | 114 | 115 | 130 | 138 | 142..=144 => {
                return refused("it changes what coordinates mean");
            }
            140 => return refused(OWN_RULE),
            _ => None,
        };
        self.block.commands.extend(command);
        // What is done at the end of a block.
        let is_last = matches!(code, 0..=2 | 5 | 9 | 30 | 60 | 98 | 99);
        let letter = if is_last { LAST } else { OTHER };
        let text = from..self.scanner.at();
        self.word(letter, at, text, Some(0.0), Manner::Modal, None);
        Ok(())
    }
}
