//! Rank of a matrix: independent columns, and the null combinations that make the other columns dependent.
//!
//! The triangular factor and its inverse are computed in blocks, so that nearly all of the work is matrix products.

use volcomp_kinematics::nalgebra::{DMatrix, DVector, RowDVector};

/// Number of columns in a block. Within a block, the columns are reflected one by one.
const BLOCK: usize = 16;

/// Upper triangular R with RᵀR = AᵀA, with one row for each column of A; zero rows are added to a matrix with fewer
/// rows.
///
/// Block Gram–Schmidt, with Householder reflections within a block: every block is removed from the columns after it by
/// an orthogonal projection, also if the block is rank-deficient. R is therefore as accurate as the factor from
/// Householder reflections (Å. Björck, C. C. Paige, SIAM Journal on Matrix Analysis and Applications 13, 1992). Q is
/// never formed; to get Qᵀb, append b to A as another column.
pub(crate) fn triangle(matrix: DMatrix<f64>) -> DMatrix<f64> {
    let count = matrix.ncols();
    let rows = matrix.nrows().max(count);
    let mut left = matrix.resize_vertically(rows, 0.0);
    let mut triangle = DMatrix::zeros(count, count);
    for from in (0..count).step_by(BLOCK) {
        let to = count.min(from + BLOCK);
        let size = to - from;
        let (block, mut others) = left.columns_range_pair_mut(from..to, to..);
        let (q, r) = block.clone_owned().qr().unpack();
        let along = q.transpose() * &others;
        others.gemm(-1.0, &q, &along, 1.0);
        triangle.view_mut((from, from), (size, size)).copy_from(&r);
        let beside = (size, count - to);
        triangle.view_mut((from, to), beside).copy_from(&along);
    }
    triangle
}

/// Inverse of an upper triangular matrix; `None` if its diagonal has a zero.
pub(crate) fn inverse(triangle: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let count = triangle.ncols();
    if count <= BLOCK {
        return triangle.solve_upper_triangular(&DMatrix::identity(count, count));
    }
    let half = count / 2;
    let rest = count - half;
    let first = inverse(&triangle.view((0, 0), (half, half)).into_owned())?;
    let last = inverse(&triangle.view((half, half), (rest, rest)).into_owned())?;
    let corner = &first * triangle.view((0, half), (half, rest)) * &last;
    let mut inverse = DMatrix::zeros(count, count);
    inverse.view_mut((0, 0), (half, half)).copy_from(&first);
    inverse.view_mut((half, half), (rest, rest)).copy_from(&last);
    inverse.view_mut((0, half), (half, rest)).copy_from(&-corner);
    Some(inverse)
}

/// Minimum length of an independent combination of unit-length columns, with weights of unit length. Coordinates that a
/// file states to some µm bend straight lines by 1e-6 and more, and such bends must not distinguish unknowns. An
/// unknown determined by so short a combination would have ten thousand times the uncertainty of an unknown with full
/// effect.
const INDEPENDENT_ABOVE: f64 = 1e-4;
/// A column shorter than this share of the longest is treated as rounding error.
const ZERO_BELOW: f64 = 1e-12;
/// Minimum share of a column, relative to the largest share in a combination without effect, for the column to be fixed
/// at zero. Fixing a column at zero changes the other columns in inverse proportion to its share.
pub(crate) const LEAST_SHARE: f64 = 0.05;
/// Shares in a combination below this value, relative to the largest share, are treated as rounding errors.
const ROUNDING: f64 = 1e-7;

#[derive(Clone, Debug, Default)]
pub(crate) struct Rank {
    /// Indices of the kept columns, ascending.
    pub(crate) kept: Vec<usize>,
    /// For each column that is not kept, a combination without effect, or with less effect than noise: indices and
    /// weights of unit-length columns. The weights form a vector of unit length; the column itself is first.
    pub(crate) null: Vec<Vec<(usize, f64)>>,
    /// Length of every column; 0 if it is treated as rounding error.
    pub(crate) lengths: Vec<f64>,
    /// Smallest and largest singular value of the kept columns, scaled to unit length.
    singular: [f64; 2],
}

impl Rank {
    /// Columns that are not kept; their parameters are fixed at zero.
    pub(crate) fn left_at_zero(&self) -> impl Iterator<Item = usize> {
        self.null.iter().map(|null| null[0].0)
    }

    /// Ratio of the smallest to the largest singular value of the columns, scaled to unit length; 0 if columns are left
    /// out.
    pub(crate) fn score(&self) -> f64 {
        if self.null.is_empty() { self.score_of_kept() } else { 0.0 }
    }

