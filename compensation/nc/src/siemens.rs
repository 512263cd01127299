//! The language of SINUMERIK controls.
//!
//! Words that have an RS-274 equivalent get its letter and code: `CR=` is R, G71 is G21. Unknown words, which might
//! move an axis, are rejected with their column. The meaning of codes and names is from memory of the programming
//! manual, not verified on a control.

use crate::{
    block::{
        Assignment, Block, BlockStart, Command, Cycle, LAST, Manner, OTHER, Parameter, Scanner,
        Word,
    },
    codes::whole,
    coordinates::axis_of,
    error::{Column, FLOW, Fault, OWN_RULE, UNKNOWN},
    expression::{Formulas, Operator, WordValue, plain_number, takes_name, whole_number},
    interpreter::Interpreter,
    modal::{G500, G505, Plane},
    parameters::{MOST, Value},
};

const AXIS: &str = "an unknown axis or address";

const SUBPROGRAM: &str =
    "it may be a subprogram, and subprograms are not supported in this language";

/// Parses a block; `text` is the line without its terminator.
pub(crate) fn read_siemens(
    block: &mut Block,
    text: &[u8],
    interpreter: &Interpreter,
) -> Result<(), Fault> {
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

struct Reader<'a, 'b> {
    block: &'b mut Block,
    scanner: Scanner<'a>,
    interpreter: &'b Interpreter,
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
                    return Err(column
                        .not_followed("$", "variables of the control may shift its coordinates"));
                }
                b'%' if self.block.end == 0 => {
                    // Program name in an archive.
                    self.scanner.go_to(usize::MAX);
                }
                other => {
                    return Err(column.character(other));
                }
            }
            self.block.end = self.scanner.at();
        }
        let (dwells, limits) = (self.dwells, self.limits);
        let means = |word: &Word| match word.letter {
            b'F' => !dwells,
            letter => !limits || axis_of(letter).is_none(),
        };
        self.block.words.retain(means);
        Ok(())
    }

    /// Reads `/3 N10 LABEL:`.
    fn begins(&mut self) {
        let scanner = &mut self.scanner;
        if scanner.takes(b'/') {
            let at = scanner.at() - 1;
            let digit = scanner.bytes().get(at + 1);
            if digit.is_some_and(u8::is_ascii_digit) {
                scanner.go_to(at + 2);
            }
            self.block.begins = BlockStart::Slash;
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
        Values { interpreter: self.interpreter, set: &self.block.assignments }
    }

    fn read(&mut self) -> Result<Option<WordValue>, Fault> {
        let values = Values { interpreter: self.interpreter, set: &self.block.assignments };
        values.read(&mut self.scanner)
    }

    fn statement(&mut self) -> Result<(), Fault> {
        let (at, column) = (self.scanner.at(), self.scanner.column());
        let bytes = self.scanner.bytes();
        let is_letter = |place: usize| {
            bytes.get(place).is_some_and(|byte| byte.is_ascii_alphabetic() || *byte == b'_')
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

    /// True if `==` is next, a comparison.
    fn next_is_equal(&self) -> bool {
        let rest = self.scanner.bytes().get(self.scanner.at()..);
        rest.is_some_and(|rest| rest.starts_with(b"=="))
    }

    fn found(&self, at: usize) -> String {
        let text = self.scanner.bytes().get(at..self.scanner.at());
        String::from_utf8_lossy(text.unwrap_or_default().trim_ascii()).into_owned()
    }

    /// Skips the value after an address that does not affect coordinates. The word is executed with the motion of its
    /// block.
    fn other(&mut self, at: usize) -> Result<(), Fault> {
        self.skip_value()?;
        let text = self.scanner.at()..self.scanner.at();
        let value = Some(0.0);
        self.block.push(OTHER, at, text, value, Manner::Modal, None);
        Ok(())
    }

    /// Skips a value of any kind: a formula, a text, a name with arguments.
    fn skip_value(&mut self) -> Result<(), Fault> {
        if self.scanner.takes_text()? {
            return Ok(());
        }
        let column = self.scanner.column();
        let read = self.read()?;
        read.map(|_read| ()).ok_or(column.malformed("expected a value here"))
    }

    /// Reads `R5=...` or `R[5]=...`.
    fn r_parameter(&mut self, at: usize) -> Result<(), Fault> {
        let column = self.scanner.column();
        let values = Values { interpreter: self.interpreter, set: &self.block.assignments };
        match r_parameter(&values, &mut self.scanner, 0)? {
            Some(Some(number)) => self.assign(Parameter::Numbered(number), at),
            Some(None) => {
                Err(column.malformed("only the machine knows which parameter is set here"))
            }
            None => Err(column.not_followed("R", UNKNOWN)),
        }
    }

    /// Reads `= ...` after a parameter.
    fn assign(&mut self, parameter: Parameter, at: usize) -> Result<(), Fault> {
        let column = self.scanner.column();
        if !self.scanner.takes(b'=') {
            return Err(column.malformed("expected = after a parameter that begins a word"));
        }
        self.scanner.peek();
        let from = self.scanner.at();
        let value = if self.scanner.takes_text()? {
            None
        } else {
            self.value("expected the value of the parameter after =")?.0
        };
        let text = self.without_blanks(from);
        self.block.assignments.push(Assignment { parameter, value, all: at..text.end, text });
        Ok(())
    }

    /// Range of the text read since `from`, without trailing blanks.
    fn without_blanks(&self, from: usize) -> std::ops::Range<usize> {
        let text = self.scanner.bytes().get(from..self.scanner.at());
        from..from + text.unwrap_or_default().trim_ascii_end().len()
    }

    fn value(&mut self, what: &'static str) -> Result<WordValue, Fault> {
        let column = self.scanner.column();
        self.read()?.ok_or(column.malformed(what))
    }

    /// Reads a signed number that follows a letter without `=`.
    fn number(&mut self) -> Option<(f64, u8)> {
        let sign = match self.scanner.peek() {
            Some(b'-') => -1.0,
            _ => 1.0,
        };
        let before = self.scanner.at();
        if !self.scanner.takes(b'-') {
            self.scanner.takes(b'+');
        }
        let number = exponent_number(&mut self.scanner);
        if number.is_none() {
            self.scanner.go_to(before);
        }
        number.map(|(value, decimals)| (sign * value, decimals))
    }

    /// Reads the value or the arguments after a name of several letters.
    pub(crate) fn named(&mut self, name: &str, at: usize, column: Column) -> Result<(), Fault> {
        match name {
            "CR" => {
                if !self.scanner.takes(b'=') {
                    return Err(column.not_followed(name, "expected CR= and a radius"));
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
        match meaning_of(name) {
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
                Err(column.not_followed(name, why))
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

    /// Reads `ROT RPL=30`, `ROT Z30`, `ROT`.
    pub(crate) fn turn(&mut self, adds: bool) -> Result<(), Fault> {
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
                    return Err(column.not_followed("RPL", TILTS));
                }
            } else if byte == b'Z' {
                self.scanner.next();
            } else {
                return Err(column.not_followed(&char::from(byte).to_string(), TILTS));
            }
            angle = if self.scanner.takes(b'=') {
                self.value("expected an angle here")?.0
            } else {
                let number = self.number();
                Some(number.ok_or_else(|| column.no_number(b'Z'))?.0)
            };
        }
        self.block.commands.push(Command::Rotation { adds, angle_deg: angle });
        Ok(())
    }

    /// Reads the argument of `TRAORI`, `TRAORI(1)`.
    fn traori(&mut self, column: Column) -> Result<(), Fault> {
        if self.scanner.takes(b'(') {
            let (number, _) = self.value("expected the number of a transformation here")?;
            if number != Some(1.0) || !self.scanner.takes(b')') {
                return Err(column.not_followed(
                    "TRAORI",
                    "only the first transformation without further arguments: TRAORI, TRAORI(1)",
                ));
            }
        }
        self.block.commands.push(Command::CentrePoint(true));
        Ok(())
    }

    /// Reads the rest of `MCALL`, `MCALL CYCLE81(...)`.
    pub(crate) fn each_motion(&mut self) -> Result<(), Fault> {
        let cycle = if matches!(self.scanner.peek(), None | Some(b';')) {
            None
        } else {
            let column = self.scanner.column();
            let name = identifier(&mut self.scanner).unwrap_or_default();
            let Some(only_drills) = only_drills(&name) else {
                return Err(column.not_followed(&format!("MCALL {name}"), SUBPROGRAM));
            };
            Some(self.cycle(&name, only_drills)?)
        };
        self.block.commands.push(Command::EachMotion(cycle));
        Ok(())
    }

    pub(crate) fn cycle(&mut self, name: &str, only_drills: bool) -> Result<Cycle, Fault> {
        let mut inside = self.scanner.clone();
        let column = inside.column();
        if !passes_brackets(&mut self.scanner, b'(', b')') {
            if matches!(self.scanner.peek(), None | Some(b';')) {
                return Ok(Cycle { name: name.to_owned(), drills_to: None });
            }
            return Err(column.malformed("expected the arguments of the cycle in brackets"));
        }
        inside.takes(b'(');
        let ends = self.values().read(&mut inside)?;
        let ends = ends.and_then(|(value, _)| value);
        Ok(Cycle { name: name.to_owned(), drills_to: only_drills.then_some(ends) })
    }

    /// Reads `DEF REAL A=5, B`: variables of the program.
    fn define(&mut self) -> Result<(), Fault> {
        loop {
            let column = self.scanner.column();
            let Some(kind) = identifier(&mut self.scanner) else {
                return Err(column.malformed("expected the type of a variable after DEF"));
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
                return Err(column.malformed("expected the name of a variable here"));
            };
            let parameter = Parameter::Named(name.to_ascii_lowercase());
            if passes_brackets(&mut self.scanner, b'[', b']') {
                // The values of an array are not tracked.
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

    pub(crate) fn set(&mut self, parameter: Parameter, value: Value, at: usize) {
        let end = self.scanner.at();
        self.block.assignments.push(Assignment { parameter, value, all: at..end, text: end..end });
    }

    fn skip_line(&mut self) {
        let (at, rest) = (self.scanner.at(), self.scanner.rest());
        let mut in_text = false;
        let ends = rest.iter().position(|byte| {
            in_text ^= *byte == b'"';
            *byte == b';' && !in_text
        });
        self.scanner.go_to(at + ends.unwrap_or(rest.len()));
    }

    /// Reads the value of `S1=1000`, `M2=3`, `I1=5`, from the `=` on.
    pub(crate) fn numbered(&mut self, letter: u8, at: usize, column: Column) -> Result<(), Fault> {
        let found = self.found(at);
        match letter {
            b'S' | b'M' | b'H' | b'T' => {
                self.scanner.takes(b'=');
                self.other(at)?;
                Ok(())
            }
            b'A' | b'B' | b'C' => Err(column.not_followed(
                &found,
                "tool directions are supported as angles of the rotary axes only",
            )),
            b'I' | b'J' | b'K' => {
                Err(column.not_followed(&found, "an arc by an intermediate point"))
            }
            _ => Err(column.not_followed(&found, AXIS)),
        }
    }

    fn lettered(&mut self, letter: u8, at: usize, column: Column) -> Result<(), Fault> {
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
                    None => Err(column.no_number(letter)),
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
                    Some(number.ok_or_else(|| column.no_number(b'D'))?.0)
                };
                self.block.commands.push(Command::Edge(value));
                Ok(())
            }
            b'L' | b'P' => {
                self.number();
                Err(column.not_followed(&self.found(at), SUBPROGRAM))
            }
            _ => {
                self.number();
                Err(column.not_followed(&self.found(at), AXIS))
            }
        }
    }

    /// Reads `X10`, `X=10`, `X=IC(10)`.
    pub(crate) fn coordinate(
        &mut self,
        letter: u8,
        at: usize,
        column: Column,
    ) -> Result<(), Fault> {
        let is_set = self.scanner.takes(b'=');
        self.coordinate_value(letter, at, column, is_set)
    }

    fn coordinate_value(
        &mut self,
        letter: u8,
        at: usize,
        column: Column,
        is_set: bool,
    ) -> Result<(), Fault> {
        if !is_set {
            self.scanner.peek();
            let from = self.scanner.at();
            let (value, decimals) = self.number().ok_or_else(|| column.no_number(letter))?;
            let text = from..self.scanner.at();
            self.block.push(letter, at, text, Some(value), Manner::Modal, Some(decimals));
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
            return Err(self.scanner.column().malformed("expected ) here"));
        }
        self.block.push(letter, at, text, value, manner, decimals);
        Ok(())
    }

    /// Consumes `IC(`, `AC(` or `DC(`, if one is next.
    pub(crate) fn manner(&mut self, letter: u8, column: Column) -> Result<Manner, Fault> {
        let is_axis = axis_of(letter).is_some();
        for (name, manner) in
            [("IC", Manner::Incremental), ("AC", Manner::Absolute), ("DC", Manner::Shortest)]
        {
            let before = self.scanner.at();
            if takes_name(&mut self.scanner, name) {
                let is_taken = is_axis || manner != Manner::Shortest && b"IJK".contains(&letter);
                if is_taken && self.scanner.takes(b'(') {
                    return Ok(manner);
                }
                self.scanner.go_to(before);
            }
        }
        for name in ["ACP", "ACN", "CIC", "CAC", "CDC", "CACP", "CACN"] {
            if takes_name(&mut self.scanner, name) {
                let why = if name.starts_with('A') {
                    "a rotary axis that approaches from one side"
                } else {
                    "coded positions, which only the control knows"
                };
                return Err(column.not_followed(name, why));
            }
        }
        Ok(Manner::Modal)
    }

    fn g_code(&mut self, at: usize, column: Column) -> Result<(), Fault> {
        let from = self.scanner.at();
        let code = whole_number(&mut self.scanner, 9999).ok_or(column.no_number(b'G'))?;
        let (group, meaning) = g_code(code);
        if group > 0 {
            if let Some((_, other)) = self.groups.iter().find(|(of, _)| *of == group) {
                return Err(Fault::Twice { found: format!("G{code}"), other: format!("G{other}") });
            }
            self.groups.push((group, code));
        }
        match meaning {
            Meaning::Code(value) => {
                let text = from..self.scanner.at();
                let value = Some(value);
                self.block.push(b'G', at, text, value, Manner::Modal, Some(0));
            }
            Meaning::Command(command) => self.block.commands.push(command),
            // An exact stop applies to the end of a motion.
            Meaning::Nothing if code == 9 => {
                let text = from..self.scanner.at();
                self.block.push(LAST, at, text, Some(9.0), Manner::Modal, None);
            }
            Meaning::Nothing => {}
            Meaning::Dwell => self.dwells = true,
            Meaning::Limits => self.limits = true,
            Meaning::Refused(why) => {
                return Err(column.not_followed(&format!("G{code}"), why));
            }
        }
        Ok(())
    }

    pub(crate) fn m_code(&mut self, at: usize, column: Column) -> Result<(), Fault> {
        if self.scanner.takes(b'=') {
            return self.other(at);
        }
        let from = self.scanner.at();
        let (value, _) = self.number().ok_or_else(|| column.no_number(b'M'))?;
        let (letter, command) = match value {
            0.0 | 1.0 => (LAST, None),
            2.0 | 17.0 | 30.0 => (LAST, Some(Command::Ends)),
            6.0 => {
                self.block.commands.push(Command::ChangeTool);
                return Ok(());
            }
            _ => (OTHER, None),
        };
        let text = from..self.scanner.at();
        let value = Some(value);
        self.block.push(letter, at, text, value, Manner::Modal, None);
        self.block.commands.extend(command);
        Ok(())
    }
}

/// Number of a parameter; `None` if it is only known at the machine.
type Number = Option<u32>;

/// Values of a block; parameters have their values from before the block.
pub(crate) struct Values<'b> {
    pub(crate) interpreter: &'b Interpreter,
    pub(crate) set: &'b [Assignment],
}

impl Formulas for Values<'_> {
    const OPERATORS: &'static [&'static [(&'static str, Operator)]] = &[
        &[("+", Operator::Plus), ("-", Operator::Minus)],
        &[
            ("*", Operator::Times),
            ("/", Operator::Over),
            ("DIV", Operator::WholeOver),
            ("MOD", Operator::Rest),
        ],
    ];
    const FUNCTIONS: &'static [(&'static str, fn(f64) -> f64)] =
        &[("POT", |x| x * x), ("ROUND", f64::round), ("TRUNC", f64::trunc)];
    const PAIRS: &'static [(&'static str, fn(f64, f64) -> f64)] =
        &[("ATAN2", |y, x| y.atan2(x).to_degrees()), ("MINVAL", f64::min), ("MAXVAL", f64::max)];

    fn number(&self, scanner: &mut Scanner<'_>) -> Option<(f64, u8)> {
        exponent_number(scanner)
    }

    fn parameter(&self, scanner: &mut Scanner<'_>, depth: u32) -> Result<Option<Value>, Fault> {
        let column = scanner.column();
        let parameters = &self.interpreter.parameters;
        if let Some(number) = r_parameter(self, scanner, depth)? {
            self.is_settled(number.map(Parameter::Numbered).as_ref(), column)?;
            let value = number.and_then(|number| parameters.set_number(number));
            return Ok(Some(value.unwrap_or(None)));
        }
        if takes_name(scanner, "$PI") {
            return Ok(Some(Some(std::f64::consts::PI)));
        }
        let is_system = scanner.takes(b'$');
        let Some(name) = identifier(scanner) else {
            return Ok(None);
        };
        let is_element = passes_brackets(scanner, b'[', b']');
        let has_arguments = passes_brackets(scanner, b'(', b')');
        if is_system || is_element || has_arguments {
            // Only known to the control.
            return Ok(Some(None));
        }
        let name = name.to_ascii_lowercase();
        self.is_settled(Some(&Parameter::Named(name.clone())), column)?;
        Ok(Some(match name.as_str() {
            "true" => Some(1.0),
            "false" => Some(0.0),
            _ => parameters.named(&name).unwrap_or(None),
        }))
    }
}

