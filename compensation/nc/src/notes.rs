//! Notes for the user about a compensated program: each once, with the first line that it applies to.

use std::collections::BTreeMap;

use crate::modal::name_of_offset;

/// A note about a compensated program.
#[expect(missing_docs, reason = "the messages say it")]
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
#[non_exhaustive]
pub enum Note {
    #[error("the length of tool {0} is not in the set-up: zero was taken")]
    NoToolLength(u32),
    #[error(
        "the set-up has tools by their numbers only: the length of the tool that is taken here was taken as zero"
    )]
    NamedTool,
    #[error(
        "arcs get a coordinate beside those of their plane (a straight motion on top of the arc), which older controls may not take"
    )]
    Superposed,
    #[error("motions of {0} pass on without a correction")]
    PassedOn(String),
    #[error("splines of {0} go as a whole, with the correction that they begin with")]
    GoesWhole(String),
    #[error(
        "the place that is stored here is not known, since the program has not named every axis before"
    )]
    HomeUnknown,
    #[error("the machine has no axis {0}: its words pass on as they are")]
    NoAxis(char),
    #[error(
        "corrections of {0} are left out until the program names that axis, since it is not known where it stands"
    )]
    LeftOut(char),
    #[error("{0} leaves its travel; beyond its ends the errors there are taken")]
    OutsideTravel(char),
    #[error(
        "with the radius of the tool compensated (G41, G42) the contour is corrected, not the path of the tool's centre"
    )]
    RadiusCompensated,
    #[error(
        "with the radius of the tool compensated (G41, G42) motions are not split, since a control may cut away parts that are shorter than that radius: the correction of this one bends between its ends by more than the tolerance"
    )]
    ContourWhole,
    #[error(
        "the corrected line is longer than 254 characters, which LinuxCNC and others refuse: move its comment to a line of its own"
    )]
    LongLine,
    #[error("work offset {0} is not in the set-up: zero was taken")]
    NoOffset(String),
    #[error("the place of {0} is not in the set-up ([home.{0}]): machine zero was taken")]
    NoHome(&'static str),
    #[error(
        "it is not known where the axes stand that get new coordinates here, so that their corrections are left out behind it: [start] of the set-up says it"
    )]
    NoStart,
    #[error(
        "a cycle before G98 or G99: LinuxCNC leaves the tool in the plane R, FANUC controls where it began, so that corrections of {0} are left out behind it until the program names that axis"
    )]
    ReturnPlane(char),
    #[error(
        "{0} passes on as it is: where the axes are counts as unknown after it, until the program names them"
    )]
    MayMove(String),
    #[error(
        "motions in machine coordinates (G53, G28, G30, SUPA, M91) pass on without a correction"
    )]
    InMachine,
    #[error(
        "motions are not split, and arcs not corrected, while it is not known where {0} stands"
    )]
    NotSplit(char),
    #[error(
        "play is taken up on the way of this arc, not before it, since the block also switches what coordinates or F mean (G15, G16, G93 to G95): write that code into a block before it"
    )]
    NotTakenUp,
    #[error(
        "a block that may be skipped (/): where the axes stand that it moves counts as unknown behind it, until the program names them again"
    )]
    MayBeSkipped,
    #[error(
        "{0} may roll over at the control (modulo, or a travel of a turn or more in the machine file), and is taken to turn as a linear axis: where the control turns it by the shorter way, state rotary_words = \"shorter\" in the set-up file, else \"linear\". Do not run the result where the sign of a word is the direction (WRAPPED_ROTARY of LinuxCNC, parameter 1008#1 of FANUC)"
    )]
    RollsOver(char),
    #[error(
        "the direction of approach of {0} is unknown: the mean of both directions is corrected until {0} moves on. Before this line, move {0} from one position to another in known coordinates"
    )]
    UnknownApproach(char),
    #[error(
        "M10 clamps a rotary axis, and {0} gets words with its correction while it is clamped: remove the M10, or leave {0} out of `correct`"
    )]
    Clamped(char),
    #[error(
        "motions are split while an exact stop is active (G61, G60 of SINUMERIK): the control stops at the end of each part; use G64 where that leaves marks"
    )]
    ExactStop,
    #[error(
        "at the zero of {0} the machine is off by X {x:.1} Y {y:.1} Z {z:.1} µm: where that zero was probed without the correction, add this to {0} at the control (not in the set-up); otherwise the whole part is offset by this amount",
        x = .1[0] as f64 / 10.0, y = .1[1] as f64 / 10.0, z = .1[2] as f64 / 10.0
    )]
    OffAtZero(String, [i64; 3]),
}

impl Note {
    /// `None` if the error rounds to zero.
    pub(crate) fn off_at_zero(system: usize, off_mm: [f64; 3]) -> Option<Self> {
        #[expect(clippy::cast_possible_truncation, reason = "errors are mm at the most")]
        let tenths_um = off_mm.map(|mm| (1e4 * mm).round() as i64);
        (tenths_um != [0; 3]).then(|| Self::OffAtZero(name_of_offset(system), tenths_um))
    }
}

/// Notes, each with the first line that it applies to, counted from 1.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notes(BTreeMap<Note, usize>);

impl Notes {
    pub(crate) fn add(&mut self, note: Note, line: usize) {
        self.0.entry(note).or_insert(line);
    }

    pub(crate) fn has(&self, note: &Note) -> bool {
        self.0.contains_key(note)
    }

    /// Each note and its line, ordered by line.
    #[must_use]
    pub fn by_line(&self) -> Vec<(usize, &Note)> {
        let mut notes: Vec<_> = self.0.iter().map(|(note, line)| (*line, note)).collect();
        notes.sort();
        notes
    }
}