    /// Whether the kept columns stay independent if only this share of the squared length of each of their combinations
    /// remains.
    pub(crate) fn is_independent_with(&self, share: f64) -> bool {
        self.singular[0] * share.sqrt() > INDEPENDENT_ABOVE
    }

    pub(crate) fn score_of_kept(&self) -> f64 {
        self.singular[0] / self.singular[1].max(f64::MIN_POSITIVE)
    }
}

/// Finds the combinations of columns without effect. In each combination the last column with a share of at least
/// [`LEAST_SHARE`] is left out.
pub(crate) fn independent(matrix: &DMatrix<f64>) -> Rank {
    independent_without(matrix, &[])
}

/// Like [`independent`], with the columns `without` always left out.
pub(crate) fn independent_without(matrix: &DMatrix<f64>, without: &[usize]) -> Rank {
    if matrix.ncols() == 0 {
        return Rank::default();
    }
    let mut scaled = matrix.clone();
    let longest = (matrix.column_iter().map(|column| column.norm())).fold(0.0, f64::max);
    let mut lengths = Vec::with_capacity(matrix.ncols());
    for mut column in scaled.column_iter_mut() {
        let length = column.norm();
        if length > ZERO_BELOW * longest && length.is_finite() {
            column /= length;
            lengths.push(length);
        } else {
            column.fill(0.0);
            lengths.push(0.0);
        }
    }
    // The triangular factor has the same combinations and is smaller.
    let factor = triangle(scaled);
    let mut left = left_out(&factor);
    left.extend(without);
    left.sort_unstable();
    left.dedup();
    let kept: Vec<usize> =
        (0..matrix.ncols()).filter(|column| left.binary_search(column).is_err()).collect();
    let own = factor.select_columns(&kept);
    let ordered = triangle(factor.select_columns(&[&kept[..], &left].concat()));
    let r = ordered.view((0, 0), (kept.len(), kept.len()));
    let null = left.iter().enumerate().map(|(place, &column)| {
        let right = ordered.view((0, kept.len() + place), (kept.len(), 1));
        let weights = r.solve_upper_triangular(&right.column(0));
        combination(column, &kept, &weights.unwrap_or_else(|| DVector::zeros(kept.len())))
    });
    Rank { null: null.collect(), singular: ends(&own), lengths, kept }
}

/// Columns to leave out, ascending.
fn left_out(triangle: &DMatrix<f64>) -> Vec<usize> {
    // Eigenvalues are squares of lengths, so the limit is 1e-8, which is ten million times the rounding error of a
    // double.
    let eigen = (triangle.transpose() * triangle).symmetric_eigen();
    let nothing: Vec<RowDVector<f64>> = eigen
        .eigenvectors
        .column_iter()
        .zip(&eigen.eigenvalues)
        .filter(|(_, value)| **value <= INDEPENDENT_ABOVE * INDEPENDENT_ABOVE)
        .map(|(direction, _)| direction.transpose())
        .collect();
    let mut left = Vec::new();
    if nothing.is_empty() {
        return left;
    }
    let mut shares = DMatrix::from_rows(&nothing);
    for _ in 0..nothing.len() {
        let sizes: Vec<f64> = shares.column_iter().map(|share| share.norm()).collect();
        let largest = sizes.iter().copied().fold(0.0, f64::max);
        let is_fair = |size: &f64| *size >= LEAST_SHARE * largest;
        let Some(column) = sizes.iter().rposition(is_fair) else {
            break;
        };
        left.push(column);
        // The column is eliminated from the remaining combinations.
        let own = shares.column(column).normalize();
        let along = own.transpose() * &shares;
        shares -= own * along;
        shares.column_mut(column).fill(0.0);
    }
    left.sort_unstable();
    left
}

/// Combination of a column minus the kept columns with these weights, scaled to unit length, without weights that are
/// rounding errors: the column first, then the kept columns by descending absolute weight.
fn combination(column: usize, kept: &[usize], weights: &DVector<f64>) -> Vec<(usize, f64)> {
    let largest = weights.amax().max(1.0);
    let others = kept.iter().copied().zip(weights.iter().map(|weight| -weight));
    let mut others: Vec<(usize, f64)> =
        others.filter(|(_, weight)| weight.abs() > ROUNDING * largest).collect();
    others.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    others.insert(0, (column, 1.0));
    let length = others.iter().map(|(_, weight)| weight * weight).sum::<f64>();
    for (_, weight) in &mut others {
        *weight /= length.sqrt();
    }
    others
}

