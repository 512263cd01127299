//! Separates a linear error that was measured on parallel lines into the error at the axis's own point, and the two
//! angular errors that contribute by Abbe's principle.

use nalgebra::{Matrix3, Vector3};

use crate::MetrologyError;

/// Deviations along the axis, measured on one line.
#[derive(Debug, Clone, PartialEq)]
pub struct ParallelLine {
    /// Offset of the line from the point at which the error is required, perpendicular to the axis, mm. The two values
    /// are along the second and the third axis in cyclic order, which are Y and Z for X, and Z and X for Y.
    pub offset_mm: [f64; 2],
    /// Deviation at each target, µm.
    pub deviations_um: Vec<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeparatedAngles {
    /// Linear error at the required point, µm.
    pub linear_um: f64,
    /// Angular errors about the second and the third axis, µrad. For X these are Y and Z.
    pub angles_urad: [f64; 2],
}

/// Separates linear and angular errors by least squares at each target. On a line with the offsets b along the second
/// axis and c along the third, the deviation is the linear error + ε_second·c − ε_third·b.
///
/// # Errors
/// Fewer than three lines, lines in one plane, different numbers of deviations, or numbers that are not finite.
pub fn separate_parallel_lines(
    lines: &[ParallelLine],
) -> Result<Vec<SeparatedAngles>, MetrologyError> {
    let refuse = |what: &str, found: String, expected: &str| {
        MetrologyError::readings("parallel lines", what, found, expected)
    };
    if lines.len() < 3 {
        let found = lines.len().to_string();
        return Err(refuse("lines", found, "at least three"));
    }
    let targets = lines[0].deviations_um.len();
    if let Some(other) = lines.iter().find(|l| l.deviations_um.len() != targets) {
        let found = format!("{} beside {targets}", other.deviations_um.len());
        return Err(refuse("targets", found, "the same on each line"));
    }
    let finite =
        |l: &ParallelLine| l.offset_mm.iter().chain(&l.deviations_um).all(|x| x.is_finite());
    if !lines.iter().all(finite) {
        return Err(refuse("numbers", "one that is not finite".into(), "finite numbers"));
    }
    // 1 mm times 1 µrad is 1e-3 µm.
    let row = |l: &ParallelLine| Vector3::new(1.0, l.offset_mm[1] * 1e-3, -l.offset_mm[0] * 1e-3);
    let normal: Matrix3<f64> = lines.iter().map(|l| row(l) * row(l).transpose()).sum();
    let singular = normal.singular_values();
    let in_one_plane = singular.min() <= 1e-12 * singular.max();
    let Some(inverse) = normal.try_inverse().filter(|_| !in_one_plane) else {
        return Err(refuse("lines", "all in one plane".into(), "three that are not in one plane"));
    };
    let at = |target: usize| {
        let sum: Vector3<f64> = lines.iter().map(|l| row(l) * l.deviations_um[target]).sum();
        let found = inverse * sum;
        SeparatedAngles { linear_um: found[0], angles_urad: [found[1], found[2]] }
    };
    Ok((0..targets).map(at).collect())
}
