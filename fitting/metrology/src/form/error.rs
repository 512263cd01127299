//! The reasons why points are not evaluated.

use super::FeatureKind;

/// Why a feature cannot be found through points.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages say what most fields are")]
pub enum FormError {
    /// There are not more points than the feature has parameters, so that its form deviation would always be zero.
    #[error(
        "{feature}: found {found} different points, expected at least {expected}: with fewer every form deviation is zero"
    )]
    TooFew {
        feature: FeatureKind,
        /// The number of different points.
        found: usize,
        expected: usize,
    },
    /// A coordinate is no finite number, or larger than [`LARGEST_MM`](super::LARGEST_MM).
    #[error(
        "{feature}: point {number}: found {found} mm, expected finite coordinates of at most {} mm",
        super::LARGEST_MM
    )]
    Coordinate {
        feature: FeatureKind,
        /// The number of the point, from 1.
        number: usize,
        found: f64,
    },
    /// The points lie so that they do not determine the feature.
    #[error("{feature}: found {found}, expected {expected}")]
    NotDetermined {
        feature: FeatureKind,
        found: String,
        expected: &'static str,
    },
    /// No direction has this length.
    #[error(
        "datum axis: found the direction {i},{j},{k}, expected finite numbers that are not all zero"
    )]
    Direction { i: f64, j: f64, k: f64 },
}