/// Scales columns to unit length; columns of zeros are unchanged.
pub(crate) fn of_unit_length(mut columns: DMatrix<f64>) -> DMatrix<f64> {
    for mut column in columns.column_iter_mut() {
        let length = column.norm();
        if length > 0.0 {
            column /= length;
        }
    }
    columns
}

/// Smallest and largest singular value; zeros for an empty matrix.
fn ends(matrix: &DMatrix<f64>) -> [f64; 2] {
    if matrix.is_empty() {
        return [0.0; 2];
    }
    let values = matrix.singular_values();
    [values.min(), values.max()]
}

#[cfg(test)]
mod tests {
    use volcomp_kinematics::nalgebra::DVector;

    use super::*;

    /// Columns of very different lengths with an independent part of relative size `share`. With a share of 0, each
    /// third column depends on others.
    fn matrix(rows: usize, columns: usize, share: f64) -> DMatrix<f64> {
        let number = |row: usize, column: usize| {
            let seed = (7919 * row + 104_729 * column) as f64;
            (43_758.545 * (12.9898 + seed).sin()).fract()
        };
        DMatrix::from_fn(rows, columns, |row, column| {
            let common = number(row, column / 3);
            common * (1 + column % 3) as f64 + share * number(row, 1000 + column)
        })
    }

    #[test]
    fn the_triangle_has_the_products_of_the_columns() {
        for (rows, columns) in [(200, 75), (75, 75), (40, 75), (9, 3), (5, 1), (4, 0)] {
            for share in [1.0, 1e-6, 0.0] {
                let mut matrix = matrix(rows, columns, share);
                if columns > 20 {
                    matrix.column_mut(2).fill(0.0);
                    matrix.column_mut(20).fill(0.0);
                }
                let found = triangle(matrix.clone());
                assert_eq!(found.shape(), (columns, columns));
                let missed = found.transpose() * &found - matrix.transpose() * &matrix;
                let largest = matrix.norm_squared();
                assert!(missed.norm() <= 1e-14 * largest, "{rows} {columns} {share}: {missed}");
                assert_eq!(found.clone(), found.upper_triangle());
            }
        }
    }

    /// R is accurate for nearly dependent columns, with which the normal equations would lose all digits.
    #[test]
    fn the_triangle_is_that_of_householder_reflections() {
        for share in [1.0, 1e-4, 1e-8] {
            let matrix = matrix(300, 60, share);
            let (found, expected) = (triangle(matrix.clone()), matrix.clone().qr().r());
            let missed = (&found - &expected).norm();
            assert!(missed < 1e-13 / share * expected.norm(), "{share}: {missed}");
            // Least squares with the right-hand side as the last column: the residual is orthogonal to the columns.
            let right = matrix.column_sum().map(|x| x + x.sin());
            let mut columns = matrix.clone().resize_horizontally(61, 0.0);
            columns.set_column(60, &right);
            let all = triangle(columns);
            let own = all.view((0, 0), (60, 60));
            let turned = all.column(60).rows(0, 60).into_owned();
            let solution = own.solve_upper_triangular(&turned).expect("no zero");
            let sizes = right.norm() + matrix.norm() * solution.norm();
            let along = (matrix.transpose() * (&right - &matrix * solution)).norm();
            assert!(along < 1e-13 * matrix.norm() * sizes, "{share}: {along}");
        }
    }

    #[test]
    fn the_inverse_times_the_triangle_is_one() {
        for count in [0, 1, 16, 17, 75] {
            let own = triangle(matrix(200, count, 1.0));
            let found = inverse(&own).expect("no zero");
            let missed = (found * own - DMatrix::identity(count, count)).norm();
            assert!(missed < 1e-11, "{count}: {missed}");
        }
        let mut singular = triangle(matrix(200, 40, 1.0));
        singular[(25, 25)] = 0.0;
        assert!(inverse(&singular).is_none());
    }

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
    fn a_column_with_an_effect_of_its_own_is_kept() {
        for slant in [1e-3, 1e-5, 1e-8] {
            // c = (a − b)/slant, so the combination a − b − slant·c has no effect.
            let a = DVector::from_vec(vec![1.0, 0.0, 0.0, slant]);
            let b = DVector::from_vec(vec![1.0, 0.0, 0.0, 0.0]);
            let c = DVector::from_vec(vec![0.0, 0.0, 0.0, 1.0]);
            let rank = independent(&DMatrix::from_columns(&[a, b, c]));
            assert_eq!(rank.kept, [0, 2], "{slant}");
            assert!((rank.score_of_kept() - 1.0).abs() < 2.0 * slant, "{slant}");
        }
    }
}
