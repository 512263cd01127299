//! The bound of every number in an input file.

/// The largest number that an input file may state, positive or negative. No quantity of a machine in mm, µm, µrad, °C, s
/// or Pa comes near it, and squares and sums of such numbers stay finite.
pub const LARGEST_NUMBER: f64 = 1e15;

/// The number, or what was expected instead.
pub(crate) fn bounded(number: Option<f64>) -> Result<f64, &'static str> {
    match number.filter(|number| number.is_finite()) {
        None => Err("a finite number"),
        Some(number) if number.abs() > LARGEST_NUMBER => Err("a number from -1e15 to 1e15"),
        Some(number) => Ok(number),
    }
}
