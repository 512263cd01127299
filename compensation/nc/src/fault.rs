//! Why a block cannot be read: without its line, which whoever reads the program knows.

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
