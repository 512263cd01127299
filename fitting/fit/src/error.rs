use thiserror::Error;
use volcomp_curve::CurveError;

/// Reason why readings cannot be fitted. Each `index` counts from 0.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum FitError {
    #[error("found {readings} readings for {abscissae} abscissae: expected one for each")]
    Lengths {
        /// Number of abscissae.
        abscissae: usize,
        readings: usize,
    },
    #[error("{what} {index} is {value}: expected a finite number")]
    NotFinite { what: &'static str, index: usize, value: f64 },
    #[error("found {found} different targets: {purpose} needs at least {needed}")]
    TooFewTargets { purpose: &'static str, found: usize, needed: usize },
    #[error("found {found} {what}: {purpose} needs at least {needed}")]
    TooFew { what: &'static str, purpose: &'static str, found: usize, needed: usize },
    #[error("target {index} is {value}: expected it in the domain [{lower}, {upper}]")]
    OutsideDomain { index: usize, value: f64, lower: f64, upper: f64 },
    #[error(
        "the targets do not determine {coefficients} coefficients: expected a lower order, or targets spread over the domain"
    )]
    Undetermined { coefficients: usize },
    #[error(
        "in powers of the argument the polynomial of order {order} over [{lower}, {upper}] is wrong by {error:e}: expected a lower order, a domain nearer to 0, or a Chebyshev series"
    )]
    PowersLoseDigits {
        order: usize,
        lower: f64,
        upper: f64,
        /// Largest deviation, in the unit of the readings.
        error: f64,
    },
    #[error(
        "{targets} targets leave no order and support with enough nodes within the support everywhere: expected more, or more evenly spread, targets, or a smaller shape than {shape}"
    )]
    NoCandidate {
        /// Number of different targets.
        targets: usize,
        shape: f64,
    },
    #[error("{what} is {value}: expected {expected}")]
    Parameter { what: &'static str, value: f64, expected: &'static str },
    /// The curve rejects its parameters.
    #[error(transparent)]
    Curve(#[from] CurveError),
}
