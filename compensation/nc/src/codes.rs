//! The words of a block: at most one G or M code of each modal group, and each other letter once.

use crate::{
    NcError,
    block::{Block, Manner, POLAR, Word},
    control::{Control, why_refused},
    coordinates::{Axes, axis_of},
    error::Fault,
    modal::{Code, Modal, WORK_OFFSETS, code_text},
};

/// G codes that move no axis and do not affect coordinates: path mode, spindle speed mode, exact stop.
const HARMLESS: [Code; 6] = [90, 610, 611, 640, 960, 970];

/// G64; its Q is the naive CAM tolerance.
const PATH_MODE: Code = 640;

#[expect(clippy::struct_excessive_bools, reason = "each is a separate code")]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Codes {
    pub(crate) motion: Option<Code>,
    pub(crate) not_modal: Option<Code>,
    pub(crate) plane: Option<Code>,
    pub(crate) diameter: Option<Code>,
    pub(crate) distance: Option<Code>,
    pub(crate) centre: Option<Code>,
    pub(crate) feed: Option<Code>,
    pub(crate) units: Option<Code>,
    pub(crate) radius: Option<Code>,
    pub(crate) tool_length: Option<Code>,
    pub(crate) work_offset: Option<Code>,
    pub(crate) comes_back: Option<Code>,
    pub(crate) rotation: Option<Code>,
    pub(crate) polar: Option<Code>,
    /// Motion in machine coordinates (G53).
    pub(crate) in_machine: bool,
    /// The program ends here (M2, M30).
    pub(crate) ends: bool,
    pub(crate) calls: Option<Code>,
    /// M70 to M73, which save and restore modal state, and M96, M97 and M198, which jump elsewhere.
    pub(crate) not_followed: Option<Code>,
    /// A code of this control that moves no axis and changes no coordinate.
    pub(crate) harmless: Option<Code>,
    /// `Some(true)` (G61): from now on the control stops at the end of every motion; `Some(false)` (G64): it does not; `None`: unchanged.
    pub(crate) exact_stop: Option<bool>,
    /// `Some(true)` (M10) clamps a rotary axis on FANUC-like controls, `Some(false)` (M11) unclamps it.
    pub(crate) clamps: Option<bool>,
    /// M6: puts the selected tool into the spindle.
    pub(crate) changes_tool: bool,
    /// M60: exchanges the pallet.
    pub(crate) exchanges_pallet: bool,
    /// M61: states the number of the tool in the spindle, by Q.
    pub(crate) states_tool: bool,
    unknown: Option<usize>,
    /// Set if a code takes, or may take, further words: E, K, Q and R are then no errors.
    pub(crate) has_words: bool,
    /// M430: switches on user-defined kinematics of LinuxCNC.
    pub(crate) own_kinematics: bool,
    /// `Some(true)` (M428): from now on coordinates are those of the tool centre point; `Some(false)` (M429): those of the axes; `None`: unchanged.
    pub(crate) centre_point: Option<bool>,
}

