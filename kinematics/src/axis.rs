use nalgebra::Vector3;
use volcomp_vocabulary::AxisName;

/// Unit vector in MCS of an axis letter: the direction of motion of X Y Z U V W, the axis of rotation of A B C.
pub fn letter_direction(name: AxisName) -> Vector3<f64> {
    let mut direction = Vector3::zeros();
    direction[name.mcs_index()] = 1.0;
    direction
}
