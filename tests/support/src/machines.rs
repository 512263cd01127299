//! Machine files for tests, as TOML texts.

/// A five-axis machine file with every kind of error curve.
pub const EVERY_CURVE: &str = include_str!("../data/every-curve.toml");

/// Start of a machine file: a gantry `w X' b Y Z t` with the travels of X, Y and Z in mm. Any table may follow, such as `[errors]`.
pub fn gantry(travel_mm: [[f64; 2]; 3]) -> String {
    let [x, y, z] = travel_mm;
    format!(
        "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = {x:?}\nY.travel = {y:?}\nZ.travel = {z:?}\n"
    )
}
