//! The conversational language of HEIDENHAIN controls: its lines as blocks.
//!
//! Words that mean the same as in RS-274 have its letters and codes: a line `L` is G1, with FMAX G0; `RL` is G41. What is not known to
//! move nothing is refused with its column.

mod cycles;
mod motions;
mod numbering;
mod values;
mod words;

pub(crate) use numbering::{block_number, renumber};

use crate::{
    block::{Assignment, Block, Manner, Parameter},
    command::Command,
    expression::{Operator, finite, operate},
    fault::Fault,
    formula::{Formulas, plain_number, takes_name},
    heidenhain::values::{Values, q_parameter},
    interpret::Interpreter,
    parameters::Value,
    scan::Scanner,
};

const UNKNOWN: &str = "it is not known here, and might move an axis";
const FLOW: &str = "which lines are executed after it, is not followed in this language";
const TILTED: &str = "only shifts of the datum are followed (cycle 7)";
const OWN_RULE: &str = "it moves axes by a rule of its own";

/// Reads a line without its end.
pub(crate) fn read(block: &mut Block, text: &[u8], interpreter: &Interpreter) -> Result<(), Fault> {
    block.clear();
    let mut reader = Reader {
        block,
        scanner: Scanner::new(text),
        values: Values { interpreter },
    };
    reader.line()
}

/// State: a line that is being read.
struct Reader<'a, 'b> {
    block: &'b mut Block,
    scanner: Scanner<'a>,
    values: Values<'b>,
}

impl Reader<'_, '_> {
    fn line(&mut self) -> Result<(), Fault> {
        let text = self.scanner.bytes();
        if self.values.interpreter.modal.goes_on {
            // Parameters of a cycle.
            self.goes_on();
            if self.values.interpreter.modal.awaits_preset {
                return self.preset();
            }
            return Ok(());
        }
        self.block.number = block_number(text);
        if let Some((place, _)) = &self.block.number {
            self.scanner.go_to(place.end);
        }
        let column = {
            self.scanner.peek();
            self.scanner.column()
        };
        match self.scanner.peek() {
            None | Some(b';' | b'*') => return Ok(()),
            Some(b'0'..=b'9') if self.block.number.is_none() => {
                return Err(Fault::Expression {
                    column,
                    what: "the number of a block above 1000000000",
                });
            }
            Some(b'/') => {
                return Err(not_followed(
                    column,
                    "/",
                    "whether a block is skipped, only the control knows",
                ));
            }
            _ => {}
        }
        if self.takes("BEGIN PGM") {
            return self.begins(column);
        }
        if self.takes("END PGM") {
            self.block.commands.push(Command::Ends);
            return Ok(());
        }
        for name in ["BLK FORM", "LBL", "FUNCTION MODE MILL", "QS"] {
            if self.takes(name) {
                self.goes_on();
                return Ok(());
            }
        }
        if self.motion()? || self.cycle()? || self.tool()? || self.parameter()? {
            return self.ends();
        }
        if self.takes("STOP") {
            self.m_words()?;
            return self.ends();
        }
        if self.takes("FUNCTION TCPM") {
            return self.tcpm(column);
        }
        if self.takes("FUNCTION RESET TCPM") {
            self.block.commands.push(Command::CentrePoint(false));
            return self.ends();
        }
        if self.scanner.peek() == Some(b'M') {
            self.m_words()?;
            return self.ends();
        }
        self.refuses(column)
    }

    /// Passes these words where they are next; blanks between may be more than one.
    fn takes(&mut self, words: &str) -> bool {
        let before = self.scanner.at();
        let all = words
            .split(' ')
            .all(|word| takes_name(&mut self.scanner, word) || self.takes_prefix(word));
        if !all {
            self.scanner.go_to(before);
        }
        all
    }

