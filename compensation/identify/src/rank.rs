//! What can be told apart: which columns are independent, and in what combination the others are not.

use volcomp_kinematics::nalgebra::{DMatrix, DVector};

/// A column whose part normal to those before it is smaller, for columns of unit length, is a combination of them.
const INDEPENDENT_ABOVE: f64 = 1e-7;
/// A column so much shorter than the longest is rounding.
const NOTHING_BELOW: f64 = 1e-12;
/// A part of a combination that is smaller than this of its largest is rounding.
const PART_ABOVE: f64 = 1e-6;

/// Which columns of a matrix are independent.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rank {
    /// The columns that are kept, rising: each is independent of those before it.
    pub(crate) kept: Vec<usize>,
    /// For every other column the combination that moves nothing: columns of unit length and their weights, of unit
    /// length together; the column itself first.
    pub(crate) null: Vec<Vec<(usize, f64)>>,
    /// The smallest and the largest singular value of the columns that are kept, scaled to unit length.
    singular: [f64; 2],
}

impl Rank {
    /// The smallest by the largest singular value of the columns scaled to unit length: 0 where some are left out.
    pub(crate) fn score(&self) -> f64 {
        if self.null.is_empty() {
            self.score_of_kept()
        } else {
            0.0
        }
    }

    /// The same of the columns that are kept.
    pub(crate) fn score_of_kept(&self) -> f64 {
        self.singular[0] / self.singular[1].max(f64::MIN_POSITIVE)
    }
}

/// Goes through the columns in order and keeps each that is independent of those kept before it (Gram–Schmidt, twice).
pub(crate) fn independent(matrix: &DMatrix<f64>) -> Rank {
    let mut rank = Rank::default();
    let rows = matrix.nrows();
    let mut basis: Vec<DVector<f64>> = Vec::new();
    // The triangle of the kept columns: column = Σ triangle[k]·basis[k].
    let mut triangle: Vec<Vec<f64>> = Vec::new();
    let mut scaled = DMatrix::zeros(rows, matrix.ncols());
    let longest = matrix
        .column_iter()
        .map(|column| column.norm())
        .fold(0.0, f64::max);
    for (place, column) in matrix.column_iter().enumerate() {
        let length = column.norm();
        if !(length > NOTHING_BELOW * longest && length.is_finite()) {
            rank.null.push(vec![(place, 1.0)]);
            continue;
        }
        let unit: DVector<f64> = column / length;
        scaled.set_column(place, &unit);
        let mut rest = unit;
        let mut parts = vec![0.0; basis.len()];
        for _ in 0..2 {
            for (part, direction) in parts.iter_mut().zip(&basis) {
                let along = direction.dot(&rest);
                *part += along;
                rest.axpy(-along, direction, 1.0);
            }
        }
        let left = rest.norm();
        if left > INDEPENDENT_ABOVE {
            parts.push(left);
            triangle.push(parts);
            basis.push(rest / left);
            rank.kept.push(place);
        } else {
            rank.null
                .push(combination(place, &rank.kept, &triangle, parts));
        }
    }
    rank.singular = ends(&scaled.select_columns(&rank.kept));
    rank
}

/// The column minus the combination of kept ones that it is.
fn combination(
    place: usize,
    kept: &[usize],
    triangle: &[Vec<f64>],
    mut parts: Vec<f64>,
) -> Vec<(usize, f64)> {
    let mut combination = vec![(place, 1.0)];
    for k in (0..kept.len()).rev() {
        let weight = parts[k] / triangle[k][k];
        for (part, along) in parts.iter_mut().zip(&triangle[k][..k]) {
            *part -= weight * along;
        }
        combination.push((kept[k], -weight));
    }
    let largest = combination.iter().fold(0.0_f64, |m, (_, w)| m.max(w.abs()));
    combination.retain(|(_, weight)| weight.abs() > PART_ABOVE * largest);
    let length = combination.iter().map(|(_, w)| w * w).sum::<f64>().sqrt();
    for (_, weight) in &mut combination {
        *weight /= length;
    }
    combination[1..].sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    combination
}

/// The smallest and the largest singular value.
fn ends(matrix: &DMatrix<f64>) -> [f64; 2] {
    if matrix.is_empty() {
        return [0.0; 2];
    }
    // The triangle has the same singular values and is smaller.
    let square = if matrix.nrows() > matrix.ncols() {
        matrix.clone().qr().r()
    } else {
        matrix.clone()
    };
    let values = square.singular_values();
    [values.min(), values.max()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_combination_is_named_with_its_weights() {
        let a = [1.0, 0.0, 0.0, 2.0];
        let b = [0.0, 3.0, 0.0, 1.0];
        let sum: Vec<f64> = a.iter().zip(b).map(|(a, b)| 2.0 * a - b).collect();
        let columns = [a.to_vec(), b.to_vec(), sum.clone(), vec![0.0; 4]].concat();
        let matrix = DMatrix::from_vec(4, 4, columns);
        let rank = independent(&matrix);
        assert_eq!(rank.kept, [0, 1]);
        assert_eq!(rank.null.len(), 2);
        assert_eq!(rank.null[1], [(3, 1.0)]);
        assert_eq!(rank.score(), 0.0);
        // Two columns of unit length with the scalar product c have the singular values √(1 ± c): c = 2/√(5·10).
        let c = 2.0 / 50.0_f64.sqrt();
        let expected = ((1.0 - c) / (1.0 + c)).sqrt();
        assert!((rank.score_of_kept() - expected).abs() < 1e-14);
        let null = &rank.null[0];
        assert_eq!(null.len(), 3);
        let mut total = DVector::zeros(4);
        for &(column, weight) in null {
            total += matrix.column(column).normalize() * weight;
        }
        assert!(total.norm() < 1e-14, "{total}");
        let length: f64 = null.iter().map(|(_, w)| w * w).sum();
        assert!((length - 1.0).abs() < 1e-14);
    }

    #[test]
    fn the_score_of_orthogonal_columns_is_one() {
        let matrix = DMatrix::from_row_slice(3, 2, &[5.0, 0.0, 0.0, 0.1, 0.0, 0.0]);
        let rank = independent(&matrix);
        assert_eq!(rank.kept, [0, 1]);
        assert!((rank.score() - 1.0).abs() < 1e-14);
        assert_eq!(rank.score(), rank.score_of_kept());
    }
}
