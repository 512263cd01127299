//! Words of one letter: coordinates, G and M codes, tools.

use crate::{
    block::{LAST, Manner, OTHER},
    command::Command,
    coordinates::axis_of,
    fault::Fault,
    formula::{plain_number, takes_name},
    given::whole,
    siemens::{
        AXIS, Reader, SUBPROGRAM,
        codes::{Meaning, g_code},
        no_number, not_followed,
    },
};

impl Reader<'_, '_> {
    /// `S1=1000`, `M2=3`, `I1=5`, whose `=` is next.
    pub(super) fn numbered(&mut self, letter: u8, at: usize, column: usize) -> Result<(), Fault> {
        let found = self.found(at);
        match letter {
            b'S' | b'M' | b'H' | b'T' => {
                self.scanner.takes(b'=');
                self.other(at)?;
                Ok(())
            }
            b'A' | b'B' | b'C' => Err(not_followed(
                column,
                &found,
                "directions of the tool are followed as angles of the rotary axes only",
            )),
            b'I' | b'J' | b'K' => Err(not_followed(column, &found, "an arc by a place on it")),
            _ => Err(not_followed(column, &found, AXIS)),
        }
    }

    /// A word of one letter, which is passed.
    pub(super) fn lettered(&mut self, letter: u8, at: usize, column: usize) -> Result<(), Fault> {
        match letter {
            b'G' => self.g_code(at, column),
            b'X' | b'Y' | b'Z' | b'A' | b'B' | b'C' | b'U' | b'V' | b'W' | b'I' | b'J' | b'K'
            | b'F' => self.coordinate(letter, at, column),
            b'M' => self.m_code(at, column),
            b'S' | b'H' => {
                if self.scanner.takes(b'=') {
                    return self.other(at);
                }
                match self.number() {
                    Some(_) => Ok(()),
                    None => Err(no_number(column, letter)),
                }
            }
            b'T' => {
                let is_set = self.scanner.takes(b'=');
                if is_set && self.scanner.takes_text()? {
                    self.block.commands.push(Command::NamedTool);
                    return Ok(());
                }
                self.coordinate_value(b'T', at, column, is_set)
            }
            b'D' => {
                let value = if self.scanner.takes(b'=') {
                    self.value("expected a value here")?.0
                } else {
                    let number = self.number();
                    Some(number.ok_or_else(|| no_number(column, b'D'))?.0)
                };
                self.block.commands.push(Command::Edge(value));
                Ok(())
            }
            b'L' | b'P' => {
                self.number();
                Err(not_followed(column, &self.found(at), SUBPROGRAM))
            }
            _ => {
                self.number();
                Err(not_followed(column, &self.found(at), AXIS))
            }
        }
    }

    /// `X10`, `X=10`, `X=IC(10)`.
    pub(super) fn coordinate(&mut self, letter: u8, at: usize, column: usize) -> Result<(), Fault> {
        let is_set = self.scanner.takes(b'=');
        self.coordinate_value(letter, at, column, is_set)
    }

    pub(super) fn coordinate_value(
        &mut self,
        letter: u8,
        at: usize,
        column: usize,
        is_set: bool,
    ) -> Result<(), Fault> {
        if !is_set {
            self.scanner.peek();
            let from = self.scanner.at();
            let (value, decimals) = self.number().ok_or_else(|| no_number(column, letter))?;
            let text = from..self.scanner.at();
            self.word(letter, at, text, Some(value), Manner::Modal, Some(decimals));
            return Ok(());
        }
        let column = {
            self.scanner.peek();
            self.scanner.column()
        };
        let manner = self.manner(letter, column)?;
        self.scanner.peek();
        let from = self.scanner.at();
        let (value, decimals) = self.value("expected a number, a parameter or a formula here")?;
        let text = self.without_blanks(from);
        if manner != Manner::Modal && !self.scanner.takes(b')') {
            return Err(Fault::Expression {
                column: self.scanner.column(),
                what: "expected ) here",
            });
        }
        self.word(letter, at, text, value, manner, decimals);
        Ok(())
    }

    /// `IC(`, `AC(` or `DC(`, where one is next.
    pub(super) fn manner(&mut self, letter: u8, column: usize) -> Result<Manner, Fault> {
        let is_axis = axis_of(letter).is_some();
        for (name, manner) in [
            ("IC", Manner::Incremental),
            ("AC", Manner::Absolute),
            ("DC", Manner::Shortest),
        ] {
            let before = self.scanner.at();
            if takes_name(&mut self.scanner, name) {
                let is_taken = is_axis || manner != Manner::Shortest && b"IJK".contains(&letter);
                if is_taken && self.scanner.takes(b'(') {
                    return Ok(manner);
                }
                self.scanner.go_to(before);
            }
        }
        for (name, why) in [
            ("ACP", "a rotary axis that comes from one side"),
            ("ACN", "a rotary axis that comes from one side"),
            ("CIC", "coded places, which only the control knows"),
            ("CAC", "coded places, which only the control knows"),
            ("CDC", "coded places, which only the control knows"),
            ("CACP", "coded places, which only the control knows"),
            ("CACN", "coded places, which only the control knows"),
        ] {
            if takes_name(&mut self.scanner, name) {
                return Err(not_followed(column, name, why));
            }
        }
        Ok(Manner::Modal)
    }

    pub(super) fn g_code(&mut self, at: usize, column: usize) -> Result<(), Fault> {
        let from = self.scanner.at();
        let number = plain_number(&mut self.scanner, b"");
        let code = number.and_then(|(number, _)| whole(number, 9999));
        let Some(code) = code else {
            return Err(no_number(column, b'G'));
        };
        let (group, meaning) = g_code(code);
        if group > 0 {
            if let Some((_, other)) = self.groups.iter().find(|(of, _)| *of == group) {
                return Err(Fault::Twice {
                    found: format!("G{code}"),
                    other: format!("G{other}"),
                });
            }
            self.groups.push((group, code));
        }
        match meaning {
            Meaning::Code(value) => {
                let text = from..self.scanner.at();
                self.word(b'G', at, text, Some(value), Manner::Modal, Some(0));
            }
            Meaning::Command(command) => self.block.commands.push(command),
            Meaning::Nothing => {}
            Meaning::Dwell => self.dwells = true,
            Meaning::Limits => self.limits = true,
            Meaning::Refused(why) => {
                return Err(not_followed(column, &format!("G{code}"), why));
            }
        }
        Ok(())
    }

    pub(super) fn m_code(&mut self, at: usize, column: usize) -> Result<(), Fault> {
        if self.scanner.takes(b'=') {
            return self.other(at);
        }
        let from = self.scanner.at();
        let (value, _) = self.number().ok_or_else(|| no_number(column, b'M'))?;
        let text = from..self.scanner.at();
        match value {
            0.0 | 1.0 => self.word(LAST, at, text, Some(value), Manner::Modal, None),
            2.0 | 17.0 | 30.0 => {
                self.word(LAST, at, text, Some(value), Manner::Modal, None);
                self.block.commands.push(Command::Ends);
            }
            6.0 => self.block.commands.push(Command::ChangeTool),
            _ => self.word(OTHER, at, text, Some(value), Manner::Modal, None),
        }
        Ok(())
    }
}