    /// `LBL5`, `QS3`, `FN0`: a name that goes on with a number.
    fn takes_prefix(&mut self, word: &str) -> bool {
        let at = self.scanner.at();
        let rest = self.scanner.bytes().get(at..).unwrap_or_default();
        let is_next = rest
            .get(..word.len())
            .is_some_and(|next| next.eq_ignore_ascii_case(word.as_bytes()));
        let then_digit = rest.get(word.len()).is_some_and(u8::is_ascii_digit);
        let is_taken = matches!(word, "LBL" | "QS" | "FN") && is_next && then_digit;
        if is_taken {
            self.scanner.go_to(at + word.len());
        }
        is_taken
    }

    /// `NAME MM`, behind BEGIN PGM.
    fn begins(&mut self, column: usize) -> Result<(), Fault> {
        let at = self.scanner.at();
        let rest = self.scanner.bytes().get(at..).unwrap_or_default();
        let rest = rest.split(|byte| *byte == b';').next().unwrap_or_default();
        let mut words = rest.split(|byte| matches!(byte, b' ' | b'\t'));
        let unit = words.rfind(|word| !word.is_empty()).unwrap_or_default();
        let code = match unit.to_ascii_uppercase().as_slice() {
            b"MM" => 21.0,
            b"INCH" => 20.0,
            _ => {
                return Err(not_followed(
                    column,
                    "BEGIN PGM",
                    "expected MM or INCH at its end",
                ));
            }
        };
        self.word(b'G', at, at..at, Some(code), Manner::Modal, None);
        Ok(())
    }

    /// A line of a block that began before.
    fn goes_on(&mut self) {
        if self.has_tilde() {
            self.block.commands.push(Command::GoesOn);
        }
    }

    /// `Q339=+1`, the number of the preset that cycle 247 chooses.
    fn preset(&mut self) -> Result<(), Fault> {
        let column = self.scanner.column();
        if q_parameter(&mut self.scanner) == Some(Parameter::Numbered(339))
            && self.scanner.takes(b'=')
        {
            let value = self.value("expected the number of a preset here")?;
            self.block.commands.push(Command::Preset(value));
            return Ok(());
        }
        if self.has_tilde() {
            return Ok(());
        }
        Err(not_followed(
            column,
            "CYCL DEF 247",
            "expected the number of its preset, Q339",
        ))
    }

    /// Whether the line ends with a tilde before its comment.
    fn has_tilde(&self) -> bool {
        let text = self.scanner.bytes();
        let before = text.split(|byte| *byte == b';').next().unwrap_or_default();
        // The tilde stands behind a comment in the files of controls.
        before.trim_ascii_end().ends_with(b"~") || text.trim_ascii_end().ends_with(b"~")
    }

    /// Nothing but a comment is left.
    fn ends(&mut self) -> Result<(), Fault> {
        match self.scanner.peek() {
            None | Some(b';') => Ok(()),
            Some(found) => Err(Fault::Character {
                column: self.scanner.column(),
                found: char::from(found),
            }),
        }
    }

    /// `FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS`, whose beginning is passed.
    fn tcpm(&mut self, column: usize) -> Result<(), Fault> {
        for words in ["F TCP", "AXIS POS", "PATHCTRL AXIS"] {
            if !self.takes(words) {
                return Err(not_followed(
                    column,
                    "FUNCTION TCPM",
                    "only F TCP AXIS POS PATHCTRL AXIS is followed",
                ));
            }
        }
        self.block.commands.push(Command::CentrePoint(true));
        self.ends()
    }

