//! The conversational language of HEIDENHAIN controls.
//!
//! Words that have an RS-274 equivalent get its letter and code: a line `L` is G1, with FMAX G0; `RL` is G41. Unknown
//! words, which might move an axis, are rejected with their column.

use std::{io::Write as _, ops::Range};

use crate::{
    block::{Assignment, Block, Command, Cycle, LAST, Manner, OTHER, POLAR, Parameter, Scanner},
    coordinates::{axis_of, is_rotary},
    error::{Column, FLOW, Fault, OWN_RULE, UNKNOWN},
    expression::{Formulas, Operator, finite, operate, plain_number, takes_name, whole_number},
    interpreter::Interpreter,
    modal::CentrePoint,
    parameters::Value,
};

const TILTED: &str = "only shifts of the datum (cycle 7) are supported";

pub(crate) fn read_heidenhain(
    block: &mut Block,
    text: &[u8],
    interpreter: &Interpreter,
) -> Result<(), Fault> {
    block.clear();
    let mut reader = Reader { block, scanner: Scanner::new(text), values: Values { interpreter } };
    reader.line()
}

struct Reader<'a, 'b> {
    block: &'b mut Block,
    scanner: Scanner<'a>,
    values: Values<'b>,
}

impl Reader<'_, '_> {
    fn line(&mut self) -> Result<(), Fault> {
        let text = self.scanner.bytes();
        if self.values.interpreter.modal.goes_on {
            // Parameters of a cycle that began in an earlier line.
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
        let column = self.column();
        match self.scanner.peek() {
            None | Some(b';' | b'*') => return Ok(()),
            Some(b'0'..=b'9') if self.block.number.is_none() => {
                return Err(column.malformed("the number of a block above 1000000000"));
            }
            Some(b'/') => {
                return Err(
                    column.not_followed("/", "only the control knows whether the block is skipped")
                );
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

    /// Consumes these words if they are next, with any number of blanks between them.
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

    /// Consumes a name that is directly followed by a number: `LBL5`, `QS3`, `FN0`.
    fn takes_prefix(&mut self, word: &str) -> bool {
        let (at, rest) = (self.scanner.at(), self.scanner.rest());
        let is_next = self.scanner.is_next(word);
        let then_digit = rest.get(word.len()).is_some_and(u8::is_ascii_digit);
        let is_taken = matches!(word, "LBL" | "QS" | "FN") && is_next && then_digit;
        if is_taken {
            self.scanner.go_to(at + word.len());
        }
        is_taken
    }

    /// Reads `NAME MM` after BEGIN PGM.
    fn begins(&mut self, column: Column) -> Result<(), Fault> {
        let (at, rest) = (self.scanner.at(), self.scanner.rest());
        let rest = rest.split(|byte| *byte == b';').next().unwrap_or_default();
        let mut words = rest.split(|byte| matches!(byte, b' ' | b'\t'));
        let unit = words.rfind(|word| !word.is_empty()).unwrap_or_default();
        let code = match unit.to_ascii_uppercase().as_slice() {
            b"MM" => 21.0,
            b"INCH" => 20.0,
            _ => {
                return Err(column.not_followed("BEGIN PGM", "expected MM or INCH at its end"));
            }
        };
        self.word(b'G', at, at..at, Some(code), Manner::Modal, None);
        Ok(())
    }

    fn goes_on(&mut self) {
        if self.has_tilde() {
            self.block.commands.push(Command::GoesOn);
        }
    }

    /// Reads `Q339=+1`, the preset number of cycle 247.
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
        Err(column.not_followed("CYCL DEF 247", "expected the number of its preset, Q339"))
    }

    /// True if the line ends with a tilde, before or after its comment.
    fn has_tilde(&self) -> bool {
        let text = self.scanner.bytes();
        let before = text.split(|byte| *byte == b';').next().unwrap_or_default();
        // Controls write the tilde after the comment.
        before.trim_ascii_end().ends_with(b"~") || text.trim_ascii_end().ends_with(b"~")
    }

    fn ends(&mut self) -> Result<(), Fault> {
        match self.scanner.peek() {
            None | Some(b';') => Ok(()),
            Some(found) => Err(self.scanner.column().character(found)),
        }
    }

    /// Reads the rest of `FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS`.
    fn tcpm(&mut self, column: Column) -> Result<(), Fault> {
        for words in ["F TCP", "AXIS POS", "PATHCTRL AXIS"] {
            if !self.takes(words) {
                return Err(column.not_followed(
                    "FUNCTION TCPM",
                    "only F TCP AXIS POS PATHCTRL AXIS is supported",
                ));
            }
        }
        self.block.commands.push(Command::CentrePoint(true));
        self.ends()
    }

    /// Reads `Q1 = ...` or `FN 1: Q1 = +Q2 + +3`; returns false for other lines.
    fn parameter(&mut self) -> Result<bool, Fault> {
        let (at, column) = (self.scanner.at(), self.scanner.column());
        let mut function = None;
        if self.takes("FN") {
            let number = plain_number(&mut self.scanner, b"");
            let number = number.map(|(number, _)| number);
            function = number.filter(|number| *number <= 5.0);
            if function.is_none() || !self.scanner.takes(b':') {
                return Err(column.not_followed("FN", FLOW));
            }
        }
        let Some(parameter) = q_parameter(&mut self.scanner) else {
            self.scanner.go_to(at);
            return Ok(false);
        };
        let column = self.column();
        if !self.scanner.takes(b'=') {
            return Err(column.malformed("expected = after a parameter that begins a block"));
        }
        self.scanner.peek();
        let (from, column) = (self.scanner.at(), self.scanner.column());
        let value = if let Some(function) = function {
            self.function(function)?
        } else {
            let value = self.values.operation(&mut self.scanner, 0, 0)?;
            value.ok_or(column.malformed("expected the value of the parameter after ="))?
        };
        let to = self.scanner.at();
        self.block.assignments.push(Assignment { parameter, value, all: at..to, text: from..to });
        Ok(true)
    }

    /// Evaluates FN 0 to FN 5: a value, a sum, a difference, a product, `A DIV B`, `SQRT A`.
    fn function(&mut self, number: f64) -> Result<Value, Fault> {
        const WHAT: &str = "expected a number or a Q parameter here";
        let column = self.scanner.column();
        if number == 5.0 {
            takes_name(&mut self.scanner, "SQRT");
            let value = self.value(WHAT)?;
            return value.map(|x| finite(x.sqrt(), column)).transpose();
        }
        let first = self.value(WHAT)?;
        let (name, operator) = match number {
            1.0 => ("+", Operator::Plus),
            2.0 => ("-", Operator::Minus),
            3.0 => ("*", Operator::Times),
            4.0 => ("DIV", Operator::Over),
            _ => return Ok(first),
        };
        let is_there = takes_name(&mut self.scanner, name)
            || operator == Operator::Over && self.scanner.takes(b'/');
        if !is_there {
            let column = self.scanner.column();
            return Err(column.malformed("expected the operator of this function: + - * DIV"));
        }
        let second = self.value(WHAT)?;
        match (first, second) {
            (Some(a), Some(b)) => Ok(Some(operate(operator, a, b, column)?)),
            _ => Ok(None),
        }
    }

    fn refuses(&mut self, column: Column) -> Result<(), Fault> {
        const REASONS: [(&str, &[&str]); 11] = [
            (FLOW, &["CALL LBL", "CALL PGM", "PGM CALL", "SEL", "IF"]),
            (TILTED, &["PLANE"]),
            (OWN_RULE, &["TCH PROBE", "PATTERN DEF"]),
            ("a rounded corner is a separate motion", &["RND"]),
            ("a chamfer is a separate motion", &["CHF"]),
            ("approach and departure are separate motions", &["APPR", "DEP"]),
            ("an arc by its tangent", &["CT", "CTP"]),
            ("tool directions are supported as angles of the rotary axes only", &["LN"]),
            ("a spline", &["SPL"]),
            ("free contours are not supported", &["FL", "FLT", "FC", "FCT", "FPOL"]),
            (UNKNOWN, &["FUNCTION"]),
        ];
        for (why, names) in REASONS {
            if let Some(name) = names.iter().find(|name| self.takes(name)) {
                return Err(column.not_followed(name, why));
            }
        }
        Err(column.not_followed(&self.found(self.scanner.at()), UNKNOWN))
    }

    /// Reads a motion or a pole; returns false for other lines.
    pub(crate) fn motion(&mut self) -> Result<bool, Fault> {
        if self.takes_keyword("CC") {
            self.block.commands.push(Command::Pole);
            while self.axis_word()? {}
            let others = |letter: u8| !matches!(letter, b'X' | b'Y');
            if self.block.words.iter().any(|word| others(word.letter)) {
                let column = self.scanner.column();
                return Err(column.not_followed("CC", "a pole outside the XY plane"));
            }
            return Ok(true);
        }
        self.scanner.peek();
        let at = self.scanner.at();
        let found = KINDS.into_iter().find(|(name, _)| self.takes_keyword(name));
        let Some((name, kind)) = found else {
            return Ok(false);
        };
        self.block.keyword = at..at + name.len();
        self.block.end = self.scanner.at();
        let place = self.block.words.len();
        let text = self.block.keyword.clone();
        self.word(b'G', at, text, Some(1.0), Manner::Modal, None);
        let (mut rapid, mut clockwise) = (false, None);
        loop {
            let column = self.column();
            if self.axis_word()? || self.polar_word(kind)? {
                self.block.end = self.scanner.at();
                continue;
            }
            match self.scanner.peek() {
                Some(b'R') => self.radius(kind, column)?,
                Some(b'D') => {
                    let at = self.scanner.at();
                    let is_minus = takes_name(&mut self.scanner, "DR-");
                    if !is_minus && !takes_name(&mut self.scanner, "DR+") {
                        return Err(column.not_followed(&self.found(at), UNKNOWN));
                    }
                    clockwise = Some(is_minus);
                }
                Some(b'F') => rapid |= self.feed(column)?,
                Some(b'M') => self.m_word()?,
                Some(b'~') => {
                    return Err(column.not_followed("~", "a motion in several lines"));
                }
                _ => break,
            }
        }
        let is_arc = matches!(kind, Kind::Arc | Kind::ArcByRadius | Kind::PolarArc);
        let column = self.column();
        let code = match (is_arc, clockwise) {
            (true, Some(true)) => 2.0,
            (true, Some(false)) => 3.0,
            (true, None) => {
                return Err(column.malformed("expected DR+ or DR- in an arc"));
            }
            (false, Some(_)) => {
                return Err(column.malformed("DR+ or DR- in a straight motion"));
            }
            (false, None) => f64::from(u8::from(!rapid)),
        };
        self.block.words[place].value = Some(code);
        self.check_end_of_block()?;
        self.turns(kind, clockwise)?;
        Ok(true)
    }

    /// Rejects M127 and M129 in a block whose motion they would change: both act at the end of their block.
    fn check_end_of_block(&self) -> Result<(), Fault> {
        let modal = &self.values.interpreter.modal;
        let words = || self.block.words.iter().map(|word| word.letter);
        let names_axes = words().any(|letter| axis_of(letter).is_some() || POLAR.contains(&letter));
        let turns = words().any(|letter| axis_of(letter).is_some_and(is_rotary));
        let found = self.block.commands.iter().find_map(|command| match command {
            Command::CentrePoint(false) if modal.centre_point != CentrePoint::Off => Some("M129"),
            Command::Shorter(false) if modal.shorter && turns => Some("M127"),
            _ => None,
        });
        match found.filter(|_| names_axes) {
            Some(name) => Err(self.scanner.column().not_followed(
                name,
                "it acts at the end of its block: write it in a separate block after the motion",
            )),
            None => Ok(()),
        }
    }

    fn column(&mut self) -> Column {
        self.scanner.peek();
        self.scanner.column()
    }

    fn found(&self, at: usize) -> String {
        let rest = self.scanner.bytes().get(at..).unwrap_or_default();
        let word = rest.split(u8::is_ascii_whitespace).next();
        String::from_utf8_lossy(word.unwrap_or_default()).into_owned()
    }

    /// Consumes a keyword that coordinates may follow without a blank: `LX+10` is `L X+10`, but `LBL` is not `L`.
    fn takes_keyword(&mut self, name: &str) -> bool {
        if takes_name(&mut self.scanner, name) {
            return true;
        }
        let (at, rest) = (self.scanner.at(), self.scanner.rest());
        let is_next = self.scanner.is_next(name);
        let [axis, value] = [0, 1].map(|i| rest.get(name.len() + i).copied().unwrap_or_default());
        let is_value = value.is_ascii_digit() || matches!(value, b'+' | b'-');
        let is_axis = matches!(axis.to_ascii_uppercase(), b'X' | b'Y' | b'Z');
        if is_next && is_axis && is_value {
            self.scanner.go_to(at + name.len());
            return true;
        }
        false
    }

    /// Reads `PR+10` or `IPA+30`.
    fn polar_word(&mut self, kind: Kind) -> Result<bool, Fault> {
        self.scanner.peek();
        let at = self.scanner.at();
        let is_way = self.scanner.takes(b'I');
        if self.scanner.peek() != Some(b'P') {
            self.scanner.go_to(at);
            return Ok(false);
        }
        self.scanner.next();
        let column = self.column();
        let letter = match self.scanner.next() {
            Some(b'R') if kind == Kind::PolarLine => POLAR[0],
            Some(b'A') if matches!(kind, Kind::PolarLine | Kind::PolarArc) => POLAR[1],
            _ => return Err(column.not_followed(&self.found(at), UNKNOWN)),
        };
        let manner = if is_way { Manner::Incremental } else { Manner::Absolute };
        self.value_word(letter, at, manner)?;
        Ok(true)
    }

    /// Reads `R0`, `RL`, `RR`, or the radius of an arc.
    fn radius(&mut self, kind: Kind, column: Column) -> Result<(), Fault> {
        let at = self.scanner.at();
        for (name, code) in [("R0", 40.0), ("RL", 41.0), ("RR", 42.0)] {
            if takes_name(&mut self.scanner, name) {
                let is_off = code == 40.0;
                // Repeating the active radius compensation switches nothing.
                let holds = match self.values.interpreter.modal.radius {
                    None => is_off,
                    Some(radius) => f64::from(radius) == 10.0 * code,
                };
                if !holds {
                    let text = at..self.scanner.at();
                    self.word(b'G', at, text, Some(code), Manner::Modal, None);
                }
                return Ok(());
            }
        }
        self.scanner.next();
        let next = self.scanner.peek();
        let is_axis = matches!(next, Some(b'+' | b'-'));
        if kind != Kind::ArcByRadius {
            let why = if is_axis { "the radius of the tool along one axis" } else { UNKNOWN };
            return Err(column.not_followed(&self.found(at), why));
        }
        self.value_word(b'R', at, Manner::Modal)?;
        self.block.end = self.scanner.at();
        Ok(())
    }

    /// Reads a feed; returns true for FMAX.
    fn feed(&mut self, column: Column) -> Result<bool, Fault> {
        let at = self.scanner.at();
        if takes_name(&mut self.scanner, "FMAX") {
            return Ok(true);
        }
        if takes_name(&mut self.scanner, "FAUTO") {
            return Ok(false);
        }
        self.scanner.next();
        match self.scanner.peek() {
            // Feed per revolution or tooth.
            Some(b'U' | b'Z') => {
                self.scanner.next();
            }
            Some(b'T') => {
                return Err(column.not_followed(&self.found(at), "a time for the motion"));
            }
            Some(b'M') if takes_name(&mut self.scanner, "MAX") => return Ok(true),
            Some(b'A') if takes_name(&mut self.scanner, "AUTO") => return Ok(false),
            _ => {}
        }
        self.value_word(b'F', at, Manner::Modal)?;
        Ok(false)
    }

    /// Rejects polar motions without their distance or angle, arcs of more than a turn, and arcs whose angle
    /// contradicts their direction.
    fn turns(&mut self, kind: Kind, clockwise: Option<bool>) -> Result<(), Fault> {
        let column = self.column();
        let is_polar = |letter: u8| self.block.word(letter).is_some();
        if kind == Kind::PolarLine && !POLAR.into_iter().any(is_polar) {
            return Err(column.malformed("expected the distance PR or the angle PA"));
        }
        if kind != Kind::PolarArc {
            return Ok(());
        }
        let Some(angle) = self.block.word(POLAR[1]) else {
            return Err(column.malformed("expected the angle PA or IPA of the arc"));
        };
        if angle.manner != Manner::Incremental {
            return Ok(());
        }
        let Some(by) = angle.value else { return Ok(()) };
        if by.abs() > 360.0 || by == 0.0 {
            return Err(column.not_followed("CP", "a helix of more than one turn"));
        }
        if (by < 0.0) != clockwise.unwrap_or_default() {
            return Err(column.not_followed("CP", OWN_RULE));
        }
        Ok(())
    }

    /// Reads `CYCL DEF`, `CYCL CALL` or `TRANS DATUM`; returns false for other lines.
    pub(crate) fn cycle(&mut self) -> Result<bool, Fault> {
        let column = self.scanner.column();
        if self.takes("CYCL DEF") {
            self.defines_cycle(column)?;
            return Ok(true);
        }
        if self.takes("CYCL CALL") {
            for name in ["PAT", "POS"] {
                if takes_name(&mut self.scanner, name) {
                    return Err(
                        column.not_followed("CYCL CALL", "holes at positions in another file")
                    );
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
                return Err(
                    column.not_followed("TRANS DATUM", "a datum that only the control knows")
                );
            }
            return Ok(true);
        }
        Ok(false)
    }

    fn defines_cycle(&mut self, column: Column) -> Result<(), Fault> {
        let Some(number) = whole_number(&mut self.scanner, 9999) else {
            return Err(column.malformed("expected the number of a cycle after CYCL DEF"));
        };
        let part =
            if self.scanner.takes(b'.') { whole_number(&mut self.scanner, 99) } else { None };
        let found = format!("CYCL DEF {number}");
        match number {
            7 => match part {
                Some(0) => self.skips(),
                Some(_) => {
                    self.block.commands.push(Command::Datum);
                    while self.axis_word()? {}
                    if self.block.words.is_empty() {
                        let why = "a datum that only the control knows";
                        return Err(column.not_followed(&found, why));
                    }
                }
                None => return Err(column.not_followed(&found, TILTED)),
            },
            247 if self.has_tilde() => {
                self.block.commands.push(Command::AwaitsPreset);
                self.skips();
            }
            8 | 10 | 11 | 19 | 26 | 247 => return Err(column.not_followed(&found, TILTED)),
            12 => return Err(column.not_followed(&found, FLOW)),
            // Dwell, spindle orientation, contour tolerance and contour data move no axis.
            9 | 13 | 14 | 20 | 32 | 270 => self.skips(),
            // Hole patterns are drilled where they are defined.
            220 | 221 => {
                let cycle = Cycle { name: found, drills_to: None };
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
            _ => return Err(column.not_followed(&found, OWN_RULE)),
        }
        Ok(())
    }

    fn skips(&mut self) {
        self.goes_on();
        self.scanner.go_to(usize::MAX);
    }

    /// Reads `TOOL CALL` or `TOOL DEF`; returns false for other lines.
    pub(crate) fn tool(&mut self) -> Result<bool, Fault> {
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
                    return Err(column.not_followed("TOOL CALL", "another axis of the tool than Z"));
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
            self.block.commands.push(Command::CallsTool { tool, longer });
        }
        Ok(true)
    }

    pub(crate) fn word(
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
        self.block.push(letter, at, text, value, manner, decimals);
    }

    fn value_word(&mut self, letter: u8, at: usize, manner: Manner) -> Result<(), Fault> {
        self.scanner.peek();
        let (column, from) = (self.scanner.column(), self.scanner.at());
        let Some((value, decimals)) = self.values.of_word(&mut self.scanner)? else {
            return Err(column.no_number(letter));
        };
        let text = from..self.scanner.at();
        self.has_one_sign()?;
        self.word(letter, at, text, value, manner, decimals);
        Ok(())
    }

    /// Rejects a second decimal sign. Controls write decimal commas or points, depending on a setting; a number with two signs has digit
    /// groups or a typing error.
    fn has_one_sign(&self) -> Result<(), Fault> {
        let column = self.scanner.column();
        match self.scanner.rest().first() {
            Some(b'.' | b',') => {
                Err(column
                    .malformed("found a second decimal comma or point, expected one in a number"))
            }
            _ => Ok(()),
        }
    }

    pub(crate) fn value(&mut self, what: &'static str) -> Result<Value, Fault> {
        self.scanner.peek();
        let column = self.scanner.column();
        let value = self.values.of_word(&mut self.scanner)?;
        let (value, _) = value.ok_or(column.malformed(what))?;
        self.has_one_sign()?;
        Ok(value)
    }

    fn axis_word(&mut self) -> Result<bool, Fault> {
        self.scanner.peek();
        let at = self.scanner.at();
        let is_way = self.scanner.takes(b'I');
        let letter = self.scanner.peek();
        let Some(letter) = letter.filter(|letter| axis_of(*letter).is_some()) else {
            self.scanner.go_to(at);
            return Ok(false);
        };
        self.scanner.next();
        let manner = if is_way { Manner::Incremental } else { Manner::Modal };
        self.value_word(letter, at, manner)?;
        Ok(true)
    }

    fn m_words(&mut self) -> Result<(), Fault> {
        while self.scanner.peek() == Some(b'M') {
            self.m_word()?;
        }
        Ok(())
    }

    fn m_word(&mut self) -> Result<(), Fault> {
        let (at, column) = (self.scanner.at(), self.scanner.column());
        self.scanner.next();
        let from = self.scanner.at();
        let code = whole_number(&mut self.scanner, 9999).ok_or(column.no_number(b'M'))?;
        let refused = |why| Err(column.not_followed(&format!("M{code}"), why));
        let command = match code {
            2 | 30 => Some(Command::Ends),
            91 => Some(Command::InMachine),
            99 => Some(Command::CallsDefined),
            126 => Some(Command::Shorter(true)),
            127 => Some(Command::Shorter(false)),
            128 => {
                // Feed of the compensating motions for the rotary axes.
                if self.scanner.takes(b'F') && !takes_name(&mut self.scanner, "MAX") {
                    self.value("expected a feed after F")?;
                }
                Some(Command::CentrePoint(true))
            }
            129 => Some(Command::CentrePoint(false)),
            89 => return refused("a cycle after each motion is not supported"),
            92 => return refused("positions relative to a point that only the control knows"),
            94 => return refused("another number for the position of a rotary axis"),
            104 | 114 | 115 | 130 | 138 | 142..=144 => {
                return refused("it changes what coordinates mean");
            }
            118 if self.scanner.peek().is_some_and(|letter| axis_of(letter).is_some()) => {
                return refused("its words limit the handwheel, and are no coordinates");
            }
            140 => return refused(OWN_RULE),
            _ => None,
        };
        self.block.commands.extend(command);
        // Words executed at the end of the block.
        let is_last = matches!(code, 0..=2 | 5 | 6 | 9 | 30 | 60 | 98 | 99);
        let letter = if is_last { LAST } else { OTHER };
        let text = from..self.scanner.at();
        self.word(letter, at, text, Some(0.0), Manner::Modal, None);
        Ok(())
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Line,
    PolarLine,
    Arc,
    ArcByRadius,
    PolarArc,
}

/// Keywords of motions, longer ones first.
const KINDS: [(&str, Kind); 5] = [
    ("LP", Kind::PolarLine),
    ("CP", Kind::PolarArc),
    ("CR", Kind::ArcByRadius),
    ("L", Kind::Line),
    ("C", Kind::Arc),
];

/// Consumes these letters; any character may follow.
fn takes_prefix(scanner: &mut Scanner<'_>, letters: &str) -> bool {
    scanner.peek();
    let is_next = scanner.is_next(letters);
    if is_next {
        scanner.go_to(scanner.at() + letters.len());
    }
    is_next
}

pub(crate) struct Values<'b> {
    pub(crate) interpreter: &'b Interpreter,
}

impl Formulas for Values<'_> {
    const OPERATORS: &'static [&'static [(&'static str, Operator)]] = &[
        &[("+", Operator::Plus), ("-", Operator::Minus)],
        &[("*", Operator::Times), ("/", Operator::Over), ("%", Operator::Rest)],
        &[("^", Operator::Power)],
    ];
    const FUNCTIONS: &'static [(&'static str, fn(f64) -> f64)] = &[
        ("ATAN", |x| x.atan().to_degrees()),
        ("FRAC", f64::fract),
        ("INT", f64::trunc),
        ("LOG", f64::log10),
        ("NEG", |x| -x),
        ("SQ", |x| x * x),
    ];
    const PAIRS: &'static [(&'static str, fn(f64, f64) -> f64)] = &[];

