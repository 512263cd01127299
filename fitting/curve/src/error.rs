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
        /// The name of the quantity that the number is.
        what: &'static str,
        /// Place of the number in its list.
        index: usize,
        /// The number that was found.
        value: f64,
    },
    /// There are too few coefficients, nodes or values.
    #[error("found {found} {what}: expected at least {expected}")]
    TooFew {
        /// The name of the things of which there are too few, in the plural.
        what: &'static str,
        /// The number that was found.
        found: usize,
        /// The number that is needed.
        expected: usize,
    },
    /// The domain is empty, reversed, or too wide for an `f64`.
    #[error(
        "domain [{lower}, {upper}]: expected a lower end below the upper end, a finite distance apart"
    )]
    Domain {
        /// The first end that was found.
        lower: f64,
        /// The second end that was found.
        upper: f64,
    },
    /// Abscissae must increase, and these do not.
    #[error("{what} {index} is {value}, after {previous}: expected strictly increasing values")]
    NotIncreasing {
        /// The name of the abscissae.
        what: &'static str,
        /// Where the offending one stands.
        index: usize,
        /// The abscissa before the offending one.
        previous: f64,
        /// The abscissa that was found.
        value: f64,
    },
    /// Knots of a spline must not decrease, and these do.
    #[error("knot {index} is {value}, after {previous}: expected non-decreasing knots")]
    KnotsDecrease {
        /// Where the offending knot stands.
        index: usize,
        /// The knot before the offending one.
        previous: f64,
        /// The knot that was found.
        value: f64,
    },
    /// The number of knots does not belong to the number of coefficients.
    #[error(
        "found {found} knots for {coefficients} coefficients of degree {degree}: expected coefficients + degree + 1 = {expected}"
    )]
    KnotCount {
        /// The number of knots that was found.
        found: usize,
        /// The number of coefficients that was found.
        coefficients: usize,
        /// The degree of the spline.
        degree: usize,
        /// The number of knots that is expected.
        expected: usize,
    },
    /// A knot inside the domain is repeated so often that the spline would jump there.
    #[error(
        "knot {value} stands {found} times inside the domain, from index {index}: expected at most {degree} times for degree {degree}"
    )]
    KnotRepeated {
        /// Where the first of them stands.
        index: usize,
        /// The knot that is repeated.
        value: f64,
        /// How often it stands there.
        found: usize,
        /// The degree of the spline.
        degree: usize,
    },
    /// A count is outside what the kind of curve allows.
    #[error("{what} is {found}: expected {lowest} to {highest}")]
    OutOfRange {
        /// The name of the count.
        what: &'static str,
        /// The count that was found.
        found: usize,
        /// The smallest count that is allowed.
        lowest: usize,
        /// The largest count that is allowed.
        highest: usize,
    },
    /// A Fourier series has a cosine coefficient without its sine coefficient.
    #[error(
        "found {found} Fourier coefficients: expected an odd number, a0 and then pairs of cosine and sine"
    )]
    UnpairedHarmonic {
        /// The number of coefficients that was found.
        found: usize,
    },
    /// A parameter is outside the interval it must lie in.
    #[error("{what} is {value}: expected {expected}")]
    Parameter {
        /// The name of the parameter.
        what: &'static str,
        /// The value that was found.
        value: f64,
        /// The interval it must lie in, in words.
        expected: &'static str,
    },
    /// The weights of a moving least-squares curve leave too few nodes somewhere.
    #[error(
        "support {support} gives fewer than {needed} of {nodes} nodes a positive weight at {at}: expected more than {required_support} for order {order}, or a lower order"
    )]
    SupportTooNarrow {
        /// The support found, as a fraction of the range.
        support: f64,
        /// The order of the local polynomial.
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
        /// The number of rows that was found.
        found: usize,
        /// Number of nodes along the first axis.
        expected: usize,
    },
    /// A row of a grid has not as many values as there are nodes along the second axis.
    #[error(
        "found {found} values in row {row}: expected {expected}, one for each node of the second axis"
    )]
    GridColumns {
        /// The row that is meant, from 0.
        row: usize,
        /// The number of values that was found.
        found: usize,
        /// Number of nodes along the second axis.
        expected: usize,
    },
    /// Both arguments of a grid are the same axis.
    #[error("both grid axes are coordinate {axis}: expected two different axes")]
    GridAxes {
        /// The coordinate that is named twice.
        axis: usize,
    },
}
