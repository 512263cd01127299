//! Cycles, shifts of the datum, and tools.

use crate::{
    command::Command,
    cycles::Cycle,
    fault::Fault,
    formula::{plain_number, takes_name},
    heidenhain::{FLOW, OWN_RULE, Reader, TILTED, not_followed},
    parameters::Value,
};

impl Reader<'_, '_> {
    /// `CYCL DEF`, `CYCL CALL`, `TRANS DATUM`; false: the line is none of these.
    pub(super) fn cycle(&mut self) -> Result<bool, Fault> {
        let column = self.scanner.column();
        if self.takes("CYCL DEF") {
            self.defines_cycle(column)?;
            return Ok(true);
        }
        if self.takes("CYCL CALL") {
            for name in ["PAT", "POS"] {
                if takes_name(&mut self.scanner, name) {
                    return Err(not_followed(
                        column,
                        "CYCL CALL",
                        "holes at places of their own",
                    ));
                }
            }
            self.block.commands.push(Command::CallsDefined);
            self.m_words()?;
            return Ok(true);
        }
        if self.takes("TRANS DATUM") {
            if takes_name(&mut self.scanner, "RESET") {
                self.block.commands.push(Command::Shift { adds: false });
            } else if takes_name(&mut self.scanner, "AXIS") {
                self.block.commands.push(Command::Datum);
                while self.axis_word()? {}
            } else {
                return Err(not_followed(
                    column,
                    "TRANS DATUM",
                    "a datum that only the control knows",
                ));
            }
            return Ok(true);
        }
        Ok(false)
    }

    /// The number of a cycle, and what stands behind it.
    fn defines_cycle(&mut self, column: usize) -> Result<(), Fault> {
        let whole = plain_number(&mut self.scanner, b"");
        let number = whole.and_then(|(number, _)| crate::given::whole(number, 9999));
        let Some(number) = number else {
            return Err(Fault::Expression {
                column,
                what: "expected the number of a cycle behind CYCL DEF",
            });
        };
        let part = if self.scanner.takes(b'.') {
            let part = plain_number(&mut self.scanner, b"");
            part.and_then(|(part, _)| crate::given::whole(part, 99))
        } else {
            None
        };
        let found = format!("CYCL DEF {number}");
        match number {
            7 => match part {
                Some(0) => self.skips(),
                Some(_) => {
                    self.block.commands.push(Command::Datum);
                    while self.axis_word()? {}
                    if self.block.words.is_empty() {
                        let why = "a datum that only the control knows";
                        return Err(not_followed(column, &found, why));
                    }
                }
                None => return Err(not_followed(column, &found, TILTED)),
            },
            247 if self.has_tilde() => {
                self.block.commands.push(Command::AwaitsPreset);
                self.skips();
            }
            8 | 10 | 11 | 19 | 26 | 247 => return Err(not_followed(column, &found, TILTED)),
            12 => return Err(not_followed(column, &found, FLOW)),
            // A dwell, the angle of the spindle, the tolerance of contours; data of contours.
            9 | 13 | 14 | 20 | 32 | 270 => self.skips(),
            // Patterns are drilled where they stand.
            220 | 221 => {
                let cycle = Cycle {
                    name: found,
                    drills_to: None,
                };
                self.block.commands.push(Command::Cycle(cycle));
                self.skips();
            }
            1..=5
            | 17
            | 18
            | 21..=25
            | 200..=209
            | 225
            | 230..=233
            | 240
            | 241
            | 251..=258
            | 262..=267
            | 271..=276 => {
                let only_drills = matches!(number, 1 | 2 | 17 | 200..=209 | 240 | 241);
                let cycle = Cycle {
                    name: format!("cycle {number}"),
                    drills_to: only_drills.then_some(None),
                };
                self.block.commands.push(Command::Defines(cycle));
                self.skips();
            }
            _ => return Err(not_followed(column, &found, OWN_RULE)),
        }
        Ok(())
    }

    /// Passes the rest of the line, which may go on in the next one.
    fn skips(&mut self) {
        self.goes_on();
        self.scanner.go_to(usize::MAX);
    }

    /// `TOOL CALL`, `TOOL DEF`; false: the line is neither.
    pub(super) fn tool(&mut self) -> Result<bool, Fault> {
        let column = self.scanner.column();
        if self.takes("TOOL DEF") {
            if self.scanner.takes_text()? {
                self.skips();
                return Ok(true);
            }
            let tool = self.value("expected the number of a tool here")?;
            while let Some(letter @ (b'L' | b'R')) = self.scanner.peek() {
                self.scanner.next();
                let length = self.value("expected a length or a radius here")?;
                if letter == b'L' {
                    let command = Command::DefinesTool { tool, length };
                    self.block.commands.push(command);
                }
            }
            return Ok(true);
        }
        if !self.takes("TOOL CALL") {
            return Ok(false);
        }
        let tool = if self.scanner.takes_text()? {
            Some(None)
        } else {
            let value = self.values.of_word(&mut self.scanner)?;
            value.map(|(value, _)| value)
        };
        let mut longer: Value = Some(0.0);
        loop {
            match self.scanner.peek() {
                Some(b'Z') => {
                    self.scanner.next();
                }
                Some(b'X' | b'Y') => {
                    return Err(not_followed(
                        column,
                        "TOOL CALL",
                        "another axis of the tool than Z",
                    ));
                }
                Some(b'S' | b'F') => {
                    self.scanner.next();
                    self.value("expected a speed or a feed here")?;
                }
                Some(b'D') => {
                    let is_length = takes_prefix(&mut self.scanner, "DL");
                    let is_radius = takes_prefix(&mut self.scanner, "DR2")
                        || takes_prefix(&mut self.scanner, "DR");
                    if !is_length && !is_radius {
                        break;
                    }
                    self.scanner.takes(b':');
                    let value = self.value("expected an allowance here")?;
                    if is_length {
                        longer = value;
                    }
                }
                _ => break,
            }
        }
        if let Some(tool) = tool {
            self.block
                .commands
                .push(Command::CallsTool { tool, longer });
        }
        Ok(true)
    }
}

/// Passes letters whatever follows.
fn takes_prefix(scanner: &mut crate::scan::Scanner<'_>, letters: &str) -> bool {
    scanner.peek();
    let at = scanner.at();
    let rest = scanner.bytes().get(at..).unwrap_or_default();
    let is_next = rest
        .get(..letters.len())
        .is_some_and(|next| next.eq_ignore_ascii_case(letters.as_bytes()));
    if is_next {
        scanner.go_to(at + letters.len());
    }
    is_next
}
