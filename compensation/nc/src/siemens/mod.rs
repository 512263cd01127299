//! The language of SINUMERIK controls: its lines as blocks.
//!
//! Words that mean the same as in RS-274 have its letters and codes: `CR=` is R, G71 is G21. What is not known to move nothing is
//! refused with its column.

mod codes;
mod names;
mod values;
mod words;

use crate::{
    block::{Assignment, Begins, Block, Manner, OTHER, Parameter, Word},
    fault::Fault,
    formula::{Formulas, plain_number},
    interpret::Interpreter,
    parameters::Value,
    scan::Scanner,
    siemens::{
        codes::UNKNOWN,
        values::{Values, identifier, r_parameter},
    },
};

const AXIS: &str = "an axis, or an address, that is not known here";
const SUBPROGRAM: &str = "it may be a subprogram, and these are not followed in this language";

/// Reads a line without its end.
pub(crate) fn read(block: &mut Block, text: &[u8], interpreter: &Interpreter) -> Result<(), Fault> {
    block.clear();
    let mut reader = Reader {
        block,
        scanner: Scanner::new(text),
        interpreter,
        groups: Vec::new(),
        dwells: false,
        limits: false,
    };
    reader.line()
}

/// State: a line that is being read.
struct Reader<'a, 'b> {
    block: &'b mut Block,
    scanner: Scanner<'a>,
    interpreter: &'b Interpreter,
    /// The groups of which a G code was read, and which.
    groups: Vec<(u8, u32)>,
    dwells: bool,
    limits: bool,
}

impl Reader<'_, '_> {
    fn line(&mut self) -> Result<(), Fault> {
        self.begins();
        while let Some(byte) = self.scanner.peek() {
            let column = self.scanner.column();
            match byte {
                b';' => break,
                b'A'..=b'Z' | b'_' => self.statement()?,
                b'$' => {
                    return Err(not_followed(
                        column,
                        "$",
                        "variables of the control may shift its coordinates",
                    ));
                }
                b'%' if self.block.end == 0 => {
                    // The name of the program in an archive.
                    self.scanner.go_to(usize::MAX);
                }
                other => {
                    return Err(Fault::Character {
                        column,
                        found: char::from(other),
                    });
                }
            }
            self.block.end = self.scanner.at();
        }
        let (dwells, limits) = (self.dwells, self.limits);
        let means = |word: &Word| match word.letter {
            b'F' => !dwells,
            letter => !limits || crate::coordinates::axis_of(letter).is_none(),
        };
        self.block.words.retain(means);
        Ok(())
    }

    /// `/3 N10 LABEL:`.
    fn begins(&mut self) {
        let scanner = &mut self.scanner;
        if scanner.takes(b'/') {
            let at = scanner.at() - 1;
            let digit = scanner.bytes().get(at + 1);
            if digit.is_some_and(u8::is_ascii_digit) {
                scanner.go_to(at + 2);
            }
            self.block.begins = Begins::Slash;
            self.block.skip = at..scanner.at();
            self.block.end = scanner.at();
        }
        let before = scanner.at();
        if scanner.takes(b'N') || scanner.takes(b':') {
            if plain_number(scanner, b"").is_some() {
                self.block.end = scanner.at();
            } else {
                scanner.go_to(before);
            }
        }
        let before = scanner.at();
        let is_label = identifier(scanner).is_some_and(|name| name.len() > 1)
            && scanner.takes(b':')
            && scanner.peek() != Some(b'=');
        if is_label {
            self.block.end = scanner.at();
        } else {
            scanner.go_to(before);
        }
    }

