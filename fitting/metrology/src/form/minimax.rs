//! Linear minimax problem with three unknowns, by the dual simplex method on four contact points.

use nalgebra::{Matrix4, Vector3, Vector4};

/// Solution x of the minimax problem, which minimises the largest |b − A x|.
pub(super) struct Minimax {
    pub(super) x: Vector3<f64>,
    /// Largest |b − A x|.
    pub(super) largest: f64,
    /// Contact rows, each with the sign of b − A x and a weight. The weights are at least 0 and have the sum 1. The
    /// signed, weighted sum of the rows of A is zero, which proves that no other x is better.
    pub(super) contacts: [Contact; 4],
}

/// A row with the largest |b − A x|.
#[derive(Clone, Copy)]
pub(super) struct Contact {
    pub(super) row: usize,
    pub(super) sign: f64,
    pub(super) weight: f64,
}

/// Solves the problem; `None` if the rows determine fewer than three unknowns. Residuals that differ by at most
/// `rounding` count as equal.
///
/// Each exchange of a contact row increases the largest |b − A x| over the four contacts. The iteration ends when no
/// other row exceeds it.
pub(super) fn minimax(rows: &[Vector3<f64>], b: &[f64], rounding: f64) -> Option<Minimax> {
    let mut contacts = first_contacts(rows, b)?;
    // Exchanges without gain could cycle. Bland's rule prevents this after a number of exchanges.
    let patience = 100;
    for exchange in 0..1000 {
        let bland = exchange > patience;
        let matrix = Matrix4::from_fn(|k, column| {
            let Contact { row, sign, .. } = contacts[k];
            if column < 3 { rows[row][column] } else { sign }
        });
        let solver = matrix.lu();
        let solution = solver.solve(&Vector4::from_fn(|k, _| b[contacts[k].row]))?;
        let (x, largest) = (solution.xyz(), solution.w);
        let transposed = matrix.transpose().lu();
        let weights = transposed.solve(&Vector4::w())?;
        for (contact, weight) in contacts.iter_mut().zip(&weights) {
            contact.weight = contact.sign * weight;
        }
        let residual = |row: usize| b[row] - rows[row].dot(&x);
        let mut outside = (0..rows.len()).filter(|&row| residual(row).abs() > largest + rounding);
        let entering = if bland {
            outside.next()
        } else {
            outside.max_by(|&p, &q| residual(p).abs().total_cmp(&residual(q).abs()))
        };
        let Some(row) = entering else {
            return Some(Minimax { x, largest, contacts });
        };
        let sign = residual(row).signum();
        let column = (rows[row] * sign).push(1.0);
        let changes = transposed.solve(&column)?;
        let ratio = |k: usize| {
            let change = contacts[k].sign * changes[k];
            (change > 1e-12).then(|| contacts[k].weight.max(0.0) / change)
        };
        // The changes have the sum 1, so at least one of them is positive.
        let leaving =
            (0..4).filter_map(|k| ratio(k).map(|ratio| (k, ratio))).min_by(|(k, p), (l, q)| {
                p.total_cmp(q).then(contacts[*k].row.cmp(&contacts[*l].row))
            })?;
        contacts[leaving.0] = Contact { row, sign, weight: 0.0 };
    }
    None
}

/// Initial contacts: the three rows that determine the unknowns best, and the row with the largest residual of their
/// solution.
fn first_contacts(rows: &[Vector3<f64>], b: &[f64]) -> Option<[Contact; 4]> {
    let mut left: Vec<Vector3<f64>> = rows.to_vec();
    let mut chosen = [0; 3];
    for place in &mut chosen {
        let by_length =
            |&p: &usize, &q: &usize| left[p].norm_squared().total_cmp(&left[q].norm_squared());
        let pivot = (0..left.len()).max_by(by_length)?;
        let length = left[pivot].norm();
        if length < 1e-9 {
            return None;
        }
        let direction = left[pivot] / length;
        for row in &mut left {
            *row -= direction * direction.dot(row);
        }
        *place = pivot;
    }
    let of_three = nalgebra::Matrix3::from_fn(|k, column| rows[chosen[k]][column]);
    let x = of_three.lu().solve(&Vector3::from(chosen.map(|row| b[row])))?;
    let residual = |row: usize| b[row] - rows[row].dot(&x);
    let others = (0..rows.len()).filter(|row| !chosen.contains(row));
    let fourth = others.max_by(|&p, &q| residual(p).abs().total_cmp(&residual(q).abs()))?;
    // Express the fourth row as a combination of the other three. With the opposite signs, the signed sum of the four
    // rows is zero.
    let shares = of_three.transpose().lu().solve(&rows[fourth])?;
    let turn = if residual(fourth) < 0.0 { -1.0 } else { 1.0 };
    let contact = |row: usize, share: f64| Contact {
        row,
        sign: turn * if share < 0.0 { -1.0 } else { 1.0 },
        weight: 0.0,
    };
    Some([
        contact(chosen[0], -shares[0]),
        contact(chosen[1], -shares[1]),
        contact(chosen[2], -shares[2]),
        contact(fourth, 1.0),
    ])
}
