//! Abbe's principle: the contribution of angular errors to a linear error that is measured away from its functional
//! point.
//!
//! Measurements on parallel lines separate the two.

use nalgebra::{Matrix3, Vector3};

use crate::MetrologyError;

/// Side of the joint of the measured axis on which the measured point is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum Rides {
    /// The point moves with the carriage to which the error belongs. For an axis to the right of `b` in the structure
    /// this is the tool side, for an axis to the left of `b` the workpiece side.
    #[default]
    Carriage,
    /// The point is on the other side of the joint, so it does not move with the carriage.
    Other,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum CarriedSide {
    /// The tool. The axis is to the right of `b` in the structure.
    Tool,
    /// The workpiece. The axis is to the left of `b` in the structure.
    Workpiece,
}

impl CarriedSide {
    /// Sign σ: −1 for a tool-side axis, +1 for a workpiece-side axis.
    fn sign(self) -> f64 {
        match self {
            Self::Tool => -1.0,
            Self::Workpiece => 1.0,
        }
    }
}

/// Direction of the measured axis, and its coordinate at one target.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Travel {
    /// Side of the machine that the axis carries.
    pub side: CarriedSide,
    /// Unit vector u in the direction of the axis, in the MCS.
    pub direction_mcs: [f64; 3],
    /// Coordinate q of the axis, mm.
    pub position_mm: f64,
}

/// Lever from the point at which the errors of a linear axis are defined to the measured point, in mm along the MCS
/// axes.
///
/// `point_mcs` is the measured point m, with the measured axis at 0 and every other axis at its position in the test.
/// `carriage_point_mcs` is c̃, the `point` of the axis after the motion of the fixed axes between `b` and this axis.
/// The lever is m − c̃ for a point that moves with the carriage, and m + σ u q − c̃ otherwise.
pub fn lever_mm(
    point_mcs: [f64; 3],
    carriage_point_mcs: [f64; 3],
    rides: Rides,
    travel: Travel,
) -> [f64; 3] {
    let passed_mm = match rides {
        Rides::Carriage => 0.0,
        Rides::Other => travel.side.sign() * travel.position_mm,
    };
    std::array::from_fn(|i| {
        point_mcs[i] + travel.direction_mcs[i] * passed_mm - carriage_point_mcs[i]
    })
}

/// Contribution of the angular errors to the measured linear errors: δ_measured − δ = ε × lever, in µm along the MCS
/// axes.
///
/// `tilts_urad` is ε = (EAN, EBN, ECN) at the target, µrad. `lever_mm` is from the function [`lever_mm`].
pub fn abbe_um(tilts_urad: [f64; 3], lever_mm: [f64; 3]) -> [f64; 3] {
    const UM_PER_MM_URAD: f64 = 1e-3;
    let [a, b, c] = tilts_urad;
    let [x, y, z] = lever_mm;
    [b * z - c * y, c * x - a * z, a * y - b * x].map(|component| component * UM_PER_MM_URAD)
}

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
