use thiserror::Error;

/// Reason why a curve cannot be built, with the invalid part, the found and the expected value.
///
/// `index` counts from 0. Callers that read files add the file and the key to the message.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum CurveError {
    #[error("{what} {index} is {value}: expected a finite number")]
    NotFinite { what: &'static str, index: usize, value: f64 },
    #[error("found {found} {what}: expected at least {expected}")]
    TooFew { what: &'static str, found: usize, expected: usize },
    #[error(
        "domain [{lower}, {upper}]: expected a lower end below the upper end, a finite distance apart"
    )]
    Domain { lower: f64, upper: f64 },
    #[error("{what} {index} is {value}, after {previous}: expected strictly increasing values")]
    NotIncreasing { what: &'static str, index: usize, previous: f64, value: f64 },
    #[error("knot {index} is {value}, after {previous}: expected non-decreasing knots")]
    KnotsDecrease { index: usize, previous: f64, value: f64 },
    #[error(
        "found {found} knots for {coefficients} coefficients of degree {degree}: expected coefficients + degree + 1 = {expected}"
    )]
    KnotCount {
        /// Number of knots.
        found: usize,
        coefficients: usize,
        degree: usize,
        expected: usize,
    },
    #[error(
        "knot {value} stands {found} times inside the domain, from index {index}: expected at most {degree} times for degree {degree}"
    )]
    KnotRepeated { index: usize, value: f64, found: usize, degree: usize },
    /// A degree or order is outside the range of this kind of curve.
    #[error("{what} is {found}: expected {lowest} to {highest}")]
    OutOfRange { what: &'static str, found: usize, lowest: usize, highest: usize },
    #[error(
        "found {found} Fourier coefficients: expected an odd number, a0 and then pairs of cosine and sine"
    )]
    UnpairedHarmonic {
        /// Number of coefficients.
        found: usize,
    },
    #[error("{what} is {value}: expected {expected}")]
    Parameter { what: &'static str, value: f64, expected: &'static str },
    #[error(
        "support {support} gives fewer than {needed} of {nodes} nodes a positive weight at {at}: expected more than {required_support} for order {order}, or a lower order"
    )]
    SupportTooNarrow {
        support: f64,
        order: usize,
        needed: usize,
        nodes: usize,
        at: f64,
        required_support: f64,
    },
    #[error(
        "found {found} rows of values: expected {expected}, one for each node of the first axis"
    )]
    GridRows {
        /// Number of rows.
        found: usize,
        expected: usize,
    },
    #[error(
        "found {found} values in row {row}: expected {expected}, one for each node of the second axis"
    )]
    GridColumns {
        /// Index of the row, from 0.
        row: usize,
        found: usize,
        expected: usize,
    },
    #[error("both grid axes are coordinate {axis}: expected two different axes")]
    GridAxes { axis: usize },
}
