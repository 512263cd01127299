//! Start values of the search: frames, targets, spheres and points from the readings and the nominal machine.

use volcomp_kinematics::{
    Pose,
    nalgebra::{DMatrix, DVector, Matrix3, Vector3},
};

use crate::{
    error::IdentifyError,
    fit::design,
    observations::{Observations, Part, Row, RowReading},
    params::{Param, Values},
    rank::independent,
    solve::{Exactness, solve},
    system::{Rows, System},
};

/// Minimum number of rows from which targets and a general matrix for the frame are determined.
const MIN_ROWS_FOR_MATRIX: usize = 6;

pub(crate) fn start(
    system: &System,
    observations: &Observations,
    rows: &Rows,
) -> Result<Values, IdentifyError> {
    let mut values = system.start();
    points_of_spheres_and_bars(system, observations, rows, &mut values);
    let mut candidates = vec![values.clone()];
    frames(system, observations, rows, &mut candidates[0], false);
    let mut other = values;
    if frames(system, observations, rows, &mut other, true) {
        candidates.push(other);
    }
    let mut best: Option<(f64, Values)> = None;
    let mut failure = None;
    for candidate in candidates {
        match setup_only(system, observations, rows, candidate) {
            Ok((cost, values)) => {
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, values));
                }
            }
            Err(error) => failure = Some(error),
        }
    }
    match (best, failure) {
        (Some((_, values)), _) => Ok(values),
        (None, Some(error)) => Err(error),
        (None, None) => Err(IdentifyError::NothingToFit),
    }
}

fn setup_only(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: Values,
) -> Result<(f64, Values), IdentifyError> {
    let count = system.params.setup();
    let rank = independent(&design(system, rows, &values, count).jacobian);
    for null in &rank.null {
        let column = null[0].0;
        if let Param::SetUp { part: Part::Frame(frame), .. } = system.params.at(column) {
            let quantity = &observations.setup.frames[frame];
            let sees = |row: &&Row| matches!(row.reading, RowReading::Point { frame: of, .. } if of == frame);
            return Err(IdentifyError::Frame {
                frame: quantity.name.clone(),
                direction: system.name(column),
                rows: rows.iter().filter(sees).count(),
            });
        }
    }
    let values = solve(system, rows, values, &rank.kept, true, false, Exactness::Rough)?.values;
    let residuals = system.plain_residuals(rows, &values);
    Ok((residuals.iter().map(Vector3::norm).sum(), values))
}

/// Nominal tip of a row, mm in workpiece axes and without the offset of a target, and its rotation.
fn nominal(system: &System, row: &Row) -> (Vector3<f64>, Matrix3<f64>) {
    let chain = system.machine.chain();
    let rotation = chain.ideal_pose(&row.pose.state).rotation;
    (row.pose.ideal_tip_mm(chain), rotation)
}

/// Sets the frames without a start value: from the best-fit rigid transform (Kabsch), or, with `with_targets`, together
/// with the offsets of the targets from a linear system in a general matrix. Returns whether offsets of targets were
/// determined.
fn frames(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: &mut Values,
    with_targets: bool,
) -> bool {
    let mut is_other = false;
    for (place, quantity) in observations.setup.frames.iter().enumerate() {
        let seen: Vec<(&Row, Vector3<f64>, Option<usize>)> = rows
            .iter()
            .filter_map(|row| match &row.reading {
                RowReading::Point { frame, at_mm, target } if *frame == place => {
                    Some((row, *at_mm, *target))
                }
                _ => None,
            })
            .collect();
        if seen.is_empty() {
            continue;
        }
        if quantity.unknown && quantity.value.is_none() {
            if with_targets {
                is_other |= targets_by_matrix(system, observations, &seen, values);
            }
            let tips: Vec<Vector3<f64>> = seen
                .iter()
                .map(|(row, _, target)| {
                    let (tip, rotation) = nominal(system, row);
                    tip + target.map_or_else(Vector3::zeros, |t| rotation * values.points[t][0])
                })
                .collect();
            let from: Vec<Vector3<f64>> = seen.iter().map(|(_, at, _)| *at).collect();
            values.frames[place].pose = kabsch(&from, &tips);
        }
        let pose = values.frames[place].pose;
        let middle = seen.iter().map(|(_, at, _)| pose.transform_point(at));
        values.frames[place].middle_mm = middle.sum::<Vector3<f64>>() / seen.len() as f64;
    }
    is_other
}

/// Solves for the targets' offsets o from M·y + t = tip + R·o, which is linear in the nine numbers of M, in t and in o.
fn targets_by_matrix(
    system: &System,
    observations: &Observations,
    seen: &[(&Row, Vector3<f64>, Option<usize>)],
    values: &mut Values,
) -> bool {
    let mut targets: Vec<usize> = seen.iter().filter_map(|(_, _, target)| *target).collect();
    targets.sort_unstable();
    targets.dedup();
    targets.retain(|&target| {
        let quantity = &observations.setup.points[target];
        quantity.unknown && quantity.value.is_none()
    });
    if targets.is_empty() || seen.len() < MIN_ROWS_FOR_MATRIX + targets.len() {
        return false;
    }
    let mut matrix = DMatrix::zeros(3 * seen.len(), 12 + 3 * targets.len());
    let mut right = DVector::zeros(3 * seen.len());
    for (place, (row, at, target)) in seen.iter().enumerate() {
        let (tip, rotation) = nominal(system, row);
        for k in 0..3 {
            for j in 0..3 {
                matrix[(3 * place + k, 3 * k + j)] = at[j];
            }
            matrix[(3 * place + k, 9 + k)] = 1.0;
            right[3 * place + k] = tip[k];
            if let Some(column) = targets.iter().position(|t| Some(*t) == *target) {
                for j in 0..3 {
                    matrix[(3 * place + k, 12 + 3 * column + j)] = -rotation[(k, j)];
                }
            }
        }
    }
    let Some(solution) = least_squares(matrix, &right) else {
        return false;
    };
    for (column, &target) in targets.iter().enumerate() {
        let first = 12 + 3 * column;
        let offset = Vector3::new(solution[first], solution[first + 1], solution[first + 2]);
        if offset.iter().any(|x| !x.is_finite()) {
            return false;
        }
        values.points[target][0] = offset;
    }
    true
}

