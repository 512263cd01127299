//! Modal state: everything a program has set that gives later words their meaning.

use std::sync::Arc;

use crate::{
    block::Cycle,
    coordinates::{Axes, Frame, Tip, TipFrame, turned},
};

/// Number of RS-274 work offsets, G54 to G59.3; SINUMERIK has the first four as well.
pub(crate) const RS274_SYSTEMS: usize = 9;

pub(crate) const WORK_OFFSETS: [Code; RS274_SYSTEMS] =
    [540, 550, 560, 570, 580, 590, 591, 592, 593];

/// Index of G505: the SINUMERIK offsets G505 to G599 and G500 follow the RS-274 ones.
pub(crate) const G505: usize = RS274_SYSTEMS;

pub(crate) const G500: usize = G505 + 95;

/// Index of the first numbered work offset: `G54.1 P1` of FANUC, `G154 P1` of Haas, the presets of HEIDENHAIN.
pub(crate) const NUMBERED: usize = G500 + 1;

pub(crate) const MAX_NUMBERED_OFFSET: u32 = 300;

pub(crate) const SYSTEMS: usize = NUMBERED + MAX_NUMBERED_OFFSET as usize;

/// Index of the work offset with a number from 1 to [`MAX_NUMBERED_OFFSET`].
pub(crate) fn numbered(number: u32) -> usize {
    NUMBERED + number as usize - 1
}

/// A G or M code in tenths: 431 is G43.1.
pub(crate) type Code = u16;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Plane {
    #[default]
    Xy,
    Zx,
    Yz,
}

impl Plane {
    /// The two axes of the plane, right-handed, and the one normal to it.
    pub(crate) fn axes(self) -> [usize; 3] {
        match self {
            Self::Xy => [0, 1, 2],
            Self::Zx => [2, 0, 1],
            Self::Yz => [1, 2, 0],
        }
    }

