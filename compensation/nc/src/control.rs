//! The control that runs a program, where controls that read the same language differ in what they make of it.

use crate::{
    NcError,
    block::{Block, Word},
    codes::{Codes, is_cycle},
    coordinates::LETTERS,
    dialect::Dialect,
    fault::Fault,
    given::Given,
    interpret::Interpreter,
    modal::{Code, MOST_NUMBERED, NUMBERED, WORK_OFFSETS, numbered},
    rewrite::Rewriter,
    words::{Decimals, Form, Numerals},
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

    /// Whether a G code moves nothing and changes no coordinate on this control: what looks ahead, smooths, stops exactly, or switches off
    /// what is refused where it is switched on.
    pub(crate) fn has_harmless(self, code: Code) -> bool {
        let codes: &[Code] = match self {
            // Look-ahead, corners, tapping, limits of the stored area off, spindle watch, and the ends of G41.1, G12.1, G51, G51.1, G66.
            Self::Fanuc => &[
                80, 110, 131, 230, 250, 260, 401, 500, 501, 620, 630, 670, 1130,
            ],
            // Look-ahead, smoothness, and the ends of G51 and G101.
            Self::Haas => &[500, 1000, 1030, 1870],
            Self::Mazak => &[80, 131, 230, 401, 500, 501, 620, 630, 670, 1130],
            _ => &[],
        };
        codes.contains(&code)
    }

    /// Why a G code that others have is refused for this control.
    pub(crate) fn refuses(self, code: Code) -> Option<&'static str> {
        match (self, code) {
            (Self::Fanuc | Self::Mazak, 70) => {
                Some("it makes an axis hypothetical on this control")
            }
            (Self::Klipper, 530) => Some(
                "Klipper ignores it and moves in the coordinates of the program: remove it, or program the position in these coordinates",
            ),
            (Self::Haas, 70 | 80) => Some("it is not known for this control"),
            (Self::Fanuc | Self::Haas | Self::Mazak, 591..=593) => {
                Some("it is not known for this control")
            }
            _ => None,
        }
    }

    /// Whether a G code chooses one of the work offsets that have numbers.
    pub(crate) fn has_numbered_offset(self, code: Code) -> bool {
        match self {
            Self::Fanuc | Self::Mazak => code == 541,
            // G112 and G113 are polar interpolation on some of them.
            Self::Haas => {
                let is_short = (1100..=1290).contains(&code) && code.is_multiple_of(10);
                code == 1540 || is_short && !matches!(code, 1120 | 1130)
            }
            _ => false,
        }
    }

    /// The number of the last numbered work offset: G54.1 P1 to P300 are the most that FANUC offers, Haas has G154 P1 to P99.
    pub(crate) fn last_numbered(self) -> u32 {
        match self {
            Self::Haas => 99,
            _ => MOST_NUMBERED,
        }
    }

    /// Whether it reads programs as FANUC controls do: M codes of the machine's builder, numbered work offsets by G10 L20, and coordinates
    /// without a decimal point as least increments, unless a parameter of the control differs.
    pub(crate) fn is_fanuc_like(self) -> bool {
        matches!(self, Self::Fanuc | Self::Haas | Self::Mazak)
    }
}

/// Least increments as most controls have them: 0.001 mm, 0.0001 inch, 0.001 deg.
pub(crate) const INCREMENTS: Decimals = Decimals {
    mm: 3,
    inch: 4,
    deg: 3,
};

/// State: how a program writes coordinates, on a control to which a decimal point means something.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct DecimalPoints {
    /// A coordinate without a decimal point is a number of least increments.
    pub(crate) means_increments: bool,
    /// The set-up file states which, so that a program may mix coordinates with and without a point.
    pub(crate) may_mix: bool,
    /// Whether the last coordinate other than zero had no point.
    pub(crate) last_in_increments: Option<bool>,
}

impl DecimalPoints {
    /// Whether a coordinate that the program does not have is to be written in least increments.
    pub(crate) fn adds_increments(self) -> bool {
        self.last_in_increments == Some(true)
    }
}

impl Rewriter {
    /// How the number of an axis is written: in the place of a word that the block has, or as a further one.
    #[inline]
    pub(crate) fn numerals(&self, axis: usize, word: Option<&Word>) -> Numerals {
        let points = &self.interpreter.points;
        let increments = word.map_or(points.adds_increments(), |word| word.in_increments);
        let decimals = if increments {
            INCREMENTS
        } else {
            self.decimals
        };
        let form = match (increments, points.means_increments) {
            (true, _) => Form::Increments,
            (false, true) => Form::Point,
            (false, false) => Form::Plain,
        };
        Numerals {
            decimals: decimals.of(axis, self.interpreter.modal.unit_mm),
            form,
        }
    }
}

/// Why a G code is refused that is not known, or known for other controls only.
pub(crate) fn why_refused(code: Code, control: Option<Control>) -> Option<String> {
    if let Some(why) = control.and_then(|control| control.refuses(code)) {
        return Some(why.to_owned());
    }
    let why = match code {
        70 | 71 | 1070 => "it makes an axis hypothetical, or wraps coordinates round a cylinder",
        120 | 130 | 1500 | 700 | 710 | 720 => "a cycle that moves by a rule of its own",
        121 | 1120 | 1130 => "polar interpolation",
        310 | 311..=313 | 370 | 360 | 350 | 1360 => {
            "it ends where a signal comes, which only the machine knows"
        }
        440 => {
            "it takes a length off: state the length with the other sign in the set-up file and write G43"
        }
        510 | 511 | 501 | 500 | 1010 => "it scales or mirrors coordinates",
        542 | 2540 => "an offset that turns with the table",
        600 => "it comes to its place from one side, by a motion of its own",
        650 | 660 | 661 => "it calls a macro, whose motions are not in the program",
        682..=684 | 531 | 2680 => "a tilted plane",
        435 => "directions of the tool are followed as angles of the rotary axes only",
        _ => "",
    };
    if !why.is_empty() {
        return Some(why.to_owned());
    }
    let known = |control: &Control| control.has_harmless(code) || control.has_numbered_offset(code);
    let names: Vec<&str> = (CONTROLS.iter())
        .filter(|(_, control)| known(control))
        .map(|(name, _)| *name)
        .collect();
    (!names.is_empty()).then(|| {
        format!(
            "it is known with control = \"{}\" in the set-up file",
            names.join("\" or \"")
        )
    })
}

