use std::path::{Path, PathBuf};

use volcomp_model::vocabulary::{AxisName, Coordinate, Displacement};

/// Reason why a program cannot be compensated: line (counted from 1), found text, and expected
/// text.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NcError {
    #[error("line {line}: {fault}")]
    Block { line: usize, fault: Fault },
    #[error("line {line}: {what}")]
    NotCompensated { line: usize, what: String },
    #[error(
        "line {line}: the value of {word} is only known at the machine, so that its motion cannot be compensated"
    )]
    OnlyAtMachine { line: usize, word: char },
    #[error(
        "coordinates of the tool's centre point need a machine with X, Y and Z, whose directions are at right angles and right-handed, with rotary axes, and with none of these between X, Y and Z"
    )]
    NoCentrePoint,
    #[error(
        "control of the set-up file: found {control}, whose programs are in the language {expected}, but the program is read as {found}"
    )]
    OtherLanguage { control: &'static str, expected: &'static str, found: &'static str },
    #[error(
        "rotary_words of the set-up file: the program is read as {found}, whose words state the direction of a rotary axis (DC, M126): remove it"
    )]
    RotaryWords { found: &'static str },
    #[error("line {line}: longer than {most} bytes; this is no NC program")]
    LongLine { line: usize, most: usize },
    #[error("line {line}: byte 0x00 at column {column}; this is no NC program")]
    Binary { line: usize, column: usize },
    #[error("line {line}: {violation}")]
    OutOfBounds { line: usize, violation: BoundViolation },
    #[error("{}: {error}", file.display())]
    InFile { file: PathBuf, error: Box<NcError> },
    #[error(transparent)]
    Io(#[from] std::io::Error),
    #[error(transparent)]
    Machine(#[from] volcomp_model::ModelError),
}

impl NcError {
    pub(crate) fn not_compensated(line: usize, what: impl Into<String>) -> Self {
        Self::NotCompensated { line, what: what.into() }
    }

    pub(crate) fn in_file(self, file: &Path) -> Self {
        Self::InFile { file: file.to_owned(), error: Box::new(self) }
    }

    pub(crate) fn at_line(mut self, number: usize) -> Self {
        match &mut self {
            Self::Block { line, .. }
            | Self::NotCompensated { line, .. }
            | Self::OnlyAtMachine { line, .. }
            | Self::LongLine { line, .. }
            | Self::Binary { line, .. }
            | Self::OutOfBounds { line, .. } => *line = number,
            Self::NoCentrePoint
            | Self::OtherLanguage { .. }
            | Self::RotaryWords { .. }
            | Self::InFile { .. }
            | Self::Io(_)
            | Self::Machine(_) => {}
        }
        self
    }
}

/// A syntax or semantic fault of a block.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    #[error(
        "column {column}: found {found:?}, expected a word such as X12.5, a comment or the end of the line"
    )]
    Character { column: usize, found: char },
    #[error("column {column}: expected a number, a parameter or an expression after {letter:?}")]
    NoNumber { column: usize, letter: char },
    #[error("column {column}: {what}")]
    Expression { column: usize, what: &'static str },
    #[error("the parameter #<{name}> has no value here")]
    NoParameter { name: String },
    #[error("column {column}: {found} is not supported: {why}")]
    NotFollowed { column: usize, found: String, why: &'static str },
    #[error(
        "column {column}: {word} has {} decimal point, unlike coordinates before it, and controls read a number without one as millimetres or as least increments: state which with without_point in the set-up file",
        if *.without_point { "no" } else { "a" }
    )]
    MixedPoints { column: usize, word: String, without_point: bool },
    #[error("found {found} and {other} in one block, expected only one of them")]
    Twice { found: String, other: String },
}

/// A correction out of bounds.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BoundViolation {
    #[error(
        "the correction of {axis} is {found:.1}, expected at most {limit}: check the units in the machine file"
    )]
    BeyondLimit { axis: AxisName, found: Displacement, limit: Displacement },
    #[error(
        "the corrections of all axes together move the tool by {found:.1}, expected at most {limit}: check the units in the machine file"
    )]
    ToolBeyondLimit { found: Displacement, limit: Displacement },
    #[error(
        "the correction moves {axis} from {from} to {to} in machine coordinates, outside its travel of {} to {}",
        travel[0], travel[1]
    )]
    LeavesTravel { axis: AxisName, from: Coordinate, to: Coordinate, travel: [Coordinate; 2] },
}

/// Column of a fault in a line, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Column(pub(crate) usize);

impl Column {
    pub(crate) fn malformed(self, what: &'static str) -> Fault {
        Fault::Expression { column: self.0, what }
    }

    pub(crate) fn not_followed(self, found: &str, why: &'static str) -> Fault {
        Fault::NotFollowed { column: self.0, found: found.to_owned(), why }
    }

    pub(crate) fn no_number(self, letter: u8) -> Fault {
        Fault::NoNumber { column: self.0, letter: char::from(letter) }
    }

    pub(crate) fn character(self, found: u8) -> Fault {
        Fault::Character { column: self.0, found: char::from(found) }
    }
}

/// Reasons why words are not supported.
pub(crate) const UNKNOWN: &str = "it is unknown and may move an axis";
pub(crate) const OWN_RULE: &str = "its motions are not supported";
pub(crate) const FLOW: &str = "jumps and loops are not supported in this language";