impl Values<'_> {
    /// Rejects reading a parameter that the same block sets: the order of evaluation is unknown.
    fn is_settled(&self, parameter: Option<&Parameter>, column: Column) -> Result<(), Fault> {
        let is_set = |parameter: &Parameter| self.set.iter().any(|set| set.parameter == *parameter);
        if parameter.is_some_and(is_set) {
            return Err(column.malformed(
                "a parameter that the same block sets before: write the two in separate blocks",
            ));
        }
        Ok(())
    }
}

/// Reads an unsigned number with an optional power of ten: 1.5EX-3.
fn exponent_number(scanner: &mut Scanner<'_>) -> Option<(f64, u8)> {
    let (value, decimals) = plain_number(scanner, b".")?;
    if !scanner.is_next("EX") {
        return Some((value, decimals));
    }
    scanner.go_to(scanner.at() + 2);
    let sign = if scanner.takes(b'-') { -1 } else { 1 };
    scanner.takes(b'+');
    let power = plain_number(scanner, b"").filter(|(power, _)| *power <= 300.0);
    let power = power.and_then(|(power, _)| format!("{power:.0}").parse::<i32>().ok());
    let value = power.map(|power| value * 10_f64.powi(sign * power));
    let value = value.filter(|value| value.is_finite());
    value.map(|value| (value, 0))
}

