//! Bound of every number in an input file.

/// Maximum magnitude of a number in an input file. It is far above any quantity of a machine in mm, µm, µrad, °C, s or
/// Pa, and small enough for squares and sums to stay finite.
pub const LARGEST_NUMBER: f64 = 1e15;

/// Checks that a number is finite and within the bound. The error describes the expected range.
pub(crate) fn bounded(number: Option<f64>) -> Result<f64, &'static str> {
    match number.filter(|number| number.is_finite()) {
        None => Err("a finite number"),
        Some(number) if number.abs() > LARGEST_NUMBER => Err("a number from -1e15 to 1e15"),
        Some(number) => Ok(number),
    }
}
