//! Why nothing can be said of a chain and its errors.

use volcomp_vocabulary::AxisName;

/// Why nothing can be said.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SensitivityError {
    /// No pose, or more than are looked at.
    #[error("found {} poses, expected 1 to {most}", found.map_or("too many".to_owned(), |n| n.to_string()))]
    Poses {
        /// How many were given; `None` where they cannot be counted.
        found: Option<usize>,
        /// The largest number that is looked at.
        most: usize,
    },
    /// No error was named.
    #[error("found no error, expected at least one")]
    NoErrors,
    /// An error of an axis that the chain does not have.
    #[error("{term}: the structure has no axis {axis}")]
    NoSuchAxis {
        /// The error that was named.
        term: String,
        /// The axis that is missing.
        axis: AxisName,
    },
    /// A pose or a chain with a number that is not finite.
    #[error("found an effect that is no finite number, expected finite coordinates")]
    NotFinite,
}