impl Codes {
    /// Collects the codes with their meaning on `control`; `None`: the meaning common to all controls. `line` is used in messages.
    pub(crate) fn of(
        block: &Block,
        control: Option<Control>,
        line: usize,
    ) -> Result<Self, NcError> {
        let mut codes = Self::default();
        // FANUC-like controls leave some of LinuxCNC's M codes to the machine builder.
        let has_own_m = control.is_some_and(Control::is_fanuc_like);
        for (place, word) in block.words.iter().enumerate() {
            if word.letter != b'G' && word.letter != b'M' {
                continue;
            }
            // Machine builders' codes, up to eight digits.
            let is_high = |value: f64| (1000.0..1e8).contains(&value) && value.fract() == 0.0;
            if word.letter == b'M' && word.value.is_some_and(is_high) {
                codes.unknown = Some(place);
                continue;
            }
            let Some(code) = word.value.and_then(code_of) else {
                return Err(no_code(word, line));
            };
            if word.letter == b'M' {
                match code {
                    20 | 300 => codes.ends = true,
                    60 => codes.changes_tool = true,
                    600 => codes.exchanges_pallet = true,
                    100 | 110 => codes.clamps = Some(code == 100),
                    980 | 990 => codes.calls = Some(code),
                    970 | 1980 => codes.not_followed = Some(code),
                    // A jump on Haas; an interrupt that calls a macro on the others.
                    960 if has_own_m => codes.not_followed = Some(code),
                    _ if has_own_m => {}
                    700 | 710 | 720 | 730 => codes.not_followed = Some(code),
                    610 => codes.states_tool = true,
                    4280 => codes.centre_point = Some(true),
                    4290 => codes.centre_point = Some(false),
                    4300 => codes.own_kinematics = true,
                    _ => {}
                }
                match m_code(code, control) {
                    MCode::Alone => {}
                    MCode::WithWords => codes.has_words = true,
                    MCode::Unknown => codes.unknown = Some(place),
                }
                continue;
            }
            codes.exact_stop = stops_exactly(code, control).or(codes.exact_stop);
            let refused = control.and_then(|control| control.refuses(code));
            if code == 530 && refused.is_none() {
                codes.in_machine = true;
                continue;
            }
            if let Some(control) = control
                && control.has_harmless(code)
            {
                codes.harmless = Some(code);
                codes.has_words = true;
                continue;
            }
            codes.has_words |= code == PATH_MODE;
            let numbered = control.is_some_and(|control| control.has_numbered_offset(code));
            let group = match refused {
                _ if numbered => Some(&mut codes.work_offset),
                None => codes.group(code),
                Some(_) => None,
            };
            match group {
                Some(group) => {
                    // FANUC programs cancel a cycle in the block of the next motion: G80 G0.
                    *group = Some(match (*group, code) {
                        (Some(800), 0..=30) | (None, _) => code,
                        (Some(motion @ 0..=30), 800) => motion,
                        (Some(other), _) => {
                            let fault =
                                Fault::Twice { found: code_text(code), other: code_text(other) };
                            return Err(NcError::Block { line, fault });
                        }
                    });
                }
                None if HARMLESS.contains(&code) => {}
                None => return Err(unknown_code(code, control, line)),
            }
        }
        codes.has_words |= codes.unknown.is_some();
        Ok(codes)
    }

    /// Index of an unknown M code whose arguments the axis words may be, as in `M92 X80` on a printer or in a macro call; `None` if another
    /// code of the block takes them.
    pub(crate) fn with_arguments(&self) -> Option<usize> {
        let are_taken = self.motion.is_some()
            || self.not_modal.is_some()
            || self.calls.is_some()
            || self.tool_length == Some(431)
            || self.rotation == Some(680);
        self.unknown.filter(|_| !are_taken)
    }

    /// G5 and G5.1 without axes become look-ahead instead of splines: FANUC programs have G05 P10000 and G05.1 Q1.
    /// Returns true if G5 or G5.1 names axes on a control without these splines, where G05.1 Q2 X0 Y0 Z0 names the axes
    /// to be smoothed.
    pub(crate) fn ends_smoothing(&mut self, names_axes: bool, control: Option<Control>) -> bool {
        if !names_axes && matches!(self.motion, Some(50 | 51)) {
            self.motion = None;
        }
        let has_splines = !control.is_some_and(Control::is_fanuc_like);
        !has_splines && matches!(self.motion, Some(50..=52))
    }

    /// Field of a code's modal group; `None` if it belongs to no group.
    fn group(&mut self, code: Code) -> Option<&mut Option<Code>> {
        Some(match code {
            0 | 10 | 20 | 30 | 50 | 51 | 52 | 53 | 330 | 331 | 382 | 383 | 384 | 385 | 730
            | 740 | 760 | 800 | 810 | 820 | 830 | 840 | 850 | 860 | 870 | 880 | 890 => {
                &mut self.motion
            }
            40 | 100 | 280 | 281 | 300 | 301 | 520 | 920 | 921 | 922 | 923 => &mut self.not_modal,
            170 | 180 | 190 => &mut self.plane,
            70 | 80 => &mut self.diameter,
            900 | 910 => &mut self.distance,
            901 | 911 => &mut self.centre,
            930 | 940 | 950 => &mut self.feed,
            200 | 210 => &mut self.units,
            400 | 410 | 411 | 420 | 421 => &mut self.radius,
            430 | 431 | 432 | 434 | 490 => &mut self.tool_length,
            _ if WORK_OFFSETS.contains(&code) => &mut self.work_offset,
            980 | 990 => &mut self.comes_back,
            680 | 690 => &mut self.rotation,
            150 | 160 => &mut self.polar,
            _ => return None,
        })
    }
}

