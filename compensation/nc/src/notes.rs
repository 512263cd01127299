use std::collections::BTreeMap;

use crate::modal::name_of_offset;

/// A note about a compensated program.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
#[non_exhaustive]
pub enum Note {
    #[error("the set-up file has no length of tool {0}: zero is assumed")]
    NoToolLength(u32),
    #[error(
        "the set-up file has tools by number only: the length of the tool selected here by name is assumed to be zero"
    )]
    NamedTool,
    #[error(
        "G43 without H, and no tool was changed before: the length of the tool in the spindle is assumed to be zero; write its number as H"
    )]
    UnnamedTool,
    #[error(
        "arcs get a coordinate outside their plane (a superposed straight motion), which older controls may reject"
    )]
    Superposed,
    #[error("motions of {0} are copied without correction")]
    PassedOn(String),
    #[error("splines of {0} are not split; they keep the correction of their start")]
    GoesWhole(String),
    #[error(
        "the position stored here is unknown, because the program has not named every axis before"
    )]
    HomeUnknown,
    #[error("the machine has no axis {0}: its words are copied unchanged")]
    NoAxis(char),
    #[error(
        "corrections of {0} are omitted until the program names that axis, because its position is unknown"
    )]
    LeftOut(char),
    #[error("{0} leaves its travel; beyond an end the errors at that end are used")]
    OutsideTravel(char),
    #[error(
        "with cutter radius compensation (G41, G42) the contour is corrected, not the path of the tool centre"
    )]
    RadiusCompensated,
    #[error(
        "with cutter radius compensation (G41, G42) motions are not split, because a control may omit parts shorter than that radius: this motion deviates by more than the tolerance between its ends"
    )]
    ContourWhole,
    #[error(
        "the corrected line is longer than 254 characters, which LinuxCNC and others refuse: move its comment to a separate line"
    )]
    LongLine,
    /// The value is the index of the work offset.
    #[error("the set-up file has no work offset {}: zero is assumed", name_of_offset(*.0))]
    NoOffset(usize),
    #[error("the set-up file has no position of {0} ([home.{0}]): machine zero is assumed")]
    NoHome(&'static str),
    #[error(
        "the position of axes that get new coordinates here is unknown, so their corrections are omitted from here on: state [start] in the set-up file"
    )]
    NoStart,
    #[error(
        "a cycle before G98 or G99: LinuxCNC leaves the tool in plane R, FANUC controls at its start height, so corrections of {0} are omitted until the program names that axis"
    )]
    ReturnPlane(char),
    #[error(
        "{0} is copied unchanged: axis positions are unknown after it until the program names them"
    )]
    MayMove(String),
    #[error(
        "motions in machine coordinates (G53, G28, G30, SUPA, M91) are copied without correction"
    )]
    InMachine,
    #[error(
        "motions are not split and arcs are not corrected while the position of {0} is unknown"
    )]
    NotSplit(char),
    #[error(
        "backlash is taken up during this arc, not before it, because the block also changes the meaning of coordinates or F (G15, G16, G93 to G95): write that code into an earlier block"
    )]
    NotTakenUp,
    #[error(
        "a block that may be skipped (/): the positions of its axes are unknown after it until the program names them again"
    )]
    MayBeSkipped,
    #[error(
        "{0} may roll over at the control (modulo, or a travel of a turn or more in the machine file), and is assumed to move like a linear axis: if the control takes the shorter way, state rotary_words = \"shorter\" in the set-up file, else \"linear\". Do not run the result if the sign of a word states the direction (WRAPPED_ROTARY of LinuxCNC, parameter 1008#1 of FANUC)"
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
    /// The note about the machine's error at the zero of a work offset; `None` if the error rounds to zero.
    pub(crate) fn off_at_zero(system: usize, off_mm: [f64; 3]) -> Option<Self> {
        #[expect(clippy::cast_possible_truncation, reason = "errors are at most some mm")]
        let tenths_um = off_mm.map(|mm| (1e4 * mm).round() as i64);
        (tenths_um != [0; 3]).then(|| Self::OffAtZero(name_of_offset(system), tenths_um))
    }
}

/// A note on a program.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct NcNote {
    /// Line of the first occurrence, from 1.
    pub line: usize,
    /// The note as one sentence, without its line number.
    pub text: String,
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

    /// Each note in words, ordered by line.
    #[must_use]
    pub fn in_words(&self) -> Vec<NcNote> {
        let notes = self.by_line().into_iter();
        notes.map(|(line, note)| NcNote { line, text: note.to_string() }).collect()
    }
}