/// Number of an R parameter, `R5` or `R[5]`. Outer `None`: not an R parameter; inner `None`: only known at the machine.
fn r_parameter(
    values: &Values<'_>,
    scanner: &mut Scanner<'_>,
    depth: u32,
) -> Result<Option<Number>, Fault> {
    let before = scanner.at();
    if !scanner.takes(b'R') {
        return Ok(None);
    }
    let column = scanner.column();
    let number = if scanner.takes(b'[') {
        let value = values.operation(scanner, 0, depth)?;
        match (value, scanner.takes(b']')) {
            (Some(value), true) => value,
            _ => {
                return Err(
                    column.malformed("expected the number of an R parameter, and ] after it")
                );
            }
        }
    } else if let Some((number, _)) = plain_number(scanner, b"") {
        Some(number)
    } else {
        scanner.go_to(before);
        return Ok(None);
    };
    let Some(number) = number else {
        return Ok(Some(None));
    };
    let whole = whole(number, MOST - 1);
    let whole =
        whole.ok_or(column.malformed("expected the number of an R parameter, 0 to 99999"))?;
    Ok(Some(Some(whole)))
}

/// Reads a name of letters, digits and underscores, in upper case; `None` if none begins here.
fn identifier(scanner: &mut Scanner<'_>) -> Option<String> {
    let first = scanner.peek()?;
    if !first.is_ascii_alphabetic() && first != b'_' {
        return None;
    }
    let (at, rest) = (scanner.at(), scanner.rest());
    let is_of_name = |byte: &u8| byte.is_ascii_alphanumeric() || *byte == b'_';
    let length = rest.iter().take_while(|byte| is_of_name(byte)).count();
    scanner.go_to(at + length);
    let name = rest.iter().take(length).map(u8::to_ascii_uppercase);
    Some(name.map(char::from).collect())
}

