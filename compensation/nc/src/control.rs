//! The control that runs a program, where controls that read the same language differ in what they make of it.

use crate::{
    block::{Block, Word},
    dialect::Dialect,
    fault::Fault,
    interpret::Interpreter,
    rewrite::Rewriter,
    words::{Decimals, Numerals},
};

/// The control that runs a program: the key `control` of the set-up file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Control {
    /// LinuxCNC.
    LinuxCnc,
    /// FANUC.
    Fanuc,
    /// Haas.
    Haas,
    /// Mazak, in EIA/ISO programs.
    Mazak,
    /// SINUMERIK.
    Siemens,
    /// HEIDENHAIN, in conversational programs.
    Heidenhain,
    /// Printers with Marlin.
    Marlin,
    /// Printers with Klipper.
    Klipper,
    /// Grbl.
    Grbl,
}

/// Their names in set-up files.
pub(crate) const CONTROLS: [(&str, Control); 9] = [
    ("linuxcnc", Control::LinuxCnc),
    ("fanuc", Control::Fanuc),
    ("haas", Control::Haas),
    ("mazak", Control::Mazak),
    ("siemens", Control::Siemens),
    ("heidenhain", Control::Heidenhain),
    ("marlin", Control::Marlin),
    ("klipper", Control::Klipper),
    ("grbl", Control::Grbl),
];

impl Control {
    /// The language of its programs.
    #[must_use]
    pub fn dialect(self) -> Dialect {
        match self {
            Self::Siemens => Dialect::Siemens,
            Self::Heidenhain => Dialect::Heidenhain,
            _ => Dialect::Rs274,
        }
    }

    /// Its name in set-up files.
    #[must_use]
    pub fn name(self) -> &'static str {
        let found = CONTROLS.into_iter().find(|(_, control)| *control == self);
        found.map_or("", |(name, _)| name)
    }

    /// Whether a line is one command of a printer, and E its filament.
    pub(crate) fn is_printer(self) -> bool {
        matches!(self, Self::Marlin | Self::Klipper)
    }

    /// Whether a coordinate without a decimal point is a number of least increments, unless a parameter of the control says otherwise.
    pub(crate) fn counts_increments(self) -> bool {
        matches!(self, Self::Fanuc | Self::Haas | Self::Mazak)
    }
}

/// What a coordinate without a decimal point means: the key `without_point` of the set-up file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WithoutPoint {
    /// X60 is 60 mm, inch or degrees.
    Unit,
    /// X60 is 60 least increments.
    Increment,
}

/// Least increments as most controls have them: 0.001 mm, 0.0001 inch, 0.001 deg.
pub(crate) const INCREMENTS: Decimals = Decimals {
    mm: 3,
    inch: 4,
    deg: 3,
};

/// State: how a program writes coordinates, on a control to which a decimal point means something.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Points {
    /// A coordinate without a point counts in least increments.
    pub(crate) counts: bool,
    /// It is stated, so that a program may mix coordinates with and without a point.
    pub(crate) may_mix: bool,
    /// Whether the last coordinate other than zero had no point.
    pub(crate) last_counts: Option<bool>,
}

impl Points {
    /// Whether a coordinate that the program does not have is to be written in least increments.
    pub(crate) fn adds_increments(self) -> bool {
        self.last_counts == Some(true)
    }
}

impl Rewriter {
    /// How the number of an axis is written: in the place of a word that the block has, or as a further one.
    #[inline]
    pub(crate) fn numerals(&self, axis: usize, word: Option<&Word>) -> Numerals {
        let points = &self.interpreter.points;
        let increments = word.map_or(points.adds_increments(), |word| word.counts);
        let decimals = if increments {
            INCREMENTS
        } else {
            self.decimals
        };
        Numerals {
            decimals: decimals.of(axis, self.interpreter.modal.unit_mm),
            increments,
            point: points.counts,
        }
    }
}

/// Gives the coordinates of a block that count in least increments their value in the unit of the program.
///
/// # Errors
/// A program that has coordinates with and without a point, on a control of which it is not stated what that means.
pub(crate) fn read_increments(
    block: &mut Block,
    text: &[u8],
    interpreter: &Interpreter,
) -> Result<(), Fault> {
    let Points {
        counts,
        may_mix,
        last_counts,
    } = interpreter.points;
    if !counts {
        return Ok(());
    }
    let has = |codes: &[f64]| {
        let mut words = block.words.iter();
        words.any(|word| word.letter == b'G' && word.value.is_some_and(|of| codes.contains(&of)))
    };
    if has(&[4.0]) {
        // The time of a dwell.
        return Ok(());
    }
    let unit_mm = match (has(&[20.0]), has(&[21.0])) {
        (true, _) => 25.4,
        (_, true) => 1.0,
        _ => interpreter.modal.unit_mm,
    };
    let is_cycle = interpreter.in_cycle(block);
    let names_axes = (block.words.iter()).any(|word| b"XYZABCUVW".contains(&word.letter));
    let (is_table, is_rotation) = (has(&[10.0]), has(&[68.0]));
    // Y is an angle there.
    let is_polar = !has(&[15.0]) && (has(&[16.0]) || interpreter.modal.polar.is_some());
    let mut last = last_counts;
    for word in &mut block.words {
        let is_coordinate = match word.letter {
            b'X' | b'Y' | b'Z' | b'A' | b'B' | b'C' | b'U' | b'V' | b'W' | b'I' | b'J' => true,
            // In a cycle it is how often it is done.
            b'K' => !is_cycle,
            b'R' => names_axes || is_table,
            _ => false,
        };
        let (Some(value), Some(_), true) = (word.value, word.decimals, is_coordinate) else {
            continue;
        };
        let without_point = !text[word.text.clone()].contains(&b'.');
        if value != 0.0 {
            if !may_mix && last.is_some_and(|last| last != without_point) {
                return Err(Fault::MixedPoints {
                    column: word.at + 1,
                    word: String::from_utf8_lossy(&text[word.at..word.text.end]).into_owned(),
                    without_point,
                });
            }
            last = Some(without_point);
        } else if last != Some(true) {
            // Zero is zero in either way, and may get a point.
            continue;
        }
        if !without_point {
            continue;
        }
        let is_angle = match word.letter {
            b'A' | b'B' | b'C' => true,
            b'R' => is_rotation,
            b'Y' => is_polar && unit_mm == 1.0,
            _ => false,
        };
        let decimals = INCREMENTS.of(if is_angle { 3 } else { 0 }, unit_mm);
        word.value = Some(value / 10_f64.powi(i32::from(decimals)));
        word.decimals = Some(decimals);
        word.counts = true;
    }
    if is_polar
        && unit_mm != 1.0
        && block
            .words
            .iter()
            .any(|word| word.letter == b'Y' && word.counts)
    {
        return Err(Fault::NotFollowed {
            column: 1,
            found: "an angle without a decimal point under G16 in inches".to_owned(),
            why: "its least increment is not known here: write it with a point",
        });
    }
    block.counts = last;
    Ok(())
}