impl Interpreter {
    /// The work offset that a code of a block chooses.
    pub(crate) fn system_of(
        &self,
        code: Code,
        codes: &Codes,
        given: &Given<'_>,
    ) -> Result<usize, NcError> {
        let control = self.control;
        let is_numbered = control.is_some_and(|control| control.has_numbered_offset(code));
        // FANUC controls read G54 P2 as G54.1 P2.
        let with_p = code == 540
            && given.has(b'P')
            && matches!(control, Some(Control::Fanuc | Control::Mazak));
        if !is_numbered && !with_p {
            let found = WORK_OFFSETS.iter().position(|of| *of == code);
            return Ok(found.unwrap_or(self.modal.system));
        }
        if (1100..=1290).contains(&code) {
            return Ok(NUMBERED + usize::from(code / 10 - 110));
        }
        let is_elsewhere = codes.not_modal().is_some()
            || codes
                .motion()
                .or(self.modal.motion)
                .is_some_and(|code| code > 30 && given.names_axes());
        let most = control.map_or(MOST_NUMBERED, Control::last_numbered);
        match given.whole(b'P')? {
            Some(number) if (1..=most).contains(&number) && !is_elsewhere => Ok(numbered(number)),
            _ => Err(given.refused(&format!(
                "{} without a P from 1 to {most} of its own, the number of the work offset",
                crate::codes::text(code)
            ))),
        }
    }

    /// Whether a dwell has its time in X or U: seconds, on FANUC and Mazak controls.
    pub(crate) fn dwells_by_axis(&self, codes: &Codes, given: &Given<'_>) -> bool {
        let has_time = given.has(b'X') || given.has(b'U');
        let others = (0..9).any(|axis| given.word(axis).is_some() && !matches!(axis, 0 | 6));
        codes.not_modal() == Some(40)
            && codes.motion().is_none()
            && has_time
            && !others
            && matches!(self.control, Some(Control::Fanuc | Control::Mazak))
    }

    /// # Errors
    /// U, V or W without such an axis: incremental X, Y or Z on lathes with these controls.
    pub(crate) fn check_incremental_letters(
        &self,
        codes: &Codes,
        given: &Given<'_>,
    ) -> Result<(), NcError> {
        let is_lacked = |axis: &usize| given.word(*axis).is_some() && !self.machine_has(*axis);
        let axis = (6..9).find(is_lacked).filter(|_| {
            codes.not_modal() != Some(40)
                && codes.with_arguments().is_none()
                && self.control.is_some_and(Control::is_fanuc_like)
        });
        let Some(axis) = axis else {
            return Ok(());
        };
        let [letter, of] = [axis, axis - 6].map(|axis| char::from(LETTERS[axis]));
        Err(given.refused(&format!(
            "{letter} without such an axis in the machine file: lathes with this control read it as an incremental {of}; program the position of {of}, or add the axis {letter} to the machine file"
        )))
    }

    /// The letter that says how often a cycle is done, and whether 0 stores the cycle without a hole.
    pub(crate) fn repeats_by(&self) -> (u8, bool) {
        match self.control {
            Some(Control::Fanuc) => (b'K', true),
            Some(Control::Haas) => (b'L', true),
            _ => (b'L', false),
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
    let DecimalPoints {
        means_increments,
        may_mix,
        last_in_increments,
    } = interpreter.points;
    if !means_increments {
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
    // Codes that contradict each other are refused where the block is interpreted.
    let codes = Codes::of(block, interpreter.control).ok();
    if codes
        .as_ref()
        .is_some_and(|codes| codes.with_arguments().is_some())
    {
        // The meaning of the words of an unknown M code is not known.
        return Ok(());
    }
    let drills = codes.is_some_and(|codes| {
        let motion = codes.motion().or(interpreter.modal.motion);
        motion.is_some_and(is_cycle)
    });
    let names_axes = (block.words.iter()).any(|word| b"XYZABCUVW".contains(&word.letter));
    let (is_table, is_rotation) = (has(&[10.0]), has(&[68.0]));
    // Y is an angle there.
    let is_polar = !has(&[15.0]) && (has(&[16.0]) || interpreter.modal.polar.is_some());
    let mut last = last_in_increments;
    for word in &mut block.words {
        let is_coordinate = match word.letter {
            b'X' | b'Y' | b'Z' | b'A' | b'B' | b'C' | b'U' | b'V' | b'W' | b'I' | b'J' => true,
            // In a cycle it is how often it is done.
            b'K' => !drills,
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
        word.in_increments = true;
    }
    if is_polar
        && unit_mm != 1.0
        && block
            .words
            .iter()
            .any(|word| word.letter == b'Y' && word.in_increments)
    {
        return Err(Fault::NotFollowed {
            column: 1,
            found: "an angle without a decimal point under G16 in inches".to_owned(),
            why: "its least increment is not known here: write it with a point",
        });
    }
    block.last_in_increments = last;
    Ok(())
}