fn no_code(word: &Word, line: usize) -> NcError {
    let letter = char::from(word.letter);
    match word.value {
        None => NcError::OnlyAtMachine { line, word: letter },
        Some(_) => {
            NcError::not_compensated(line, format!("{letter} with a number that is not a code"))
        }
    }
}

fn unknown_code(code: Code, control: Option<Control>, line: usize) -> NcError {
    let what = match why_refused(code, control) {
        Some(why) => format!("{} is not supported: {why}", code_text(code)),
        None => format!(
            "{} is unknown: it may move an axis, so the program cannot be compensated",
            code_text(code)
        ),
    };
    NcError::not_compensated(line, what)
}

enum MCode {
    /// Takes no words but S.
    Alone,
    WithWords,
    Unknown,
}

/// Classifies an M code of RS-274. Codes added by machine builders are unknown.
fn m_code(code: Code, control: Option<Control>) -> MCode {
    let is_builders = control.is_some_and(Control::is_fanuc_like);
    match code {
        0..=90 | 300 | 480 | 490 | 600 | 980 | 990 if code.is_multiple_of(10) => MCode::Alone,
        190 => MCode::WithWords,
        _ if is_builders => MCode::Unknown,
        700..=730 | 4280..=4300 => MCode::Alone,
        500..=530 | 610..=680 => MCode::WithWords,
        // User programs, with P and Q.
        1000..=1990 if control == Some(Control::LinuxCnc) => MCode::WithWords,
        _ => MCode::Unknown,
    }
}

/// Whether a G code switches the exact stop at the end of every motion on or off; `None`: neither.
fn stops_exactly(code: Code, control: Option<Control>) -> Option<bool> {
    match code {
        // G61.1 is shape compensation on Mazak controls.
        611 if control == Some(Control::Mazak) => None,
        610 | 611 => Some(true),
        620 | 630 | 640 => Some(false),
        _ => None,
    }
}

/// True for drilling cycles: G73 to G89 except G80, which cancels a cycle.
pub(crate) fn is_cycle(code: Code) -> bool {
    (730..=890).contains(&code) && code != 800
}

/// A code number in tenths; `None` if it is not a code.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the range was checked before"
)]
fn code_of(value: f64) -> Option<Code> {
    let tenths = (value * 10.0).round();
    let is_code = (tenths - value * 10.0).abs() < 1e-3 && (0.0..=9990.0).contains(&tenths);
    is_code.then_some(tenths as Code)
}

/// Maximum value: larger numbers are not machine coordinates and would lose decimals.
pub(crate) const LARGEST: f64 = 1e9;

#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockWords<'a> {
    pub(crate) block: &'a Block,
    pub(crate) places: Axes<Option<usize>>,
    /// Indices of the distance and the angle, if the block has polar coordinates.
    pub(crate) polar: Option<[Option<usize>; 2]>,
    /// One bit per letter of the block's words, and one for all non-letters.
    letters: u32,
    /// Line number, counted from 1.
    pub(crate) line: usize,
}

impl<'a> BlockWords<'a> {
    /// Collects the words of a block; with `are_polar` its X and Y words are a distance and an angle. Errors: a letter occurs twice.
    pub(crate) fn new(block: &'a Block, line: usize, are_polar: bool) -> Result<Self, NcError> {
        let mut places = [None; 9];
        let mut polar = [None; 2];
        let mut seen = 0_u32;
        for (place, word) in block.words.iter().enumerate() {
            if let Some(axis) = axis_of(word.letter) {
                places[axis] = Some(place);
            }
            let letter = word.letter;
            let of_polar = POLAR.iter().position(|of| *of == letter);
            if let Some(of) = of_polar {
                polar[of] = Some(place);
            }
            // Distance and angle may each occur once.
            let bit = of_polar.map_or_else(|| bit_of(letter), |of| 1 << (27 + of));
            let stands_once = letter.is_ascii_uppercase() && letter != b'G' && letter != b'M';
            if (stands_once || of_polar.is_some()) && seen & bit != 0 {
                let name = char::from(letter).to_string();
                return Err(NcError::Block {
                    line,
                    fault: Fault::Twice { found: name.clone(), other: name },
                });
            }
            seen |= bit | bit_of(letter);
        }
        if are_polar {
            polar = [places[0].take(), places[1].take()];
        }
        Ok(Self {
            block,
            places,
            polar: (polar != [None; 2]).then_some(polar),
            letters: seen,
            line,
        })
    }

