//! What a user should know of a program that was compensated: each thing once, with the first line at which it was met.

use std::{collections::BTreeMap, fmt};

use crate::modal::name_of_offset;

/// Something that was met in a program.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Note {
    /// The tool with this number has no length in the set-up: zero was taken.
    NoToolLength(u32),
    /// A tool that has a name: its length was taken as zero.
    NamedTool,
    /// An arc gets the coordinate of an axis that is not of its plane.
    Superposed,
    /// A motion of this code passes on as it is.
    PassedOn(String),
    /// Splines of this code go with the correction that they begin with.
    GoesWhole(String),
    /// The place of G28.1 or G30.1 is not known, since the axes were not all named before.
    HomeUnknown,
    /// The machine has no axis of this letter: its words pass on as they are.
    NoAxis(char),
    /// A correction of this axis was left out, since the program does not name the axis before, and the set-up does not
    /// say where it stands.
    LeftOut(char),
    /// The coordinate of this axis is outside the travel.
    OutsideTravel(char),
    /// The radius of the tool is compensated: the contour is corrected.
    RadiusCompensated,
    /// An element of a contour is not split, though its correction bends along it.
    ContourWhole,
    /// A line gets longer than some controls take.
    LongLine,
    /// This work offset is not in the set-up: zero was taken.
    NoOffset(String),
    /// The place of G28 or G30 is not in the set-up: machine zero was taken.
    NoHome(&'static str),
    /// Axes are said to be somewhere (G92, G10 L20) that nobody knows where they are.
    NoStart,
    /// Behind a cycle it is not known in which plane the axis of its depth is.
    ReturnPlane(char),
    /// A command of the control passes on, which may move the axes.
    MayMove(String),
    /// Motions in machine coordinates pass on as they are.
    InMachine,
    /// A motion is not split, or not corrected, as it is not known where this axis stands.
    NotSplit(char),
    /// The play of an axis is not taken up before an arc.
    NotTakenUp,
    /// Blocks that the operator may have skipped.
    MayBeSkipped,
    /// How far the machine is off at the zero of a work offset, tenths of µm, in X, Y and Z.
    OffAtZero(String, [i64; 3]),
}

impl Note {
    /// `None` where the machine is off by nothing.
    pub(crate) fn off_at_zero(system: usize, off_mm: [f64; 3]) -> Option<Self> {
        #[expect(clippy::cast_possible_truncation, reason = "errors are mm at the most")]
        let tenths_um = off_mm.map(|mm| (1e4 * mm).round() as i64);
        (tenths_um != [0; 3]).then(|| Self::OffAtZero(name_of_offset(system), tenths_um))
    }
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoToolLength(tool) => write!(
                f,
                "the length of tool {tool} is not in the set-up: zero was taken"
            ),
            Self::NamedTool => write!(
                f,
                "the set-up has tools by their numbers only: the length of the tool that is taken here was taken as zero"
            ),
            Self::Superposed => write!(
                f,
                "arcs get a coordinate beside those of their plane (a straight motion on top of the arc), which older controls may not take"
            ),
            Self::PassedOn(code) => write!(f, "motions of {code} pass on without a correction"),
            Self::GoesWhole(code) => write!(
                f,
                "splines of {code} go as a whole, with the correction that they begin with"
            ),
            Self::HomeUnknown => write!(
                f,
                "the place that is stored here is not known, since the program has not named every axis before"
            ),
            Self::NoAxis(axis) => write!(
                f,
                "the machine has no axis {axis}: its words pass on as they are"
            ),
            Self::LeftOut(axis) => write!(
                f,
                "corrections of {axis} are left out until the program names that axis, since it is not known where it stands"
            ),
            Self::OutsideTravel(axis) => write!(
                f,
                "{axis} leaves its travel; beyond its ends the errors there are taken"
            ),
            Self::NoOffset(name) => {
                write!(f, "work offset {name} is not in the set-up: zero was taken")
            }
            Self::NoHome(code) => write!(
                f,
                "the place of {code} is not in the set-up ([home.{code}]): machine zero was taken"
            ),
            Self::NoStart => write!(
                f,
                "it is not known where the axes stand that get new coordinates here, so that their corrections are left out behind it: [start] of the set-up says it"
            ),
            Self::ReturnPlane(axis) => write!(
                f,
                "a cycle before G98 or G99: LinuxCNC leaves the tool in the plane R, FANUC controls where it began, so that corrections of {axis} are left out behind it until the program names that axis"
            ),
            Self::MayMove(name) => write!(
                f,
                "{name} passes on as it is: where the axes are counts as unknown after it, until the program names them"
            ),
            Self::InMachine => write!(
                f,
                "motions in machine coordinates (G53, G28, G30, SUPA, M91) pass on without a correction"
            ),
            Self::NotSplit(axis) => write!(
                f,
                "motions are not split, and arcs not corrected, while it is not known where {axis} stands"
            ),
            Self::LongLine => write!(
                f,
                "the corrected line is longer than 254 characters, which LinuxCNC and others refuse: move its comment to a line of its own"
            ),
            Self::NotTakenUp => write!(
                f,
                "play is taken up on the way of this arc, not before it, since the block also switches what coordinates or F mean (G15, G16, G93 to G95): write that code into a block before it"
            ),
            Self::MayBeSkipped => write!(
                f,
                "a block that may be skipped (/): where the axes stand that it moves counts as unknown behind it, until the program names them again"
            ),
            Self::ContourWhole => write!(
                f,
                "with the radius of the tool compensated (G41, G42) motions are not split, since a control may cut away parts that are shorter than that radius: the correction of this one bends between its ends by more than the tolerance"
            ),
            Self::RadiusCompensated => write!(
                f,
                "with the radius of the tool compensated (G41, G42) the contour is corrected, not the path of the tool's centre"
            ),
            Self::OffAtZero(offset, tenths_um) => {
                let [x, y, z] = tenths_um.map(|tenths| tenths as f64 / 10.0);
                write!(
                    f,
                    "at the zero of {offset} the machine is off by X {x:.1} Y {y:.1} Z {z:.1} µm: where that zero was probed without the correction, add this to {offset} at the control (not in the set-up); otherwise the whole part is offset by this amount"
                )
            }
        }
    }
}

/// Notes, each with the line at which it was met first, counted from 1.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notes(BTreeMap<Note, usize>);

impl Notes {
    pub(crate) fn add(&mut self, note: Note, line: usize) {
        self.0.entry(note).or_insert(line);
    }

    /// Each note and its line, by line.
    #[must_use]
    pub fn by_line(&self) -> Vec<(usize, &Note)> {
        let mut notes: Vec<_> = self.0.iter().map(|(note, line)| (*line, note)).collect();
        notes.sort();
        notes
    }
}
