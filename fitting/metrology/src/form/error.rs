use super::FeatureKind;

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FormError {
    #[error(
        "{feature}: found {found} different points, expected at least {expected}: with fewer every form deviation is zero"
    )]
    TooFew {
        feature: FeatureKind,
        /// Number of distinct points.
        found: usize,
        expected: usize,
    },
    #[error(
        "{feature}: point {number}: found {found} mm, expected finite coordinates of at most {} mm",
        super::LARGEST_MM
    )]
    Coordinate {
        feature: FeatureKind,
        /// Number of the point, from 1.
        number: usize,
        found: f64,
    },
    /// The arrangement of the points does not determine the feature.
    #[error("{feature}: found {found}, expected {expected}")]
    NotDetermined { feature: FeatureKind, found: String, expected: &'static str },
    #[error(
        "datum axis: found the direction {i},{j},{k}, expected finite numbers that are not all zero"
    )]
    Direction { i: f64, j: f64, k: f64 },
}
