use nalgebra::Vector3;
use volcomp_vocabulary::AxisName;

/// The unit direction of an axis letter in MCS: along it for X Y Z U V W, about it for A B C.
pub fn letter_direction(name: AxisName) -> Vector3<f64> {
    let mut direction = Vector3::zeros();
    direction[name.mcs_index()] = 1.0;
    direction
}