    fn number(&self, scanner: &mut Scanner<'_>) -> Option<(f64, u8)> {
        plain_number(scanner, b".,")
    }

    fn parameter(&self, scanner: &mut Scanner<'_>, _depth: u32) -> Result<Option<Value>, Fault> {
        if takes_name(scanner, "PI") {
            return Ok(Some(Some(std::f64::consts::PI)));
        }
        let parameters = &self.interpreter.parameters;
        Ok(q_parameter(scanner).map(|parameter| match parameter {
            Parameter::Numbered(number) => parameters.set_number(number).unwrap_or(None),
            Parameter::Named(name) => parameters.named(&name).unwrap_or(None),
        }))
    }
}

impl Values<'_> {
    /// A signed or unsigned number or Q parameter, as it follows the letter of a word.
    pub(crate) fn of_word(
        &self,
        scanner: &mut Scanner<'_>,
    ) -> Result<Option<(Value, Option<u8>)>, Fault> {
        let before = scanner.at();
        let is_negative = scanner.takes(b'-');
        if !is_negative {
            scanner.takes(b'+');
        }
        let signed = |value: f64| if is_negative { -value } else { value };
        if let Some((value, decimals)) = self.number(scanner) {
            return Ok(Some((Some(signed(value)), Some(decimals))));
        }
        let value = self.parameter(scanner, 0)?;
        if value.is_none() {
            scanner.go_to(before);
        }
        Ok(value.map(|value| (value.map(signed), None)))
    }
}