    fn values(&self) -> Values<'_> {
        Values {
            interpreter: self.interpreter,
            set: &self.block.assignments,
        }
    }

    /// A word, a name, a call or an assignment.
    fn statement(&mut self) -> Result<(), Fault> {
        let (at, column) = (self.scanner.at(), self.scanner.column());
        let bytes = self.scanner.bytes();
        let is_letter = |place: usize| {
            bytes
                .get(place)
                .is_some_and(|byte| byte.is_ascii_alphabetic() || *byte == b'_')
        };
        if is_letter(at + 1) || !bytes[at].is_ascii_alphabetic() {
            return match identifier(&mut self.scanner) {
                Some(name) => self.named(&name, at, column),
                None => Ok(()),
            };
        }
        let letter = bytes[at].to_ascii_uppercase();
        if letter == b'R' {
            return self.r_parameter(at);
        }
        self.scanner.go_to(at + 1);
        // X1= is another address than X.
        let number = plain_number(&mut self.scanner, b"");
        let is_other = number.is_some() && self.scanner.peek() == Some(b'=');
        if is_other && !self.next_is_equal() {
            return self.numbered(letter, at, column);
        }
        self.scanner.go_to(at + 1);
        self.lettered(letter, at, column)
    }

    /// Whether `==` is next, a comparison.
    fn next_is_equal(&self) -> bool {
        let rest = self.scanner.bytes().get(self.scanner.at()..);
        rest.is_some_and(|rest| rest.starts_with(b"=="))
    }

    /// The text of an address, for messages.
    fn found(&self, at: usize) -> String {
        let text = self.scanner.bytes().get(at..self.scanner.at());
        String::from_utf8_lossy(text.unwrap_or_default().trim_ascii()).into_owned()
    }

    /// A value that means nothing for coordinates; its address is passed. It is to be executed with the motion of its block.
    fn other(&mut self, at: usize) -> Result<(), Fault> {
        self.skip_value()?;
        let text = self.scanner.at()..self.scanner.at();
        self.word(OTHER, at, text, Some(0.0), Manner::Modal, None);
        Ok(())
    }

    fn word(
        &mut self,
        letter: u8,
        at: usize,
        text: std::ops::Range<usize>,
        value: Value,
        manner: Manner,
        decimals: Option<u8>,
    ) {
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

    /// Passes a value of any kind: a formula, a text, a name with arguments.
    fn skip_value(&mut self) -> Result<(), Fault> {
        if self.scanner.takes_text()? {
            return Ok(());
        }
        let column = self.scanner.column();
        let mut scanner = self.scanner.clone();
        let read = self.values().read(&mut scanner)?;
        self.scanner = scanner;
        read.map(|_read| ()).ok_or(Fault::Expression {
            column,
            what: "expected a value here",
        })
    }

    /// `R5=...`, `R[5]=...`.
    fn r_parameter(&mut self, at: usize) -> Result<(), Fault> {
        let mut scanner = self.scanner.clone();
        let column = scanner.column();
        let number = r_parameter(&self.values(), &mut scanner, 0)?;
        self.scanner = scanner;
        match number {
            Some(Some(number)) => self.assign(Parameter::Numbered(number), at),
            Some(None) => Err(Fault::Expression {
                column,
                what: "only the machine knows which parameter is set here",
            }),
            None => Err(not_followed(column, "R", UNKNOWN)),
        }
    }

    /// `= ...` behind a parameter.
    fn assign(&mut self, parameter: Parameter, at: usize) -> Result<(), Fault> {
        let column = self.scanner.column();
        if !self.scanner.takes(b'=') {
            return Err(Fault::Expression {
                column,
                what: "expected = after a parameter that begins a word",
            });
        }
        self.scanner.peek();
        let from = self.scanner.at();
        let value = if self.scanner.takes_text()? {
            None
        } else {
            self.value("expected the value of the parameter after =")?.0
        };
        let text = self.without_blanks(from);
        self.block.assignments.push(Assignment {
            parameter,
            value,
            all: at..text.end,
            text,
        });
        Ok(())
    }

    /// What was read from a place on, without the blanks behind it.
    fn without_blanks(&self, from: usize) -> std::ops::Range<usize> {
        let text = self.scanner.bytes().get(from..self.scanner.at());
        from..from + text.unwrap_or_default().trim_ascii_end().len()
    }

    /// A formula, or a number with its decimals.
    fn value(&mut self, what: &'static str) -> Result<(Value, Option<u8>), Fault> {
        let mut scanner = self.scanner.clone();
        let column = scanner.column();
        let read = self.values().read(&mut scanner)?;
        self.scanner = scanner;
        let read = read.ok_or(Fault::Expression { column, what })?;
        Ok((read.value, read.decimals))
    }

    /// A number with a sign, as it stands behind a letter without `=`.
    fn number(&mut self) -> Option<(f64, u8)> {
        let sign = match self.scanner.peek() {
            Some(b'-') => -1.0,
            _ => 1.0,
        };
        let before = self.scanner.at();
        if !self.scanner.takes(b'-') {
            self.scanner.takes(b'+');
        }
        let mut scanner = self.scanner.clone();
        let number = self.values().number(&mut scanner);
        self.scanner = scanner;
        if number.is_none() {
            self.scanner.go_to(before);
        }
        number.map(|(value, decimals)| (sign * value, decimals))
    }
}

fn not_followed(column: usize, found: &str, why: &'static str) -> Fault {
    Fault::NotFollowed {
        column,
        found: found.to_owned(),
        why,
    }
}

fn no_number(column: usize, letter: u8) -> Fault {
    Fault::NoNumber {
        column,
        letter: char::from(letter),
    }
}
