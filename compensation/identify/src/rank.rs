//! What can be told apart: which columns are independent, and in what combination the others are not.

use volcomp_kinematics::nalgebra::DMatrix;
use volcomp_sensitivity::Dependence;

/// A column whose part normal to those before it is smaller, for columns of unit length, is a combination of them. Coordinates
/// that a file states to some µm bend straight lines by 1e-6 and more, which tells nothing apart; and what so small a part
/// determined would have ten thousand times the uncertainty of what is whole.
const INDEPENDENT_ABOVE: f64 = 1e-4;
/// A column so much shorter than the longest is rounding.
const NOTHING_BELOW: f64 = 1e-12;

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
    /// The columns that are not kept, whose parameters are left at zero.
    pub(crate) fn left_at_zero(&self) -> impl Iterator<Item = usize> {
        self.null.iter().map(|null| null[0].0)
    }

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

/// Goes through the columns in order and keeps each that is independent of those kept before it.
pub(crate) fn independent(matrix: &DMatrix<f64>) -> Rank {
    let mut scaled = matrix.clone();
    let longest = (matrix.column_iter().map(|column| column.norm())).fold(0.0, f64::max);
    for mut column in scaled.column_iter_mut() {
        let length = column.norm();
        if length > NOTHING_BELOW * longest && length.is_finite() {
            column /= length;
        } else {
            column.fill(0.0);
        }
    }
    let dependence = Dependence::within(&scaled, INDEPENDENT_ABOVE);
    let mut rank = Rank {
        kept: dependence.kept,
        null: dependence.null,
        singular: [0.0; 2],
    };
    for combination in &mut rank.null {
        // The column itself, which comes last, is to come first and to count positive.
        let (place, own) = combination.pop().unwrap_or((0, 1.0));
        combination.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        combination.insert(0, (place, own));
        for (_, weight) in combination {
            *weight *= own.signum();
        }
    }
    rank.singular = ends(&scaled.select_columns(&rank.kept));
    rank
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
    use volcomp_kinematics::nalgebra::DVector;

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
