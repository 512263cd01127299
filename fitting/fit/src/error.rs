use thiserror::Error;
use volcomp_curve::CurveError;

/// Why readings cannot be fitted. `index` counts from 0.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum FitError {
    /// There are not as many readings as abscissae.
    #[error("found {readings} readings for {abscissae} abscissae: expected one for each")]
    Lengths {
        /// The number of abscissae that was found.
        abscissae: usize,
        /// The number of readings that was found.
        readings: usize,
    },
    /// A number is NaN or infinite.
    #[error("{what} {index} is {value}: expected a finite number")]
    NotFinite {
        /// The name of the quantity that the number is.
        what: &'static str,
        /// Place of the number in its list.
        index: usize,
        /// The number that was found.
        value: f64,
    },
    /// There are too few different targets.
    #[error("found {found} different targets: {purpose} needs at least {needed}")]
    TooFewTargets {
        /// The fit or the estimate that needs the targets.
        purpose: &'static str,
        /// Number of different targets found.
        found: usize,
        /// The number that is needed.
        needed: usize,
    },
    /// A thermal record has too few rows, or there are too few runs.
    #[error("found {found} {what}: {purpose} needs at least {needed}")]
    TooFew {
        /// What there is too little of: rows or runs.
        what: &'static str,
        /// The fit that needs them.
        purpose: &'static str,
        /// How many were found.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// A target lies outside the domain asked for.
    #[error("target {index} is {value}: expected it in the domain [{lower}, {upper}]")]
    OutsideDomain {
        /// Place of the number in its list.
        index: usize,
        /// The target that lies outside.
        value: f64,
        /// Lower end of the domain.
        lower: f64,
        /// Upper end of the domain.
        upper: f64,
    },
    /// The targets do not determine the coefficients.
    #[error(
        "the targets do not determine {coefficients} coefficients: expected a lower order, or targets spread over the domain"
    )]
    Undetermined {
        /// Number of coefficients asked for.
        coefficients: usize,
    },
    /// Written in powers of the argument, the polynomial would lose too many digits.
    #[error(
        "in powers of the argument the polynomial of order {order} over [{lower}, {upper}] is wrong by {error:e}: expected a lower order, a domain nearer to 0, or a Chebyshev series"
    )]
    PowersLoseDigits {
        /// The order of the polynomial.
        order: usize,
        /// Lower end of the domain.
        lower: f64,
        /// Upper end of the domain.
        upper: f64,
        /// Largest deviation found, in units of the readings.
        error: f64,
    },
    /// No order and support of moving least squares has enough nodes with a weight everywhere.
    #[error(
        "{targets} targets leave no order and support with enough nodes within the support everywhere: expected more, or more evenly spread, targets, or a smaller shape than {shape}"
    )]
    NoCandidate {
        /// The number of different targets that was found.
        targets: usize,
        /// The shape of the weight.
        shape: f64,
    },
    /// A parameter is not what it must be.
    #[error("{what} is {value}: expected {expected}")]
    Parameter {
        /// The name of the parameter.
        what: &'static str,
        /// The value that was found.
        value: f64,
        /// The values that are allowed, in words.
        expected: &'static str,
    },
    /// The curve refuses its parameters.
    #[error(transparent)]
    Curve(#[from] CurveError),
}
