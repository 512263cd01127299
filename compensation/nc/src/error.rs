//! Why a program is not compensated.

use std::path::{Path, PathBuf};

use volcomp_model::vocabulary::{AxisName, Coordinate, Displacement};

/// Why a program is not compensated: the line, what was found, and what was expected.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NcError {
    /// A block that cannot be read.
    #[error("line {line}: {fault}")]
    Block {
        /// Counted from 1.
        line: usize,
        /// What is wrong with it.
        fault: Fault,
    },
    /// A code whose motion is not known.
    #[error(
        "line {line}: {code} is not known here: it may move an axis, so that the program cannot be compensated"
    )]
    UnknownCode {
        /// Counted from 1.
        line: usize,
        /// As it is written.
        code: String,
    },
    /// What a block asks for cannot be compensated.
    #[error("line {line}: {what}")]
    NotCompensated {
        /// Counted from 1.
        line: usize,
        /// What it asks for, and why not.
        what: String,
    },
    /// A value that only the machine knows.
    #[error(
        "line {line}: the value of {word} is only known at the machine, so that its motion cannot be compensated"
    )]
    OnlyAtMachine {
        /// Counted from 1.
        line: usize,
        /// The letter of the word.
        word: char,
    },
    /// A program in coordinates of the tool's centre point for a machine that cannot do that.
    #[error(
        "coordinates of the tool's centre point need a machine with X, Y and Z, with rotary axes, and with none of these between X, Y and Z"
    )]
    NoCentrePoint,
    /// The control of the set-up reads another language than that of the program.
    #[error(
        "control of the set-up file: found {control}, whose programs are in the language {expected}, but the program is read as {found}"
    )]
    OtherLanguage {
        /// The control.
        control: &'static str,
        /// Its language.
        expected: &'static str,
        /// That of the program.
        found: &'static str,
    },
    /// A line longer than [`LONGEST_LINE`](crate::LONGEST_LINE).
    #[error("line {line}: longer than {most} bytes; this is no NC program")]
    LongLine {
        /// Counted from 1.
        line: usize,
        /// The most that is taken.
        most: usize,
    },
    /// A byte that no NC program has.
    #[error("line {line}: byte {byte:#04x} at column {column}; this is no NC program")]
    Binary {
        /// Counted from 1.
        line: usize,
        /// Counted from 1.
        column: usize,
        /// The byte.
        byte: u8,
    },
    /// A corrected coordinate that the limit of the [`Job`](crate::Job) or the travel does not allow.
    #[error("line {line}: {violation}")]
    OutOfBounds {
        /// Counted from 1.
        line: usize,
        /// Which bound, and by how much.
        violation: BoundViolation,
    },
    /// The O-words do not fit together, or never end.
    #[error("line {line}: {what}")]
    Flow {
        /// Counted from 1.
        line: usize,
        /// What does not fit.
        what: String,
    },
    /// What is wrong is in a file with subroutines.
    #[error("{}: {error}", file.display())]
    InFile {
        /// The file.
        file: PathBuf,
        /// What is wrong in it.
        error: Box<NcError>,
    },
    /// The program or its correction cannot be read or written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The machine has no axis, or cannot be compiled.
    #[error(transparent)]
    Machine(#[from] volcomp_model::ModelError),
}

impl NcError {
    /// The same error in this file.
    pub(crate) fn in_file(self, file: &Path) -> Self {
        Self::InFile {
            file: file.to_owned(),
            error: Box::new(self),
        }
    }

    /// The same error at this line.
    pub(crate) fn at_line(mut self, number: usize) -> Self {
        match &mut self {
            Self::Block { line, .. }
            | Self::UnknownCode { line, .. }
            | Self::NotCompensated { line, .. }
            | Self::OnlyAtMachine { line, .. }
            | Self::LongLine { line, .. }
            | Self::Binary { line, .. }
            | Self::OutOfBounds { line, .. }
            | Self::Flow { line, .. } => *line = number,
            Self::NoCentrePoint
            | Self::OtherLanguage { .. }
            | Self::InFile { .. }
            | Self::Io(_)
            | Self::Machine(_) => {}
        }
        self
    }
}

/// What is wrong with a block.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// A character that begins nothing.
    #[error(
        "column {column}: found {found:?}, expected a word such as X12.5, a comment or the end of the line"
    )]
    Character {
        /// Counted from 1.
        column: usize,
        /// The character.
        found: char,
    },
    /// A word without a number.
    #[error("column {column}: expected a number, a parameter or an expression after {letter:?}")]
    NoNumber {
        /// Counted from 1.
        column: usize,
        /// The letter of the word.
        letter: char,
    },
    /// A comment that does not end in its line.
    #[error("column {column}: the comment that begins here does not end in its line")]
    OpenComment {
        /// Counted from 1.
        column: usize,
    },
    /// An expression that is none.
    #[error("column {column}: {what}")]
    Expression {
        /// Counted from 1.
        column: usize,
        /// What is wrong, and what was expected.
        what: &'static str,
    },
    /// A calculation without a result.
    #[error("column {column}: {what}")]
    Arithmetic {
        /// Counted from 1.
        column: usize,
        /// Which one.
        what: &'static str,
    },
    /// A named parameter that was never set.
    #[error("the parameter #<{name}> has no value here")]
    NoParameter {
        /// Its name.
        name: String,
    },
    /// A word that may move the axes by a rule that is not followed.
    #[error("column {column}: {found} is not followed: {why}")]
    NotFollowed {
        /// Counted from 1.
        column: usize,
        /// As it is written.
        found: String,
        /// What it does, or why it is not known.
        why: &'static str,
    },
    /// Coordinates with and without a decimal point, on a control where that is not the same.
    #[error(
        "column {column}: {word} has {} decimal point, unlike coordinates before it, and controls read a number without one as millimetres or as least increments: state which with without_point in the set-up file",
        if *.without_point { "no" } else { "a" }
    )]
    MixedPoints {
        /// Counted from 1.
        column: usize,
        /// As it is written.
        word: String,
        /// It has none.
        without_point: bool,
    },
    /// A letter twice in a block, or two codes of the same group.
    #[error("{found} stands beside {other} in one block, of which only one may")]
    Twice {
        /// The later word.
        found: String,
        /// The earlier word.
        other: String,
    },
}

/// A correction that no axis may get.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BoundViolation {
    /// A correction beyond the limit of the [`Job`](crate::Job).
    #[error(
        "the correction of {axis} is {found:.1}, expected at most {limit}: check the units in the machine file"
    )]
    BeyondLimit {
        /// The axis.
        axis: AxisName,
        /// The correction.
        found: Displacement,
        /// The limit of the job.
        limit: Displacement,
    },
    /// Corrections that move the tool beyond the limit of the [`Job`](crate::Job), on a machine whose rotary axes correct.
    #[error(
        "the corrections of all axes together move the tool by {found:.1}, expected at most {limit}: check the units in the machine file"
    )]
    ToolBeyondLimit {
        /// How far they move it.
        found: Displacement,
        /// The limit of the job.
        limit: Displacement,
    },
    /// A corrected coordinate outside the travel that the programmed one keeps.
    #[error(
        "the correction moves {axis} from {from} to {to} in machine coordinates, outside its travel of {} to {}",
        travel[0], travel[1]
    )]
    LeavesTravel {
        /// The axis.
        axis: AxisName,
        /// The programmed machine coordinate.
        from: Coordinate,
        /// The corrected machine coordinate.
        to: Coordinate,
        /// The ends of the travel that the machine file states.
        travel: [Coordinate; 2],
    },
}
