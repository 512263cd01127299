use thiserror::Error;

/// Why a curve cannot be built: what is wrong, what was found and what is expected.
///
/// `index` counts from 0. Callers that read files prefix the file and the key.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum CurveError {
    /// A number is NaN or infinite.
    #[error("{what} {index} is {value}: expected a finite number")]
    NotFinite {
        /// What the number is.
        what: &'static str,
        /// Where it stands.
        index: usize,
        /// The number found.
        value: f64,
    },
    /// Too few of something.
    #[error("found {found} {what}: expected at least {expected}")]
    TooFew {
        /// What there is too little of, in the plural.
        what: &'static str,
        /// How many were found.
        found: usize,
        /// How many are needed.
        expected: usize,
    },
    /// The domain is empty, reversed, or too wide for an `f64`.
    #[error(
        "domain [{lower}, {upper}]: expected a lower end below the upper end, a finite distance apart"
    )]
    Domain {
        /// The first end found.
        lower: f64,
        /// The second end found.
        upper: f64,
    },
    /// Abscissae do not increase.
    #[error("{what} {index} is {value}, after {previous}: expected strictly increasing values")]
    NotIncreasing {
        /// What the abscissae are.
        what: &'static str,
        /// Where the offending one stands.
        index: usize,
        /// The one before it.
        previous: f64,
        /// The one found.
        value: f64,
    },
    /// Knots decrease.
    #[error("knot {index} is {value}, after {previous}: expected non-decreasing knots")]
    KnotsDecrease {
        /// Where the offending knot stands.
        index: usize,
        /// The knot before it.
        previous: f64,
        /// The knot found.
        value: f64,
    },
    /// The number of knots does not belong to the number of coefficients.
    #[error(
        "found {found} knots for {coefficients} coefficients of degree {degree}: expected coefficients + degree + 1 = {expected}"
    )]
    KnotCount {
        /// Number of knots found.
        found: usize,
        /// Number of coefficients found.
        coefficients: usize,
        /// The degree.
        degree: usize,
        /// Number of knots expected.
        expected: usize,
    },
    /// A knot inside the domain is repeated so often that the spline would jump there.
    #[error(
        "knot {value} stands {found} times inside the domain, from index {index}: expected at most {degree} times for degree {degree}"
    )]
    KnotRepeated {
        /// Where the first of them stands.
        index: usize,
        /// The knot.
        value: f64,
        /// How often it stands there.
        found: usize,
        /// The degree.
        degree: usize,
    },
    /// A count is outside what the kind of curve allows.
    #[error("{what} is {found}: expected {lowest} to {highest}")]
    OutOfRange {
        /// What the count is.
        what: &'static str,
        /// The count found.
        found: usize,
        /// The least allowed.
        lowest: usize,
        /// The most allowed.
        highest: usize,
    },
    /// A Fourier series has a cosine coefficient without its sine coefficient.
    #[error(
        "found {found} Fourier coefficients: expected an odd number, a0 and then pairs of cosine and sine"
    )]
    UnpairedHarmonic {
        /// Number of coefficients found.
        found: usize,
    },
    /// A parameter is outside the interval it must lie in.
    #[error("{what} is {value}: expected {expected}")]
    Parameter {
        /// The parameter.
        what: &'static str,
        /// The value found.
        value: f64,
        /// The interval, in words.
        expected: &'static str,
    },
    /// The weights of a moving least-squares curve leave too few nodes somewhere.
    #[error(
        "support {support} gives fewer than {needed} of {nodes} nodes a positive weight at {at}: expected more than {required_support} for order {order}, or a lower order"
    )]
    SupportTooNarrow {
        /// The support found, as a fraction of the range.
        support: f64,
        /// The order.
        order: usize,
        /// How many nodes the order needs everywhere.
        needed: usize,
        /// How many nodes there are.
        nodes: usize,
        /// The abscissa at which the nodes are sparsest.
        at: f64,
        /// The support that must be exceeded.
        required_support: f64,
    },
    /// The number of rows of a grid is not its number of nodes along the first axis.
    #[error(
        "found {found} rows of values: expected {expected}, one for each node of the first axis"
    )]
    GridRows {
        /// Number of rows found.
        found: usize,
        /// Number of nodes along the first axis.
        expected: usize,
    },
    /// A row of a grid has not as many values as there are nodes along the second axis.
    #[error(
        "found {found} values in row {row}: expected {expected}, one for each node of the second axis"
    )]
    GridColumns {
        /// The row.
        row: usize,
        /// Number of values found.
        found: usize,
        /// Number of nodes along the second axis.
        expected: usize,
    },
    /// Both arguments of a grid are the same axis.
    #[error("both grid axes are coordinate {axis}: expected two different axes")]
    GridAxes {
        /// The coordinate named twice.
        axis: usize,
    },
}
