use volcomp_vocabulary::AxisName;

/// Reasons why a sensitivity analysis is not possible.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SensitivityError {
    /// There is no pose, or more than the maximum number.
    #[error("found {} poses, expected 1 to {most}", found.map_or("too many".to_owned(), |n| n.to_string()))]
    Poses {
        /// Number of poses; `None` if it overflows.
        found: Option<usize>,
        /// Maximum number of poses.
        most: usize,
    },
    /// The list of errors is empty.
    #[error("found no error, expected at least one")]
    NoErrors,
    /// An error belongs to an axis that the chain lacks.
    #[error("{term}: the structure has no axis {axis}")]
    NoSuchAxis {
        /// Name of the error.
        term: String,
        /// The missing axis.
        axis: AxisName,
    },
    /// A pose or a chain contains a number that is not finite.
    #[error("found an effect that is no finite number, expected finite coordinates")]
    NotFinite,
}
