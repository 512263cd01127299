//! What begins with a name of several letters: frames, transformations, cycles, variables.

use crate::{
    block::{Assignment, Parameter},
    command::Command,
    cycles::Cycle,
    fault::Fault,
    formula::{Formulas, takes_name},
    modal::Plane,
    parameters::Value,
    siemens::{
        AXIS, Reader, SUBPROGRAM,
        codes::{self, Meaning, UNKNOWN, only_drills},
        no_number, not_followed,
        values::{identifier, passes_brackets},
    },
};

impl Reader<'_, '_> {
    /// What begins with a name of several letters, which is passed.
    pub(super) fn named(&mut self, name: &str, at: usize, column: usize) -> Result<(), Fault> {
        match name {
            "CR" => {
                if !self.scanner.takes(b'=') {
                    return Err(not_followed(column, name, "expected CR= and a radius"));
                }
                return self.coordinate_value(b'R', at, column, true);
            }
            "ROT" | "AROT" => return self.turn(name == "AROT"),
            "TRAORI" => return self.traori(column),
            "MCALL" => return self.each_motion(),
            "DEF" => return self.define(),
            "PROC" | "EXTERN" => {
                self.skip_line();
                return Ok(());
            }
            _ => {}
        }
        if let Some(only_drills) = only_drills(name) {
            let cycle = self.cycle(name, only_drills)?;
            self.block.commands.push(Command::Cycle(cycle));
            return Ok(());
        }
        let lower = name.to_ascii_lowercase();
        if self.interpreter.parameters.named(&lower).is_some() {
            if passes_brackets(&mut self.scanner, b'[', b']') {
                self.scanner.takes(b'=');
                return self.skip_value();
            }
            return self.assign(Parameter::Named(lower), at);
        }
        match codes::name(name) {
            Meaning::Command(command) => {
                self.block.commands.push(command);
                passes_brackets(&mut self.scanner, b'(', b')');
                Ok(())
            }
            Meaning::Refused(why) => {
                let why = match self.scanner.peek() {
                    Some(b'=') if why == UNKNOWN => AXIS,
                    None | Some(b'(' | b';') if why == UNKNOWN => SUBPROGRAM,
                    _ => why,
                };
                Err(not_followed(column, name, why))
            }
            _ => {
                passes_brackets(&mut self.scanner, b'[', b']');
                if self.scanner.takes(b'=') {
                    return self.other(at);
                }
                passes_brackets(&mut self.scanner, b'(', b')');
                Ok(())
            }
        }
    }

    /// `ROT RPL=30`, `ROT Z30`, `ROT`.
    pub(super) fn turn(&mut self, adds: bool) -> Result<(), Fault> {
        const TILTS: &str = "only rotations about Z are followed: RPL= in G17, or Z";
        let mut angle = Some(0.0);
        while let Some(byte) = self.scanner.peek() {
            let column = self.scanner.column();
            if byte == b';' {
                break;
            }
            if takes_name(&mut self.scanner, "RPL") {
                let plane = self.interpreter.modal.plane;
                if plane != Plane::Xy {
                    return Err(not_followed(column, "RPL", TILTS));
                }
            } else if byte == b'Z' {
                self.scanner.next();
            } else {
                return Err(not_followed(column, &char::from(byte).to_string(), TILTS));
            }
            angle = if self.scanner.takes(b'=') {
                self.value("expected an angle here")?.0
            } else {
                let number = self.number();
                Some(number.ok_or_else(|| no_number(column, b'Z'))?.0)
            };
        }
        self.block.commands.push(Command::Turn {
            adds,
            angle_deg: angle,
        });
        Ok(())
    }

