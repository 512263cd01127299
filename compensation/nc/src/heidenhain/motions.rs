//! Motions: lines and arcs, by X and Y or by polar coordinates, and the pole.

use crate::{
    block::{Manner, POLAR},
    command::Command,
    fault::Fault,
    formula::takes_name,
    heidenhain::{OWN_RULE, Reader, UNKNOWN, not_followed},
};

/// What begins a motion.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Line,
    PolarLine,
    Arc,
    ArcByRadius,
    PolarArc,
}

/// The longest first.
const KINDS: [(&str, Kind); 5] = [
    ("LP", Kind::PolarLine),
    ("CP", Kind::PolarArc),
    ("CR", Kind::ArcByRadius),
    ("L", Kind::Line),
    ("C", Kind::Arc),
];

impl Reader<'_, '_> {
    /// A motion or a pole; false: the line is none.
    pub(super) fn motion(&mut self) -> Result<bool, Fault> {
        if self.takes_keyword("CC") {
            self.block.commands.push(Command::Pole);
            while self.axis_word()? {}
            let others = |letter: u8| !matches!(letter, b'X' | b'Y');
            if self.block.words.iter().any(|word| others(word.letter)) {
                let column = self.scanner.column();
                return Err(not_followed(
                    column,
                    "CC",
                    "a pole outside the plane of X and Y",
                ));
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
        self.word(
            b'G',
            at,
            at..at + name.len(),
            Some(1.0),
            Manner::Modal,
            None,
        );
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
                        return Err(not_followed(column, &self.found(at), UNKNOWN));
                    }
                    clockwise = Some(is_minus);
                }
                Some(b'F') => rapid |= self.feed(column)?,
                Some(b'M') => self.m_word()?,
                Some(b'~') => {
                    return Err(not_followed(column, "~", "a motion in several lines"));
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
                return Err(Fault::Expression {
                    column,
                    what: "expected DR+ or DR- in an arc",
                });
            }
            (false, Some(_)) => {
                return Err(Fault::Expression {
                    column,
                    what: "DR+ or DR- in a straight motion",
                });
            }
            (false, None) => f64::from(u8::from(!rapid)),
        };
        self.block.words[place].value = Some(code);
        self.turns(kind, clockwise)?;
        Ok(true)
    }

    fn column(&mut self) -> usize {
        self.scanner.peek();
        self.scanner.column()
    }

    fn found(&self, at: usize) -> String {
        let rest = self.scanner.bytes().get(at..).unwrap_or_default();
        let word = rest.split(u8::is_ascii_whitespace).next();
        String::from_utf8_lossy(word.unwrap_or_default()).into_owned()
    }

    /// A keyword, behind which coordinates may stand without a blank: `LX+10` is `L X+10`, but `LBL` is none.
    fn takes_keyword(&mut self, name: &str) -> bool {
        if takes_name(&mut self.scanner, name) {
            return true;
        }
        let at = self.scanner.at();
        let rest = self.scanner.bytes().get(at..).unwrap_or_default();
        let is_next = rest
            .get(..name.len())
            .is_some_and(|next| next.eq_ignore_ascii_case(name.as_bytes()));
        let [axis, value] = [0, 1].map(|i| rest.get(name.len() + i).copied().unwrap_or_default());
        let is_value = value.is_ascii_digit() || matches!(value, b'+' | b'-');
        let is_axis = matches!(axis.to_ascii_uppercase(), b'X' | b'Y' | b'Z');
        if is_next && is_axis && is_value {
            self.scanner.go_to(at + name.len());
            return true;
        }
        false
    }

    /// `PR+10`, `IPA+30`.
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
            _ => return Err(not_followed(column, &self.found(at), UNKNOWN)),
        };
        let manner = if is_way {
            Manner::Incremental
        } else {
            Manner::Absolute
        };
        self.value_word(letter, at, manner)?;
        Ok(true)
    }

    /// `R0`, `RL`, `RR`, or the radius of an arc.
    fn radius(&mut self, kind: Kind, column: usize) -> Result<(), Fault> {
        let at = self.scanner.at();
        for (name, code) in [("R0", 40.0), ("RL", 41.0), ("RR", 42.0)] {
            if takes_name(&mut self.scanner, name) {
                let is_off = code == 40.0;
                // What holds already is not switched.
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
            let why = if is_axis {
                "the radius of the tool along one axis"
            } else {
                UNKNOWN
            };
            return Err(not_followed(column, &self.found(at), why));
        }
        self.value_word(b'R', at, Manner::Modal)?;
        self.block.end = self.scanner.at();
        Ok(())
    }

    /// A feed; whether it is FMAX.
    fn feed(&mut self, column: usize) -> Result<bool, Fault> {
        let at = self.scanner.at();
        if takes_name(&mut self.scanner, "FMAX") {
            return Ok(true);
        }
        if takes_name(&mut self.scanner, "FAUTO") {
            return Ok(false);
        }
        self.scanner.next();
        match self.scanner.peek() {
            // For each revolution or tooth.
            Some(b'U' | b'Z') => {
                self.scanner.next();
            }
            Some(b'T') => {
                return Err(not_followed(
                    column,
                    &self.found(at),
                    "a time for the motion",
                ));
            }
            Some(b'M') if takes_name(&mut self.scanner, "MAX") => return Ok(true),
            Some(b'A') if takes_name(&mut self.scanner, "AUTO") => return Ok(false),
            _ => {}
        }
        self.value_word(b'F', at, Manner::Modal)?;
        Ok(false)
    }

    /// Arcs of more than a turn are refused, and those whose angle goes against their direction.
    fn turns(&mut self, kind: Kind, clockwise: Option<bool>) -> Result<(), Fault> {
        let column = self.column();
        let is_polar = |letter: u8| self.block.word(letter).is_some();
        if kind == Kind::PolarLine && !POLAR.into_iter().any(is_polar) {
            return Err(Fault::Expression {
                column,
                what: "expected the distance PR or the angle PA",
            });
        }
        if kind != Kind::PolarArc {
            return Ok(());
        }
        let Some(angle) = self.block.word(POLAR[1]) else {
            return Err(Fault::Expression {
                column,
                what: "expected the angle PA or IPA of the arc",
            });
        };
        if angle.manner != Manner::Incremental {
            return Ok(());
        }
        let Some(by) = angle.value else { return Ok(()) };
        if by.abs() > 360.0 || by == 0.0 {
            return Err(not_followed(column, "CP", "a helix of more than one turn"));
        }
        if (by < 0.0) != clockwise.unwrap_or_default() {
            return Err(not_followed(column, "CP", OWN_RULE));
        }
        Ok(())
    }
}
