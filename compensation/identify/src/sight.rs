//! Whether a line of sight goes along the places of its rows, or across them.

use volcomp_kinematics::nalgebra::{Matrix3, Vector3};
use volcomp_model::Machine;

use crate::observations::Row;

/// A line of sight further than this from along and from across the rows is neither, deg.
const ALIGNED_DEG: f64 = 1.0;
/// Places whose spread across is more than this part of that along lie on no line.
const STRAIGHT: f64 = 1e-3;
/// Places that spread less say nothing of a direction, mm.
const LEAST_SPREAD_MM: f64 = 1.0;

/// What is odd about a line of sight: rows on a line that it neither goes along (positioning) nor across (straightness).
pub(crate) fn oblique(rows: &[Row], direction: &Vector3<f64>, machine: &Machine) -> Option<String> {
    let tips: Vec<Vector3<f64>> = rows
        .iter()
        .map(|row| row.stand.ideal_tip_mm(machine.chain()))
        .collect();
    let count = tips.len() as f64;
    let middle = tips.iter().sum::<Vector3<f64>>() / count;
    let squares: Matrix3<f64> = tips
        .iter()
        .map(|tip| (tip - middle) * (tip - middle).transpose())
        .sum();
    let found = (squares / count).symmetric_eigen();
    let spread = found.eigenvalues.map(|square| square.max(0.0).sqrt());
    let longest = spread.imax();
    let across = spread.norm_squared() - spread[longest].powi(2);
    let is_straight = across.max(0.0).sqrt() <= STRAIGHT * spread[longest];
    if !(is_straight && spread[longest] > LEAST_SPREAD_MM) {
        return None;
    }
    let along: Vector3<f64> = found.eigenvectors.column(longest).into();
    let angle_deg = along.dot(direction).abs().min(1.0).acos().to_degrees();
    if angle_deg <= ALIGNED_DEG || angle_deg >= 90.0 - ALIGNED_DEG {
        return None;
    }
    let along = along * along.dot(direction).signum();
    // Rounded first, so that no zero has a sign.
    let [x, y, z] = along
        .map(|x| format!("{:.3}", (x * 1e3).round() / 1e3 + 0.0))
        .into();
    Some(format!(
        "the rows run along [{x}, {y}, {z}] in workpiece axes, {angle_deg:.1} deg from this direction: expected a line of sight along them, or across them for a straightness"
    ))
}