/// Skips a pair of brackets with its content. Returns true if a complete pair was next. Strings in the content may
/// contain brackets.
fn passes_brackets(scanner: &mut Scanner<'_>, opens: u8, closes: u8) -> bool {
    if scanner.peek() != Some(opens) {
        return false;
    }
    let (mut depth, mut in_text) = (0_u32, false);
    let (at, rest) = (scanner.at(), scanner.rest());
    for (place, byte) in rest.iter().enumerate() {
        match byte {
            b'"' => in_text = !in_text,
            _ if in_text => {}
            b';' => break,
            _ if *byte == opens => depth += 1,
            _ if *byte == closes => {
                depth -= 1;
                if depth == 0 {
                    scanner.go_to(at + place + 1);
                    return true;
                }
            }
            _ => {}
        }
    }
    false
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Meaning {
    Code(f64),
    Command(Command),
    Nothing,
    /// A dwell: its F and S are times.
    Dwell,
    /// Working area limits: the coordinates move no axis.
    Limits,
    Refused(&'static str),
}

const CALL: &str = "subprograms are not supported in this language";

const ORIENTATION: &str = "tool orientations are supported as angles of the rotary axes only";

const TILTED: &str = "frames other than TRANS, ATRANS, ROT and AROT about Z are not supported";

const CORNER: &str = "a rounded or chamfered corner is a separate motion";

const CURVE: &str = "a curve other than a line or an arc by its centre or radius";

const POLAR: &str = "polar coordinates";

const PLACE: &str = "it leads to a position that only the control knows";

const APPROACH: &str = "soft approach and retraction are separate motions";

const TRANSFORMATION: &str = "no transformation other than TRAORI is supported";

/// Meaning of a G code, and its modal group; a block may have one code per group.
fn g_code(code: u32) -> (u8, Meaning) {
    match code {
        0..=3 => (1, Meaning::Code(f64::from(code))),
        33..=35 | 63 | 331 | 332 => (1, Meaning::Refused(OWN_RULE)),
        4 => (2, Meaning::Dwell),
        74 | 75 => (2, Meaning::Refused(PLACE)),
        147 | 148 | 247 | 248 | 347 | 348 => (2, Meaning::Refused(APPROACH)),
        25 | 26 => (3, Meaning::Limits),
        58 | 59 => (3, Meaning::Refused(TILTED)),
        110..=112 => (3, Meaning::Refused(POLAR)),
        17..=19 => (6, Meaning::Code(f64::from(code))),
        40..=42 => (7, Meaning::Code(f64::from(code))),
        500 => (8, Meaning::Command(Command::WorkOffset(G500))),
        54..=57 => {
            let system = [0, 1, 2, 3][code as usize - 54];
            (8, Meaning::Command(Command::WorkOffset(system)))
        }
        505..=599 => {
            let system = G505 + (code as usize - 505);
            (8, Meaning::Command(Command::WorkOffset(system)))
        }
        53 | 153 => (9, Meaning::Command(Command::InMachine)),
        70 | 700 => (13, Meaning::Code(20.0)),
        71 | 710 => (13, Meaning::Code(21.0)),
        90 | 91 => (14, Meaning::Code(f64::from(code))),
        93..=95 => (15, Meaning::Code(f64::from(code))),
        // G96, G961 and the like end G93. After G962 and G972, F is a feed of G94 or G95, which are treated alike.
        961 | 971 => (15, Meaning::Code(94.0)),
        96 | 97 | 962 | 972 | 973 => (15, Meaning::Code(95.0)),
        // Exact stops, path control, approach and corner behaviour.
        9 => (11, Meaning::Nothing),
        60 => (10, Meaning::Code(61.0)),
        64 | 641..=645 => (10, Meaning::Code(64.0)),
        601..=603 => (12, Meaning::Nothing),
        62 | 621 => (57, Meaning::Nothing),
        140..=143 => (43, Meaning::Nothing),
        340 | 341 => (44, Meaning::Nothing),
        450 | 451 => (18, Meaning::Nothing),
        460..=462 => (48, Meaning::Nothing),
        290 => (47, Meaning::Nothing),
        _ => (0, Meaning::Refused(UNKNOWN)),
    }
}

/// Names that never move an axis: alone, with a value, or with arguments.
const HARMLESS: &str = "ACC ADIS ADISPOS ATOL BRISK BRISKA CDOF CDOF2 CDON CFC CFIN CFTCP CLEARM COMPCAD COMPCURV COMPOF COMPON \
    COMPSURF CP CTOL CUT2D CUT2DD CUT2DF CUT2DFD CUT3DC CUT3DCC CUT3DF CUT3DFF CUT3DFS CUTCONOF CYCLE832 \
    DIAMOF DISC DISPLOF DISPLON DRIVE DRIVEA DYNFINISH DYNNORM DYNPOS DYNROUGH DYNSEMIFIN FA FCUB \
    FFWOF FFWON FGREF FGROUP FIFOCTRL FL FLIN FNORM FZ GROUP_BEGIN GROUP_END JERKLIM KONT KONTC KONTT LIMS \
    MSG NORM ORIAXES ORIMKS OTOL OVR OVRRAP RTLIOF RTLION SAVE SBLOF SBLON SETM SETMS SOFT SOFTA SPATH SPCOF \
    SPCON SPOS SPOSA STARTFIFO STOPFIFO STOPRE UPATH WAITM WAITS WORKPIECE";

const REFUSED: [(&str, &str); 10] = [
    (
        FLOW,
        "IF ELSE ENDIF GOTO GOTOF GOTOB GOTOC GOTOS CASE WHILE ENDWHILE FOR ENDFOR LOOP ENDLOOP REPEAT REPEATB UNTIL WHEN WHENEVER EVERY DO ID IDS FROM",
    ),
    (CALL, "CALL PCALL EXTCALL ISOCALL MODAL"),
    (
        TILTED,
        "SCALE ASCALE MIRROR AMIRROR ROTS AROTS CROTS TOFRAME TOFRAMEX TOFRAMEY TOFRAMEZ TOROT TOROTX TOROTY TOROTZ PAROT CYCLE800 TCARR TCOABS TCOFR CTRANS CROT CFINE",
    ),
    (
        "a feed for one block, which only the first part of a split motion would have: write F",
        "FB FD",
    ),
    (CORNER, "RND RNDM CHF CHR FRC FRCM"),
    (CURVE, "CIP CT TURN ASPLINE BSPLINE CSPLINE POLY INVCW INVCCW ANG ANG1 ANG2 PW SD PO PL"),
    (POLAR, "AP RP"),
    (ORIENTATION, "LEAD TILT THETA PHI PSI NUT"),
    (TRANSFORMATION, "TRANSMIT TRACYL TRAANG TRACON TRACOORD"),
    (
        OWN_RULE,
        "POS POSA POSP POSM MEAS MEAW MEASA MEAWA PTP PTPG0 DIAMON DIAM90 DL TOFFL TOFF OSCILL COUPON TRAILON LEADON STARTFIX",
    ),
];

fn meaning_of(name: &str) -> Meaning {
    let is_of = |names: &str| names.split(' ').any(|of| of == name);
    match name {
        "TRANS" => Meaning::Command(Command::Shift { adds: false }),
        "ATRANS" => Meaning::Command(Command::Shift { adds: true }),
        "SUPA" => Meaning::Command(Command::InMachine),
        "TRAFOOF" => Meaning::Command(Command::CentrePoint(false)),
        "RET" => Meaning::Command(Command::Ends),
        _ if is_of(HARMLESS) => Meaning::Nothing,
        _ => match REFUSED.iter().find(|(_, names)| is_of(names)) {
            Some(&(why, _)) => Meaning::Refused(why),
            None if name.starts_with("ORI") => Meaning::Refused(ORIENTATION),
            None => Meaning::Refused(UNKNOWN),
        },
    }
}

/// True if the named cycle moves along the tool axis only and ends at its first argument. `None` if the name is not
/// that of a cycle.
pub(crate) fn only_drills(name: &str) -> Option<bool> {
    const DRILLING: &str =
        "CYCLE81 CYCLE82 CYCLE83 CYCLE84 CYCLE85 CYCLE86 CYCLE87 CYCLE88 CYCLE89 CYCLE840";
    const OTHERS: &str = "CYCLE60 CYCLE61 CYCLE62 CYCLE63 CYCLE64 CYCLE70 CYCLE71 CYCLE72 CYCLE76 CYCLE77 CYCLE78 CYCLE79 \
        CYCLE90 CYCLE801 CYCLE802 CYCLE899 HOLES1 HOLES2";
    let is_of = |names: &str| names.split(' ').any(|of| of == name);
    let is_drilling = is_of(DRILLING);
    let is_other = is_of(OTHERS)
        || ["POCKET", "SLOT", "LONGHOLE"].iter().any(|family| {
            let number = name.strip_prefix(family);
            number.is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
        });
    (is_drilling || is_other).then_some(is_drilling)
}