    /// Letters of the arc-centre words along the first and the second axis of the plane.
    pub(crate) fn centre_letters(self) -> [u8; 2] {
        match self {
            Self::Xy => [b'I', b'J'],
            Self::Zx => [b'K', b'I'],
            Self::Yz => [b'J', b'K'],
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum FeedMode {
    /// Reciprocal of the duration of the motion in minutes.
    InverseTime,
    #[default]
    PerMinute,
    PerRevolution,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum CentrePoint {
    #[default]
    Off,
    /// Active until the tool length is changed or cancelled (G43.4).
    WithToolLength,
    /// Active until it is switched off (M429); switched on by M428 or the set-up.
    Switched,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct WorkOffset {
    pub(crate) offset: Axes,
    pub(crate) rotation_deg: f64,
}

/// Programmed shift and rotation on top of the work offset; the one programmed last is applied to program coordinates first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ProgrammedFrame {
    pub(crate) by: Axes,
    pub(crate) angle_deg: f64,
}

impl ProgrammedFrame {
    /// Adds a shift in the present coordinates, which may be rotated.
    pub(crate) fn shift(&mut self, by: &Axes) {
        for (sum, by) in self.by.iter_mut().zip(turned(by, self.angle_deg)) {
            *sum += by;
        }
    }
}

/// Values of a canned cycle that persist from hole to hole, in program coordinates, mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sticky {
    /// Tool position along the depth axis before the first hole.
    pub(crate) initial: Option<f64>,
    /// Whether the position of the depth axis was known; `None` before the first hole.
    pub(crate) initial_is_known: Option<bool>,
    /// Words of depth and R: absolute in G90; in G91 R counts from the initial position and the depth from R.
    pub(crate) depth: Option<f64>,
    pub(crate) clearance: Option<f64>,
    /// Whether the depth and R were programmed in G91.
    pub(crate) incremental: [bool; 2],
}

#[expect(clippy::struct_excessive_bools, reason = "each is a separate switch")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Modal {
    /// mm per unit of length.
    pub(crate) unit_mm: f64,
    pub(crate) plane: Plane,
    pub(crate) absolute: bool,
    /// Arc centres are absolute, not relative to the start of the arc.
    pub(crate) centre_absolute: bool,
    /// X words are diameters.
    pub(crate) diameter: bool,
    /// Motion code of blocks that have coordinates only.
    pub(crate) motion: Option<Code>,
    /// Set if another motion mode may be active, because the block that set this one may be skipped.
    pub(crate) motion_unsure: bool,
    pub(crate) feed_mode: FeedMode,
    pub(crate) feed: Option<f64>,
    /// The control stops at the end of every motion (G61, G60 of SINUMERIK).
    pub(crate) exact_stop: bool,
    /// The program has clamped a rotary axis (M10).
    pub(crate) clamped: bool,
    pub(crate) system: usize,
    pub(crate) offsets: Vec<WorkOffset>,
    /// G92 or G52 shift, active or not.
    pub(crate) shift: Axes,
    pub(crate) shifted: bool,
    /// The shift was set by G52, not by G92.
    pub(crate) shift_is_local: bool,
    /// Axes whose shift the program has stated by G52 or G92.1. Before, an earlier program may have left one in the control, which G92
    /// does not state: it is relative to that shift.
    pub(crate) shift_is_said: Axes<bool>,
    /// The program has set or ended a shift, so that G92.3 brings back its own.
    pub(crate) has_set_shift: bool,
    /// The program has stated a tool length, or that there is none. Before, an earlier program may have left one in the control.
    pub(crate) length_is_said: bool,
    /// The program has stated the work offset.
    pub(crate) system_is_said: bool,
    pub(crate) tool_offset: Axes,
    /// Length unit when the tool offset was activated, mm.
    pub(crate) length_unit_mm: f64,
    /// Number of the tool length activated by G43; `None`: none.
    pub(crate) length: Option<u32>,
    /// Tool centre point control, independent of rotary motion (G43.4, M428).
    pub(crate) centre_point: CentrePoint,
    /// Rotation of G68, deg, and its centre.
    pub(crate) rotation: Option<(f64, [f64; 2])>,
    /// Axes whose coordinates have changed and that no absolute position has named since. Controls differ in the
    /// meaning of an incremental word of such an axis.
    pub(crate) frame_is_new: Axes<bool>,
    pub(crate) programmed: ProgrammedFrame,
    /// Centre of arcs and polar coordinates set by a separate block: a position in X and Y.
    pub(crate) pole: Option<[f64; 2]>,
    /// `Some` under G16, where X and Y words are a distance from zero and an angle: the last value of each, mm and deg.
    pub(crate) polar: Option<[Option<f64>; 2]>,
    /// Rotary axes take the shorter way (M126).
    pub(crate) shorter: bool,
    pub(crate) goes_on: bool,
    pub(crate) awaits_preset: bool,
    pub(crate) defined: Option<Cycle>,
    /// Cycle executed after each motion.
    pub(crate) each_motion: Option<Cycle>,
    /// Active cutter radius compensation: 410 or 420.
    pub(crate) radius: Option<Code>,
    /// Cycles return to the initial position (G98), not to plane R (G99).
    pub(crate) comes_back: bool,
    /// The program has stated G98 or G99.
    pub(crate) says_return: bool,
    pub(crate) sticky: Sticky,
    pub(crate) tool: Option<u32>,
    /// Positions of G28 and G30, in machine coordinates.
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
            exact_stop: false,
            clamped: false,
            system: 0,
            offsets: vec![WorkOffset::default(); SYSTEMS],
            shift: [0.0; 9],
            shifted: false,
            shift_is_local: false,
            shift_is_said: [false; 9],
            has_set_shift: false,
            length_is_said: false,
            system_is_said: false,
            tool_offset: [0.0; 9],
            length_unit_mm: 1.0,
            length: None,
            centre_point: CentrePoint::Off,
            rotation: None,
            frame_is_new: [false; 9],
            programmed: ProgrammedFrame::default(),
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
    /// Transformation between program and machine; `tip` are the kinematics of tool centre point control.
    pub(crate) fn frame(&self, tip: Option<&Arc<Tip>>) -> Frame {
        let work = &self.offsets[self.system.min(SYSTEMS - 1)];
        let (rotation_deg, centre) = self.rotation.unwrap_or((work.rotation_deg, [0.0; 2]));
        let offset = work.offset;
        let mut work = offset;
        let ProgrammedFrame { by, angle_deg } = &self.programmed;
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

    /// mm or deg per unit of a word of this axis.
    #[inline]
    pub(crate) fn scale(&self, axis: usize) -> f64 {
        match axis {
            0 if self.diameter => 0.5 * self.unit_mm,
            3..6 => 1.0,
            _ => self.unit_mm,
        }
    }

    /// mm or deg per unit of a cycle's height word along this axis: R is a radius even where X is a diameter (G7).
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

pub(crate) fn code_text(code: Code) -> String {
    if code.is_multiple_of(10) {
        format!("G{}", code / 10)
    } else {
        format!("G{}.{}", code / 10, code % 10)
    }
}
