//! Triangular factor of a matrix and its inverse, computed in blocks so that nearly all of the work is matrix products.

use volcomp_kinematics::nalgebra::DMatrix;

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

#[cfg(test)]
mod tests {
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
}