/// Minimum-norm least-squares solution; singular values below 1e-9 of the largest count as zero.
fn least_squares(matrix: DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    const HARDLY: f64 = 1e-9;
    let svd = matrix.svd(true, true);
    let least = HARDLY * svd.singular_values.max();
    svd.solve(right, least).ok()
}

/// Least-squares rigid transform from the points `from` to the points `to`.
fn kabsch(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Pose {
    let middle =
        |points: &[Vector3<f64>]| points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let (a, b) = (middle(from), middle(to));
    let spread = from
        .iter()
        .zip(to)
        .fold(Matrix3::zeros(), |sum: Matrix3<f64>, (p, q)| sum + (q - b) * (p - a).transpose());
    let svd = spread.svd(true, true);
    let rotation = match (svd.u, svd.v_t) {
        (Some(u), Some(v)) => {
            let mirror = if (u * v).determinant() < 0.0 { -1.0 } else { 1.0 };
            u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirror)) * v
        }
        _ => Matrix3::identity(),
    };
    Pose { rotation, translation_mm: b - rotation * a }
}

fn points_of_spheres_and_bars(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: &mut Values,
) {
    for (place, quantity) in observations.setup.points.iter().enumerate() {
        if !quantity.unknown || quantity.value.is_some() {
            continue;
        }
        let mut centres = Vec::new();
        let mut reaches = Vec::new();
        let mut dead_of = None;
        for row in rows.iter() {
            match &row.reading {
                RowReading::Sphere { centre, offset_mm } if *centre == place => {
                    centres.push(nominal(system, row).0 - offset_mm);
                }
                RowReading::Distance { point, dead, length_mm } if *point == place => {
                    reaches.push((nominal(system, row).0, *length_mm));
                    dead_of = Some(*dead);
                }
                _ => {}
            }
        }
        if !centres.is_empty() {
            values.points[place][0] = centres.iter().sum::<Vector3<f64>>() / centres.len() as f64;
        }
        if let Some(dead) = dead_of {
            let number = &observations.setup.numbers[dead];
            let free = number.unknown && number.value.is_none();
            let (point, found) = trilateration(&reaches, values.numbers[dead][0], free);
            values.points[place][0] = point;
            if free {
                values.numbers[dead][0] = found;
            }
        }
    }
}

/// Point P and dead length d with |a − P| = L + d for each tip a and length L, from |a|² − L² = 2 a·P + 2 L·d − (|P|² −
/// d²), with a relative to the mean of all tips. If the tips lie in a plane, the solution has minimum norm. With `free`
/// d is unknown; otherwise d is `dead_mm`.
fn trilateration(reaches: &[(Vector3<f64>, f64)], dead_mm: f64, free: bool) -> (Vector3<f64>, f64) {
    let middle = reaches.iter().map(|(tip, _)| tip).sum::<Vector3<f64>>() / reaches.len() as f64;
    let unknowns = if free { 5 } else { 4 };
    let mut matrix = DMatrix::zeros(reaches.len(), unknowns);
    let mut right = DVector::zeros(reaches.len());
    for (row, (tip, length)) in reaches.iter().enumerate() {
        let a = tip - middle;
        let length = if free { *length } else { length + dead_mm };
        for k in 0..3 {
            matrix[(row, k)] = 2.0 * a[k];
        }
        matrix[(row, 3)] = -1.0;
        if free {
            matrix[(row, 4)] = 2.0 * length;
        }
        right[row] = a.norm_squared() - length * length;
    }
    match least_squares(matrix, &right) {
        Some(x) => {
            let point = Vector3::new(x[0], x[1], x[2]);
            // If the lengths hardly differ, the constant term absorbs the dead length.
            let dead = if free { x[4] } else { dead_mm };
            let mean = reaches.iter().map(|(tip, length)| (tip - middle - point).norm() - length);
            let mean = mean.sum::<f64>() / reaches.len() as f64;
            (middle + point, if free && (dead - mean).abs() > 1.0 { mean } else { dead })
        }
        None => (middle, dead_mm),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rank_deficient_least_squares_has_minimum_norm_in_any_unit() {
        for scale in [1e-9, 1.0, 1e9] {
            let matrix = DMatrix::from_fn(9, 3, |row, column| {
                let a = (1.3 * row as f64).sin() * scale;
                let b = (0.7 * row as f64 + 0.4).cos() * scale;
                [a, b, 0.1 * a + 0.7 * b][column]
            });
            // Minimum norm: orthogonal to the null space, (0.1, 0.7, −1).
            let expected = DVector::from_row_slice(&[7.0, -1.0, 0.0]);
            let right = &matrix * &expected;
            let found = least_squares(matrix, &right).expect("found");
            assert!((found - &expected).norm() < 1e-6, "{scale}");
        }
    }
}
