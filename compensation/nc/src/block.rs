//! One line of a program: its words with their places in the text, so that what is not changed stays as it is.

use std::ops::Range;

use crate::{
    command::Command,
    expression::{Expressions, Read},
    fault::Fault,
    parameters::Value,
    scan::Scanner,
};

/// A word: a letter and its value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Word {
    /// The capital letter, or one of `@`, `^` and `$`.
    pub(crate) letter: u8,
    /// Where the letter stands, bytes from the beginning of the line.
    pub(crate) at: usize,
    /// Where the value stands.
    pub(crate) text: Range<usize>,
    pub(crate) value: Value,
    /// The decimals of a plain number; `None`: it was computed.
    pub(crate) decimals: Option<u8>,
    pub(crate) manner: Manner,
    /// It is written as a number of least increments.
    pub(crate) in_increments: bool,
}

/// What the value of a coordinate is, where its word says so itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Manner {
    /// What is switched on.
    #[default]
    Modal,
    /// A place: `AC(..)`.
    Absolute,
    /// A way: `IC(..)`, `IX`.
    Incremental,
    /// The place of a rotary axis, to which it goes by the shorter way: `DC(..)`.
    Shortest,
}

/// The letter of words that mean nothing for coordinates, but must be executed with their motion: a coolant that is switched on.
pub(crate) const OTHER: u8 = b'!';
/// The same where it is done at the end of the motion: a stop. Of a motion in parts it belongs to the last one.
pub(crate) const LAST: u8 = b'&';
/// The letters of polar coordinates, the distance from the pole and the angle.
pub(crate) const POLAR: [u8; 2] = *b"@^";

/// A parameter that a block sets once its other words are read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Parameter {
    Numbered(u32),
    Named(String),
}

/// A parameter and its value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Assignment {
    pub(crate) parameter: Parameter,
    pub(crate) value: Value,
    /// Where all of it stands, and its value alone.
    pub(crate) all: Range<usize>,
    pub(crate) text: Range<usize>,
}

/// What a line is, besides its words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Begins {
    #[default]
    Nothing,
    /// A slash: the operator may have it skipped.
    Slash,
    /// A percent sign: the program begins or ends here.
    Percent,
}

/// A line that was read; made once, and used for all lines.
#[derive(Clone, Debug, Default)]
pub(crate) struct Block {
    pub(crate) words: Vec<Word>,
    pub(crate) assignments: Vec<Assignment>,
    /// What its language says in words that RS-274 has no code for.
    pub(crate) commands: Vec<Command>,
    pub(crate) begins: Begins,
    /// The number of the block, where each block must have the next one, and where it stands.
    pub(crate) number: Option<(Range<usize>, u64)>,
    /// The word that says how the motion goes, where added lines need one, too.
    pub(crate) keyword: Range<usize>,
    /// Numbers have decimal commas; `None`: it has no decimals.
    pub(crate) comma: Option<bool>,
    /// Whether the last coordinate of the program so far was a number of least increments; `None`: there was none yet, or the control does not count in them.
    pub(crate) last_in_increments: Option<bool>,
    /// The mark with which the operator may have it skipped.
    pub(crate) skip: Range<usize>,
    /// Where a further word may be put: behind the last one.
    pub(crate) end: usize,
}

impl Block {
    /// Reads a line without its end of line. O-words are read elsewhere: none may be in it.
    pub(crate) fn read(&mut self, line: &[u8], expressions: &Expressions<'_>) -> Result<(), Fault> {
        self.clear();
        let mut scanner = Scanner::new(line);
        let mut end = 0;
        match scanner.peek() {
            Some(b'/') => {
                scanner.next();
                self.begins = Begins::Slash;
                self.skip = scanner.at() - 1..scanner.at();
                end = scanner.at();
            }
            Some(b'%') => {
                self.begins = Begins::Percent;
                self.end = line.len();
                return Ok(());
            }
            _ => {}
        }
        self.end = end;
        while let Some(byte) = scanner.peek() {
            let (at, column) = (scanner.at(), scanner.column());
            scanner.next();
            match byte {
                b'(' => skip_comment(&mut scanner, column)?,
                b';' => break,
                b'#' => {
                    self.assignment(at, &mut scanner, expressions)?;
                    self.end = scanner.at();
                }
                b'A'..=b'Z' | b'@' | b'^' | b'$' => {
                    scanner.peek();
                    let from = scanner.at();
                    let read = expressions.read(&mut scanner)?;
                    let Some(Read { value, decimals }) = read else {
                        return Err(Fault::NoNumber {
                            column,
                            letter: char::from(byte),
                        });
                    };
                    self.end = scanner.at();
                    self.words.push(Word {
                        letter: byte,
                        at,
                        text: from..scanner.at(),
                        value,
                        decimals,
                        manner: Manner::Modal,
                        in_increments: false,
                    });
                }
                other => {
                    return Err(Fault::Character {
                        column,
                        found: char::from(other),
                    });
                }
            }
        }
        Ok(())
    }

    /// A line that says nothing.
    pub(crate) fn clear(&mut self) {
        self.words.clear();
        self.assignments.clear();
        self.commands.clear();
        self.begins = Begins::Nothing;
        self.skip = 0..0;
        self.number = None;
        self.keyword = 0..0;
        self.comma = None;
        self.last_in_increments = None;
        self.end = 0;
    }

    /// `#12 = 3` or `#<name> = 3`, whose `#` is passed.
    fn assignment(
        &mut self,
        at: usize,
        scanner: &mut Scanner<'_>,
        expressions: &Expressions<'_>,
    ) -> Result<(), Fault> {
        let parameter = if scanner.takes(b'<') {
            Some(Parameter::Named(scanner.name()?))
        } else {
            let number = expressions.parameter_number(scanner, 0)?;
            number.map(Parameter::Numbered)
        };
        let column = scanner.column();
        if !scanner.takes(b'=') {
            return Err(Fault::Expression {
                column,
                what: "expected = after a parameter that begins a word",
            });
        }
        scanner.peek();
        let (column, from) = (scanner.column(), scanner.at());
        let read = expressions.read(scanner)?.ok_or(Fault::Expression {
            column,
            what: "expected the value of the parameter after =",
        })?;
        let parameter = parameter.ok_or(Fault::Expression {
            column,
            what: "only the machine knows which parameter is set here",
        })?;
        self.assignments.push(Assignment {
            parameter,
            value: read.value,
            all: at..scanner.at(),
            text: from..scanner.at(),
        });
        Ok(())
    }

    /// The last word with this letter.
    pub(crate) fn word(&self, letter: u8) -> Option<&Word> {
        self.words.iter().rev().find(|word| word.letter == letter)
    }
}

fn skip_comment(scanner: &mut Scanner<'_>, column: usize) -> Result<(), Fault> {
    let rest = &scanner.bytes()[scanner.at()..];
    let Some(length) = rest.iter().position(|byte| *byte == b')') else {
        return Err(Fault::OpenComment { column });
    };
    scanner.go_to(scanner.at() + length + 1);
    Ok(())
}