    /// `Q1 = ...`, `FN 1: Q1 = +Q2 + +3`.
    fn parameter(&mut self) -> Result<bool, Fault> {
        let (at, column) = (self.scanner.at(), self.scanner.column());
        let mut function = None;
        if self.takes("FN") {
            let number = plain_number(&mut self.scanner, b"");
            let number = number.map(|(number, _)| number);
            function = number.filter(|number| *number <= 5.0);
            if function.is_none() || !self.scanner.takes(b':') {
                return Err(not_followed(column, "FN", FLOW));
            }
        }
        let Some(parameter) = q_parameter(&mut self.scanner) else {
            self.scanner.go_to(at);
            return Ok(false);
        };
        if !self.scanner.takes(b'=') {
            return Err(Fault::Expression {
                column: self.scanner.column(),
                what: "expected = after a parameter that begins a block",
            });
        }
        self.scanner.peek();
        let (from, column) = (self.scanner.at(), self.scanner.column());
        let value = if let Some(function) = function {
            self.function(function)?
        } else {
            let value = self.values.operation(&mut self.scanner, 0, 0)?;
            value.ok_or(Fault::Expression {
                column,
                what: "expected the value of the parameter after =",
            })?
        };
        let to = self.scanner.at();
        self.block.assignments.push(Assignment {
            parameter,
            value,
            all: at..to,
            text: from..to,
        });
        Ok(true)
    }

    /// FN 0 to FN 5: a value, a sum, a difference, a product, `A DIV B`, `SQRT A`.
    fn function(&mut self, number: f64) -> Result<Value, Fault> {
        const WHAT: &str = "expected a number or a Q parameter here";
        let column = self.scanner.column();
        if number == 5.0 {
            takes_name(&mut self.scanner, "SQRT");
            let value = self.value(WHAT)?;
            return value.map(|x| finite(x.sqrt(), column)).transpose();
        }
        let first = self.value(WHAT)?;
        let operators = [
            ("+", Operator::Plus),
            ("-", Operator::Minus),
            ("*", Operator::Times),
            ("DIV", Operator::Over),
        ];
        let wanted = operators
            .iter()
            .zip(1..)
            .find(|(_, of)| f64::from(*of) == number);
        let Some(((name, operator), _)) = wanted else {
            return Ok(first);
        };
        let is_there = takes_name(&mut self.scanner, name)
            || *operator == Operator::Over && self.scanner.takes(b'/');
        if !is_there {
            return Err(Fault::Expression {
                column: self.scanner.column(),
                what: "expected the operator of this function: + - * DIV",
            });
        }
        let second = self.value(WHAT)?;
        match (first, second) {
            (Some(a), Some(b)) => Ok(Some(operate(*operator, a, b, column)?)),
            _ => Ok(None),
        }
    }

    /// What is refused, with the reason.
    fn refuses(&mut self, column: usize) -> Result<(), Fault> {
        const REASONS: [(&str, &str); 22] = [
            ("CALL LBL", FLOW),
            ("CALL PGM", FLOW),
            ("PGM CALL", FLOW),
            ("SEL", FLOW),
            ("IF", FLOW),
            ("PLANE", TILTED),
            ("TCH PROBE", OWN_RULE),
            ("PATTERN DEF", OWN_RULE),
            ("RND", "a rounded corner is a motion of its own"),
            ("CHF", "a bevelled corner is a motion of its own"),
            ("APPR", "approach and departure make motions of their own"),
            ("DEP", "approach and departure make motions of their own"),
            ("CT", "an arc by its tangent"),
            ("CTP", "an arc by its tangent"),
            (
                "LN",
                "directions of the tool are followed as angles of the rotary axes only",
            ),
            ("SPL", "a spline"),
            ("FL", "free contours are not followed"),
            ("FLT", "free contours are not followed"),
            ("FC", "free contours are not followed"),
            ("FCT", "free contours are not followed"),
            ("FPOL", "free contours are not followed"),
            ("FUNCTION", UNKNOWN),
        ];
        for (name, why) in REASONS {
            if self.takes(name) {
                return Err(not_followed(column, name, why));
            }
        }
        let at = self.scanner.at();
        let rest = self.scanner.bytes().get(at..).unwrap_or_default();
        let word = rest
            .split(u8::is_ascii_whitespace)
            .next()
            .unwrap_or_default();
        Err(not_followed(
            column,
            &String::from_utf8_lossy(word),
            UNKNOWN,
        ))
    }
}

fn not_followed(column: usize, found: &str, why: &'static str) -> Fault {
    Fault::NotFollowed {
        column,
        found: found.to_owned(),
        why,
    }
}