    /// `TRAORI`, `TRAORI(1)`.
    pub(super) fn traori(&mut self, column: usize) -> Result<(), Fault> {
        if self.scanner.takes(b'(') {
            let (number, _) = self.value("expected the number of a transformation here")?;
            if number != Some(1.0) || !self.scanner.takes(b')') {
                return Err(not_followed(
                    column,
                    "TRAORI",
                    "only the first transformation without further arguments: TRAORI, TRAORI(1)",
                ));
            }
        }
        self.block.commands.push(Command::CentrePoint(true));
        Ok(())
    }

    /// `MCALL`, `MCALL CYCLE81(...)`.
    pub(super) fn each_motion(&mut self) -> Result<(), Fault> {
        let cycle = if matches!(self.scanner.peek(), None | Some(b';')) {
            None
        } else {
            let column = self.scanner.column();
            let name = identifier(&mut self.scanner).unwrap_or_default();
            let Some(only_drills) = only_drills(&name) else {
                return Err(not_followed(column, &format!("MCALL {name}"), SUBPROGRAM));
            };
            Some(self.cycle(&name, only_drills)?)
        };
        self.block.commands.push(Command::EachMotion(cycle));
        Ok(())
    }

    /// The arguments of a cycle, whose name is passed.
    pub(super) fn cycle(&mut self, name: &str, only_drills: bool) -> Result<Cycle, Fault> {
        let mut inside = self.scanner.clone();
        let column = inside.column();
        if !passes_brackets(&mut self.scanner, b'(', b')') {
            if matches!(self.scanner.peek(), None | Some(b';')) {
                return Ok(Cycle {
                    name: name.to_owned(),
                    drills_to: None,
                });
            }
            return Err(Fault::Expression {
                column,
                what: "expected the arguments of the cycle in brackets",
            });
        }
        inside.takes(b'(');
        let ends = self.values().read(&mut inside)?;
        let ends = ends.and_then(|read| read.value);
        Ok(Cycle {
            name: name.to_owned(),
            drills_to: only_drills.then_some(ends),
        })
    }

    /// `DEF REAL A=5, B`: variables of the program.
    pub(super) fn define(&mut self) -> Result<(), Fault> {
        loop {
            let column = self.scanner.column();
            let Some(kind) = identifier(&mut self.scanner) else {
                return Err(Fault::Expression {
                    column,
                    what: "expected the type of a variable after DEF",
                });
            };
            if matches!(kind.as_str(), "REAL" | "INT" | "BOOL") {
                break;
            }
            if matches!(kind.as_str(), "CHAR" | "STRING" | "AXIS" | "FRAME") {
                self.skip_line();
                return Ok(());
            }
        }
        loop {
            self.scanner.peek();
            let at = self.scanner.at();
            let column = self.scanner.column();
            let Some(name) = identifier(&mut self.scanner) else {
                return Err(Fault::Expression {
                    column,
                    what: "expected the name of a variable here",
                });
            };
            let parameter = Parameter::Named(name.to_ascii_lowercase());
            if passes_brackets(&mut self.scanner, b'[', b']') {
                // The values of a field are not followed.
                self.set(parameter, None, at);
                self.skip_line();
                return Ok(());
            }
            if self.scanner.peek() == Some(b'=') {
                self.assign(parameter, at)?;
            } else {
                self.set(parameter, Some(0.0), at);
            }
            if !self.scanner.takes(b',') {
                return Ok(());
            }
        }
    }

    pub(super) fn set(&mut self, parameter: Parameter, value: Value, at: usize) {
        let end = self.scanner.at();
        self.block.assignments.push(Assignment {
            parameter,
            value,
            all: at..end,
            text: end..end,
        });
    }

    /// Passes the rest of the line up to its comment.
    pub(super) fn skip_line(&mut self) {
        let at = self.scanner.at();
        let rest = self.scanner.bytes().get(at..).unwrap_or_default();
        let mut in_text = false;
        let ends = rest.iter().position(|byte| {
            in_text ^= *byte == b'"';
            *byte == b';' && !in_text
        });
        self.scanner.go_to(at + ends.unwrap_or(rest.len()));
    }
}
