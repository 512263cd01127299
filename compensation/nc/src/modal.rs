//! What a program has switched on and set: everything that gives a later word its meaning.

use std::sync::Arc;

use crate::{
    block::Cycle,
    coordinates::{Axes, Frame, Tip, TipFrame, turned},
};

/// The work offsets of RS-274: G54 to G59.3. The first four are those of SINUMERIK, too.
pub(crate) const RS274_SYSTEMS: usize = 9;

/// Their codes.
pub(crate) const WORK_OFFSETS: [Code; RS274_SYSTEMS] =
    [540, 550, 560, 570, 580, 590, 591, 592, 593];

/// Behind them those that SINUMERIK has: G505 to G599, and G500.
pub(crate) const G505: usize = RS274_SYSTEMS;

pub(crate) const G500: usize = G505 + 95;

/// Behind them those that have numbers from 1 on: `G54.1 P1` of FANUC, `G154 P1` of Haas, the presets of HEIDENHAIN.
pub(crate) const NUMBERED: usize = G500 + 1;

/// The largest of these numbers.
pub(crate) const MOST_NUMBERED: u32 = 300;

/// All of them.
pub(crate) const SYSTEMS: usize = NUMBERED + MOST_NUMBERED as usize;

/// The work offset of a number from 1 to [`MOST_NUMBERED`].
pub(crate) fn numbered(number: u32) -> usize {
    NUMBERED + number as usize - 1
}

/// A G or M code in tenths: 431 is G43.1.
pub(crate) type Code = u16;

/// The plane of arcs and cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Plane {
    #[default]
    Xy,
    Zx,
    Yz,
}

impl Plane {
    /// Its two axes, right-handed, and the one normal to it.
    pub(crate) fn axes(self) -> [usize; 3] {
        match self {
            Self::Xy => [0, 1, 2],
            Self::Zx => [2, 0, 1],
            Self::Yz => [1, 2, 0],
        }
    }

    /// The letters of the centre along the first and the second axis.
    pub(crate) fn centre_letters(self) -> [u8; 2] {
        match self {
            Self::Xy => [b'I', b'J'],
            Self::Zx => [b'K', b'I'],
            Self::Yz => [b'J', b'K'],
        }
    }
}

/// What an F word means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum FeedMode {
    /// Minutes for the motion, one over.
    InverseTime,
    #[default]
    PerMinute,
    PerRevolution,
}

/// Whether coordinates are those of the centre point of the tool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum CentrePoint {
    #[default]
    Off,
    /// Until another tool length comes into force, or none (G43.4).
    WithToolLength,
    /// Until it is switched off (M428, the set-up).
    Switched,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct WorkOffset {
    pub(crate) offset: Axes,
    pub(crate) rotation_deg: f64,
}

/// What a program shifts and turns its coordinates by, besides the work offset: what is last is nearest to the program.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Programmed {
    pub(crate) by: Axes,
    pub(crate) angle_deg: f64,
}

impl Programmed {
    /// Shifts the coordinates by a way in those that hold.
    pub(crate) fn shift(&mut self, by: &Axes) {
        for (sum, by) in self.by.iter_mut().zip(turned(by, self.angle_deg)) {
            *sum += by;
        }
    }
}

/// What is kept of a canned cycle from hole to hole, in the coordinates of the program, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sticky {
    /// Where the tool was along the depth before the first hole, and whether that place is known.
    pub(crate) initial: Option<f64>,
    pub(crate) initial_is_known: Option<bool>,
    /// The words of the depth and of R: places in G90, in G91 R from there and the depth from R.
    pub(crate) depth: Option<f64>,
    pub(crate) clearance: Option<f64>,
    /// Whether each of them was given in G91.
    pub(crate) incremental: [bool; 2],
}

