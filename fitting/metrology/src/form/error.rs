//! The reasons why points are not evaluated.

use super::FeatureKind;

/// Why a feature cannot be found through points.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FormError {
    /// There are not more points than the feature has parameters, so that its form deviation would always be zero.
    #[error(
        "{feature}: found {found} different points, expected at least {expected}: with fewer every form deviation is zero"
    )]
    TooFew {
        /// The feature that was asked for.
        feature: FeatureKind,
        /// The number of different points.
        found: usize,
        /// The smallest number that is evaluated.
        expected: usize,
    },
    /// A coordinate is no finite number, or larger than [`LARGEST_MM`](super::LARGEST_MM).
    #[error(
        "{feature}: point {number}: found {found} mm, expected finite coordinates of at most {} mm",
        super::LARGEST_MM
    )]
    Coordinate {
        /// The feature that was asked for.
        feature: FeatureKind,
        /// The number of the point, from 1.
        number: usize,
        /// The coordinate that was found.
        found: f64,
    },
    /// The points lie so that they do not determine the feature.
    #[error("{feature}: found {found}, expected {expected}")]
    NotDetermined {
        /// The feature that was asked for.
        feature: FeatureKind,
        /// How the points lie.
        found: String,
        /// How they should lie.
        expected: &'static str,
    },
    /// No direction has this length.
    #[error(
        "datum axis: found the direction {i},{j},{k}, expected finite numbers that are not all zero"
    )]
    Direction {
        /// Its first component.
        i: f64,
        /// Its second component.
        j: f64,
        /// Its third component.
        k: f64,
    },
}
