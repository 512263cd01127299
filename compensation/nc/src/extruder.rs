//! The E words of printers: how much filament a motion takes, shared over the parts in which it is written.

use crate::{
    NcError,
    codes::Codes,
    control::Control,
    given::Given,
    interpret::{Interpreter, Outcome},
    line::Line,
    number::{MOST_DECIMALS, of_steps, steps},
    rewrite::Rewriter,
    words::Number,
};

/// Decimals of E words at least, as slicers write them.
const DECIMALS: u8 = 5;

/// State: where the extruder is, and how its words are read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Extruder {
    /// M83 is on, whatever G90 and G91 are.
    says_relative: bool,
    /// The last of G90, G91, M82 and M83 was a relative one (G91, M83).
    last_relative: bool,
    /// E at the end of the last motion, mm; `None`: it is not known.
    at: Option<f64>,
}

/// The E word of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Extrusion {
    /// Its absolute start, in the unit of the program; `None`: the word is relative, or the start is unknown.
    from: Option<f64>,
    /// Its value.
    to: f64,
    decimals: u8,
    /// Why it cannot be shared.
    unknown: Option<&'static str>,
}

impl Extruder {
    pub(crate) fn switch(&mut self, relative: bool) {
        (self.says_relative, self.last_relative) = (relative, relative);
    }

    /// A command that is copied may have moved it.
    pub(crate) fn forget_position(&mut self) {
        self.at = None;
    }
}

impl Interpreter {
    /// Follows E on the block of a printer, once its other words are executed.
    pub(crate) fn extrude(
        &mut self,
        codes: &Codes,
        given: &Given<'_>,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        if let Some(code) = codes.distance() {
            self.extruder.last_relative = code == 910;
        }
        if codes.not_modal() == Some(920) && !given.names_axes() && !given.has(b'E') {
            return Err(given.refused("G92 without an axis, which sets all axes to zero in Klipper and does nothing in Marlin: name the axes"));
        }
        let Some(value) = given.letter(b'E')? else {
            return Ok(());
        };
        let unit = self.modal.unit_mm;
        if codes.not_modal() == Some(920) {
            self.extruder.at = Some(value * unit);
            return Ok(());
        }
        // Klipper and Marlin 1: by M83 or by G91. Marlin 2: by what was said last.
        let by_both = self.extruder.says_relative || !self.modal.absolute;
        let is_unclear =
            self.control == Some(Control::Marlin) && by_both != self.extruder.last_relative;
        let from = self.extruder.at.map(|at| at / unit);
        let unknown = if is_unclear {
            Some(
                "versions of Marlin differ in whether its E is absolute or relative after G90 or G91 here: write M82 or M83 after that",
            )
        } else if !by_both && from.is_none() {
            Some("the position of E before it is not known: write G92 E0 before it")
        } else {
            None
        };
        outcome.extrusion = Some(Extrusion {
            from: if by_both { None } else { from },
            to: value,
            decimals: (given.find(b'E').and_then(|word| word.decimals)).unwrap_or(DECIMALS),
            unknown,
        });
        self.extruder.at = match (is_unclear, by_both) {
            (true, _) => None,
            (_, true) => self.extruder.at.map(|at| at + value * unit),
            (_, false) => Some(value * unit),
        };
        Ok(())
    }
}

impl Extrusion {
    /// The word of the part of its motion between two shares; `None`: the part takes nothing.
    fn of_part(&self, [from, to]: [f64; 2]) -> Option<Number> {
        let decimals = self.decimals.clamp(DECIMALS, MOST_DECIMALS);
        let written = self.decimals.min(MOST_DECIMALS);
        let Some(begins) = self.from else {
            // Differences of rounded sums, so that the parts add up to the whole word exactly.
            let all = steps(self.to, decimals)?;
            let at = |share: f64| steps(of_steps(all, decimals) * share, decimals);
            let part = at(to)? - at(from)?;
            return Number::shortest_of(of_steps(part, decimals), written, decimals)
                .filter(|_| part != 0);
        };
        let at = |share: f64| {
            let place = match share {
                1.0 => self.to,
                _ => begins + share * (self.to - begins),
            };
            Number::shortest_of(place, written, decimals)
        };
        let before = at(from);
        at(to).filter(|number| Some(*number) != before)
    }
}

impl Rewriter {
    /// # Errors
    /// A motion that is split has an E that cannot be shared over its parts.
    pub(crate) fn check_extrusion(&self, line: Line<'_>) -> Result<(), NcError> {
        match self.extrusion.and_then(|extrusion| extrusion.unknown) {
            None => Ok(()),
            Some(why) => Err(NcError::NotCompensated {
                line: line.number,
                what: format!("a motion that is split: {why}"),
            }),
        }
    }

    /// The E word of a part that ends at a share of its motion, where the block has one and the part is not all of it.
    pub(crate) fn extrusion_up_to(&mut self, share: f64) -> Option<Number> {
        let from = std::mem::replace(&mut self.extruded, share);
        self.extrusion?.of_part([from, share])
    }
}