/// Reads `Q5`, `QL5` or `QR5`.
fn q_parameter(scanner: &mut Scanner<'_>) -> Option<Parameter> {
    let before = scanner.at();
    if !scanner.takes(b'Q') {
        return None;
    }
    let kind = match scanner.peek() {
        Some(kind @ (b'L' | b'R')) => {
            scanner.next();
            Some(kind)
        }
        _ => None,
    };
    let Some(number) = whole_number(scanner, 9999) else {
        scanner.go_to(before);
        return None;
    };
    Some(match kind {
        Some(kind) => Parameter::Named(format!("q{}{number}", char::from(kind))),
        None => Parameter::Numbered(number),
    })
}

/// Maximum block number; larger ones are rejected.
const MOST_NUMBER: u64 = 1_000_000_000;

/// Leading block number and its byte range; `None` without a number and above [`MOST_NUMBER`].
pub(crate) fn block_number(text: &[u8]) -> Option<(Range<usize>, u64)> {
    let from = text.iter().position(|byte| !matches!(byte, b' ' | b'\t'))?;
    let digits = text[from..].iter().take_while(|byte| byte.is_ascii_digit());
    let place = from..from + digits.count();
    let number = std::str::from_utf8(&text[place.clone()]).ok()?;
    let number = number.parse().ok().filter(|number| *number <= MOST_NUMBER)?;
    Some((place, number))
}