/// State of a program that is read.
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of its own")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Modal {
    /// mm for each unit of length.
    pub(crate) unit_mm: f64,
    pub(crate) plane: Plane,
    pub(crate) absolute: bool,
    /// The centre of an arc is a place, not a way from its beginning.
    pub(crate) centre_absolute: bool,
    /// X words are diameters.
    pub(crate) diameter: bool,
    /// The motion that coordinates alone stand for.
    pub(crate) motion: Option<Code>,
    /// Another one may hold: the block that has switched it may be skipped.
    pub(crate) motion_unsure: bool,
    pub(crate) feed_mode: FeedMode,
    pub(crate) feed: Option<f64>,
    /// FGROUP or FGREF have changed what F means (SINUMERIK).
    pub(crate) feed_is_grouped: bool,
    pub(crate) system: usize,
    pub(crate) offsets: Vec<WorkOffset>,
    /// The offset of G92 or G52, whether it holds or not.
    pub(crate) shift: Axes,
    pub(crate) shifted: bool,
    /// It is that of G52.
    pub(crate) shift_is_local: bool,
    /// The program has said what it is.
    pub(crate) shift_is_said: bool,
    pub(crate) tool_offset: Axes,
    /// The unit that held where it was put into force, mm.
    pub(crate) length_unit_mm: f64,
    /// The number of the length that G43 has put into force; `None`: none.
    pub(crate) length: Option<u32>,
    /// Coordinates are those of the centre point of the tool, whatever the rotary axes do (G43.4, M428).
    pub(crate) centre_point: CentrePoint,
    /// The rotation of G68, deg, and its centre.
    pub(crate) rotation: Option<(f64, [f64; 2])>,
    /// No place in its plane has been named under it.
    pub(crate) rotation_is_new: bool,
    /// TRANS and ROT.
    pub(crate) programmed: Programmed,
    /// The centre of arcs and polar coordinates, where a block of its own says it: a place in X and Y.
    pub(crate) pole: Option<[f64; 2]>,
    /// X and Y words are the distance from zero and the angle (G16), with those that were said last, mm and deg.
    pub(crate) polar: Option<[Option<f64>; 2]>,
    /// Rotary axes go the shorter way (M126).
    pub(crate) shorter: bool,
    /// The block goes on in the next line.
    pub(crate) goes_on: bool,
    /// The number of a preset stands in one of the next lines.
    pub(crate) awaits_preset: bool,
    /// The cycle that is done where one is called.
    pub(crate) defined: Option<Cycle>,
    /// A cycle that is done behind each motion.
    pub(crate) each_motion: Option<Cycle>,
    /// The radius of the tool is compensated: 410 or 420.
    pub(crate) radius: Option<Code>,
    /// A cycle comes back to where it began, not to its clearance plane.
    pub(crate) comes_back: bool,
    /// The program has said which of the two.
    pub(crate) says_return: bool,
    pub(crate) sticky: Sticky,
    pub(crate) tool: Option<u32>,
    /// The places of G28 and G30, in the machine's coordinates.
    pub(crate) homes: [Axes; 2],
}

impl Default for Modal {
    fn default() -> Self {
        Self {
            unit_mm: 1.0,
            plane: Plane::Xy,
            absolute: true,
            centre_absolute: false,
            diameter: false,
            motion: None,
            motion_unsure: false,
            feed_mode: FeedMode::PerMinute,
            feed: None,
            feed_is_grouped: false,
            system: 0,
            offsets: vec![WorkOffset::default(); SYSTEMS],
            shift: [0.0; 9],
            shifted: false,
            shift_is_local: false,
            shift_is_said: false,
            tool_offset: [0.0; 9],
            length_unit_mm: 1.0,
            length: None,
            centre_point: CentrePoint::Off,
            rotation: None,
            rotation_is_new: false,
            programmed: Programmed::default(),
            pole: None,
            polar: None,
            shorter: false,
            goes_on: false,
            awaits_preset: false,
            defined: None,
            each_motion: None,
            radius: None,
            comes_back: true,
            says_return: false,
            sticky: Sticky::default(),
            tool: None,
            homes: [[0.0; 9]; 2],
        }
    }
}

impl Modal {
    /// What lies between program and machine now; `tip` are the kinematics for the centre point of the tool.
    pub(crate) fn frame(&self, tip: Option<&Arc<Tip>>) -> Frame {
        let work = &self.offsets[self.system.min(SYSTEMS - 1)];
        let (rotation_deg, centre) = self.rotation.unwrap_or((work.rotation_deg, [0.0; 2]));
        let offset = work.offset;
        let mut work = offset;
        let Programmed { by, angle_deg } = &self.programmed;
        for (work, by) in work.iter_mut().zip(turned(by, rotation_deg)) {
            *work += by;
        }
        Frame {
            work,
            offset,
            shift: if self.shifted { self.shift } else { [0.0; 9] },
            tool: self.tool_offset,
            rotation_deg: rotation_deg + angle_deg,
            centre,
            tip: tip
                .filter(|_| self.centre_point != CentrePoint::Off)
                .map(|tip| TipFrame::new(Arc::clone(tip))),
        }
    }

    /// mm or deg for each unit of a word of this axis.
    #[inline]
    pub(crate) fn scale(&self, axis: usize) -> f64 {
        match axis {
            0 if self.diameter => 0.5 * self.unit_mm,
            3..6 => 1.0,
            _ => self.unit_mm,
        }
    }

    /// The same of a word of a cycle that says a height along this axis: R is no diameter where X is one (G7).
    pub(crate) fn height_scale(&self, letter: u8, axis: usize) -> f64 {
        match letter {
            b'R' => self.unit_mm,
            _ => self.scale(axis),
        }
    }
}

pub(crate) fn name_of_offset(system: usize) -> String {
    match WORK_OFFSETS.get(system) {
        Some(code) => code_text(*code),
        None if system == G500 => "G500".to_owned(),
        None if system >= NUMBERED => format!("P{}", system - NUMBERED + 1),
        None => format!("G{}", 505 + system - G505),
    }
}

/// A G code as people write it.
pub(crate) fn code_text(code: Code) -> String {
    if code.is_multiple_of(10) {
        format!("G{}", code / 10)
    } else {
        format!("G{}.{}", code / 10, code % 10)
    }
}