    pub(crate) fn names_axes(&self) -> bool {
        self.places.iter().any(Option::is_some)
    }

    pub(crate) fn has(&self, letter: u8) -> bool {
        self.find(letter).is_some()
    }

    pub(crate) fn find(&self, letter: u8) -> Option<&'a Word> {
        if self.letters & bit_of(letter) == 0 {
            return None;
        }
        self.block.word(letter)
    }

    pub(crate) fn word(&self, axis: usize) -> Option<&'a Word> {
        self.block.words.get(self.places[axis]?)
    }

    /// True if the centre of an arc along the axis of this letter is absolute, not relative to the arc's start.
    pub(crate) fn centre_is_absolute(&self, letter: u8, modal: &Modal) -> bool {
        let word = self.block.word(letter);
        centre_is_absolute(word.map(|word| word.manner), modal)
    }

    /// Value of an axis word, in the unit of the word (mm, inch or deg); `None` if the block does not name the axis.
    pub(crate) fn axis(&self, axis: usize) -> Result<Option<f64>, NcError> {
        let word = self.word(axis);
        word.map(|word| self.value_of(word)).transpose()
    }

    /// Axes that the block names, by index, with their values in the units of the words.
    pub(crate) fn axes(&self) -> Result<impl Iterator<Item = (usize, f64)> + use<>, NcError> {
        let mut values = [None; 9];
        for (axis, value) in values.iter_mut().enumerate() {
            *value = self.axis(axis)?;
        }
        Ok((0..9).filter_map(move |axis| Some((axis, values[axis]?))))
    }

    pub(crate) fn letter(&self, letter: u8) -> Result<Option<f64>, NcError> {
        let word = self.find(letter);
        word.map(|word| self.value_of(word)).transpose()
    }

    /// Value of a letter's word if it is a whole number up to 99999.
    pub(crate) fn whole(&self, letter: u8) -> Result<Option<u32>, NcError> {
        Ok(self.letter(letter)?.and_then(|value| whole(value, 99_999)))
    }

    /// The word of the polar distance (`of` = 0) or of the polar angle (`of` = 1).
    pub(crate) fn polar_word(&self, of: usize) -> Option<&'a Word> {
        self.block.words.get(self.polar?[of]?)
    }

    /// Value of a word, in the unit of the word.
    pub(crate) fn value_of(&self, word: &Word) -> Result<f64, NcError> {
        let letter = char::from(word.letter);
        let value = word.value.ok_or(NcError::OnlyAtMachine { line: self.line, word: letter })?;
        if value.abs() > LARGEST {
            let what = format!("{letter} with {value:e}, expected at most {LARGEST:e}");
            return Err(self.refused(&what));
        }
        Ok(value)
    }

    pub(crate) fn refused(&self, what: &str) -> NcError {
        NcError::NotCompensated { line: self.line, what: what.to_owned() }
    }
}

fn bit_of(letter: u8) -> u32 {
    let place = letter.wrapping_sub(b'A').min(26);
    1 << place
}

pub(crate) fn centre_is_absolute(manner: Option<Manner>, modal: &Modal) -> bool {
    match manner.unwrap_or_default() {
        Manner::Modal => modal.centre_absolute,
        Manner::Incremental => false,
        Manner::Absolute | Manner::Shortest => true,
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the range was checked before"
)]
pub(crate) fn whole(value: f64, most: u32) -> Option<u32> {
    let rounded = value.round();
    let is_whole = (value - rounded).abs() < 1e-3 && (0.0..=f64::from(most)).contains(&rounded);
    is_whole.then_some(rounded as u32)
}