/// Writes a block number in place of another; leading zeros keep the width.
pub(crate) fn write_block_number(before: &[u8], number: u64, out: &mut Vec<u8>) {
    let width = match before.first() {
        Some(b'0') => before.len(),
        _ => 0,
    };
    // Writing to a Vec cannot fail.
    let _ = write!(out, "{number:0width$}");
}

/// Numbers the lines from byte `begins` on consecutively, starting with `number`. The number of the program's own line,
/// which is at byte `at` of that line, is replaced; the added lines, which have no numbers yet, get one.
pub(crate) fn renumber(out: &mut Vec<u8>, begins: usize, at: usize, number: u64) {
    let lines = out.split_off(begins);
    let lines = lines.split_inclusive(|byte| *byte == b'\n');
    for (line, number) in lines.zip(number..) {
        match block_number(line) {
            Some((place, _)) if place.start == at => {
                out.extend_from_slice(&line[..place.start]);
                write_block_number(&line[place.clone()], number, out);
                out.extend_from_slice(&line[place.end..]);
            }
            _ => {
                out.extend_from_slice(format!("{number} ").as_bytes());
                out.extend_from_slice(line);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::renumber;

    #[test]
    fn added_lines_get_the_next_numbers() {
        let mut out = b"kept\nCC X+1 Y+2\r\n 007 C X+1\r\nL X+2".to_vec();
        renumber(&mut out, 5, 1, 12);
        assert_eq!(String::from_utf8_lossy(&out), "kept\n12 CC X+1 Y+2\r\n 013 C X+1\r\n14 L X+2");
    }
}
