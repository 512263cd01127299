//! One node of a map and its units in files.

use volcomp_kinematics::nalgebra::Vector3;

/// One node of the map: where it is, and the error of the tool there in workpiece axes, mm and rad.
#[derive(Clone, Copy)]
pub(super) struct Node {
    /// Coordinates along the axes of the grid, mm.
    pub(super) at_mm: [f64; 3],
    /// Where the tip is to be, in workpiece axes, mm.
    pub(super) tip_mm: Vector3<f64>,
    /// Position (mm) and rotation (rad) error.
    pub(super) error: [f64; 6],
    /// Standard uncertainty of the six, where it was asked for.
    pub(super) uncertainty: Option<[f64; 6]>,
}

impl Node {
    /// The error in the units of the files: three of position in µm, three of rotation in µrad.
    pub(super) fn in_file_units(&self) -> [f64; 6] {
        in_file_units(&self.error)
    }

    /// The standard uncertainty in the units of the files; zero where it was not asked for.
    pub(super) fn uncertainty_in_file_units(&self) -> [f64; 6] {
        in_file_units(&self.uncertainty.unwrap_or_default())
    }
}

/// Three lengths in mm and three angles in rad, as µm and µrad.
fn in_file_units(six: &[f64; 6]) -> [f64; 6] {
    let [x, y, z, a, b, c] = six;
    [x * 1e3, y * 1e3, z * 1e3, a * 1e6, b * 1e6, c * 1e6]
}
