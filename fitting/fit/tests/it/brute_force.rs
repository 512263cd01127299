//! Independent implementation of moving least squares, directly from the formula. The equations use powers of the
//! distance over the half width and rows weighted by the square roots of the weights, and are solved by singular value
//! decomposition. For the leave-one-out error, the equations are solved again without each target.

use nalgebra::{DMatrix, DVector};

/// Weight of a node at distance `d` (mm), for half width `h` (mm) and shape 3.
fn weight(d: f64, h: f64) -> f64 {
    let edge = (-9.0_f64).exp();
    let inside = (-(3.0 * d / h).powi(2)).exp() - edge;
    if d.abs() < h { inside / (1.0 - edge) } else { 0.0 }
}

/// Equations of the nodes whose weight at the position `at` is positive, and their right-hand sides.
fn rows(nodes: &[[f64; 2]], order: usize, h: f64, at: f64) -> (DMatrix<f64>, DVector<f64>) {
    let near: Vec<[f64; 2]> =
        nodes.iter().copied().filter(|n| weight(n[0] - at, h) > 0.0).collect();
    let root = |j: usize| weight(near[j][0] - at, h).sqrt();
    // The powers are of the distance over the half width, or over the range if the half width is larger.
    let unit = h.min(nodes[nodes.len() - 1][0] - nodes[0][0]);
    let matrix = DMatrix::from_fn(near.len(), order + 1, |j, k| {
        root(j) * ((near[j][0] - at) / unit).powf(k as f64)
    });
    let right = DVector::from_fn(near.len(), |j, _| root(j) * near[j][1]);
    (matrix, right)
}

pub(crate) fn value(nodes: &[[f64; 2]], order: usize, h: f64, at: f64) -> f64 {
    let (matrix, right) = rows(nodes, order, h, at);
    matrix.svd(true, true).solve(&right, 0.0).unwrap()[0]
}

/// At each node, the error of the curve through all other nodes with the same half width `h`.
pub(crate) fn left_out(nodes: &[[f64; 2]], order: usize, h: f64) -> Vec<f64> {
    let miss = |i: usize| {
        let mut others = nodes.to_vec();
        let [x, u] = others.remove(i);
        u - value(&others, order, h, x)
    };
    (0..nodes.len()).map(miss).collect()
}

/// Whether the nodes determine a curve of this order and half width at all positions: at least order + 2 nodes have a
/// positive weight, and the ratio of the singular values is at most 1e10. Checked on a fine grid and next to the
/// positions at which a node enters.
pub(crate) fn carried(nodes: &[[f64; 2]], order: usize, h: f64) -> bool {
    let (first, last) = (nodes[0][0], nodes[nodes.len() - 1][0]);
    let enters = nodes.iter().flat_map(|n| [n[0] - h, n[0] + h]);
    (0..=800)
        .map(|i| first + (last - first) * f64::from(i) / 800.0)
        .chain(enters.filter(|at| (first..=last).contains(at)))
        .all(|at| {
            let (matrix, _) = rows(nodes, order, h, at);
            if matrix.nrows() < order + 2 {
                return false;
            }
            let values = matrix.singular_values();
            values.min() / values.max() >= 1e-10
        })
}

/// Orders and supports that the automatic choice tries: a grid, and the published pair.
pub(crate) fn tried() -> Vec<(usize, f64)> {
    let grid = (1..=6).flat_map(|order| (3..=20).map(move |step| (order, f64::from(step) * 0.05)));
    grid.chain([(4, 1.0 / 3.0)]).collect()
}

/// A possible setting: order, support, largest residual (µm) and leave-one-out RMS (µm).
pub(crate) type Trial = (usize, f64, f64, f64);

pub(crate) fn scan(nodes: &[[f64; 2]]) -> Vec<Trial> {
    let range = nodes[nodes.len() - 1][0] - nodes[0][0];
    let carried = |&(order, support): &(usize, f64)| carried(nodes, order, support * range);
    let trial = |(order, support): (usize, f64)| {
        let h = support * range;
        let misses = nodes.iter().map(|n| n[1] - value(nodes, order, h, n[0]));
        let largest = misses.map(f64::abs).fold(0.0, f64::max);
        let squares: f64 = left_out(nodes, order, h).iter().map(|e| e * e).sum();
        (order, support, largest, (squares / nodes.len() as f64).sqrt())
    };
    tried().into_iter().filter(carried).map(trial).collect()
}

/// The setting with the smallest leave-one-out RMS among those that meet the required residual, or among all if none
/// meets it. If two settings are equal within rounding, the lower order is chosen, then the wider support. Also returns
/// whether any setting meets the requirement.
pub(crate) fn choice(trials: &[Trial], required: Option<f64>) -> (Trial, bool) {
    let meets = |t: &Trial| required.is_none_or(|required| t.2 <= required);
    let any = trials.iter().any(meets);
    let admitted: Vec<Trial> = trials.iter().copied().filter(|t| !any || meets(t)).collect();
    let least = admitted.iter().map(|t| t.3).fold(f64::INFINITY, f64::min);
    let ties = admitted.iter().filter(|t| t.3 <= least + 1e-8);
    let first = ties.min_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)));
    (*first.unwrap(), any)
}
