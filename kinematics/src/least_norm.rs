//! The two small linear systems of a correction step, shared by the exact correction and the compiled machine: rotary axes from the tool-axis
//! error with least norm, linear axes from the position error.

#![allow(
    clippy::inline_always,
    reason = "measured: the compiled machine's correction takes a few nanoseconds more with calls"
)]

use nalgebra::{Vector2, Vector3};

use crate::{correctors::INDEPENDENT_ABOVE, math::sqrt};

/// Singular value below which a direction of the tool axis is corrected only in part (about 1° from the singular pose); a rotary correction
/// is then at most 1/0.02 = 50 times the tool-axis error.
pub const SINGULAR_BELOW: f64 = 0.02;

/// Singular value below which a direction of the tool axis is not corrected. Between this and [`SINGULAR_BELOW`] the corrected part grows from
/// zero to one, so that another axis does not jump when a rotary axis passes the limit or its last digit toggles there.
pub const LEFT_OUT_BELOW: f64 = 0.75 * SINGULAR_BELOW;

/// Singular value below which a pose is treated as nearly singular (about 6° from singular): a rotary correction is then more than 1/0.1
/// = 10 times the tool-axis error along that direction, or left out.
pub const NEAR_SINGULAR_BELOW: f64 = 0.1;

/// A linear axis is left out at a pose if its part normal to the axes before it is below this: rotary axes between linear ones may make two
/// of them parallel. Half of [`INDEPENDENT_ABOVE`], so that axes chosen at machine zero that keep their angles are never at the limit.
const DEGENERATE_BELOW: f64 = 0.5 * INDEPENDENT_ABOVE;

/// Two unit vectors that form a right-handed frame with a unit vector as the third (Duff et al., Building an Orthonormal Basis, Revisited,
/// JCGT 6, 2017).
#[inline(always)]
pub fn normals(unit: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let sign = 1.0_f64.copysign(unit.z);
    let a = -1.0 / (sign + unit.z);
    let b = unit.x * unit.y * a;
    [
        Vector3::new(1.0 + sign * unit.x * unit.x * a, sign * b, -sign * unit.x),
        Vector3::new(b, sign + unit.y * unit.y * a, -unit.y),
    ]
}

/// A·Aᵀ of the 2×n matrix A with one column for each rotary axis: the motion of the tool axis along two directions normal to it, rad per rad.
/// The least-norm solution of A·x = m is Aᵀ·(A·Aᵀ)⁺·m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RotaryGram {
    a: f64,
    b: f64,
    c: f64,
}

impl RotaryGram {
    /// Adds the column of one rotary axis.
    #[inline(always)]
    pub fn add(&mut self, column: &Vector2<f64>) {
        self.a += column.x * column.x;
        self.b += column.x * column.y;
        self.c += column.y * column.y;
    }

    /// Half the difference of the diagonal, the radius of the eigenvalues about their mean, and the eigenvalues, larger first.
    #[inline(always)]
    fn eigenvalues(&self) -> (f64, f64, [f64; 2]) {
        let half_difference = 0.5 * (self.a - self.c);
        let radius = sqrt(half_difference * half_difference + self.b * self.b);
        let larger = 0.5 * (self.a + self.c) + radius;
        // Determinant divided by the larger one instead of the difference: avoids cancellation in the smaller one.
        let smaller = if larger > 0.0 { (self.a * self.c - self.b * self.b) / larger } else { 0.0 };
        (half_difference, radius, [larger, smaller])
    }

    /// Number of the two directions of the tool axis that are corrected, wholly or in part: those with a singular value of at least
    /// [`LEFT_OUT_BELOW`].
    #[inline(always)]
    pub fn rank(&self) -> usize {
        let (_, _, squares) = self.eigenvalues();
        let least = LEFT_OUT_BELOW * LEFT_OUT_BELOW;
        usize::from(squares[0] >= least) + usize::from(squares[1] >= least)
    }

    /// True if a direction of the tool axis is not wholly corrected: one of the two singular values is below [`SINGULAR_BELOW`], or NaN.
    #[inline(always)]
    pub fn is_singular(&self) -> bool {
        let (_, _, [_, smaller]) = self.eigenvalues();
        smaller.is_nan() || smaller < SINGULAR_BELOW * SINGULAR_BELOW
    }

    /// The part of the tool-axis error `miss` that is corrected; both in rad, along the two normals of the tool axis.
    #[inline(always)]
    pub fn corrected(&self, miss: &Vector2<f64>) -> Vector2<f64> {
        if !self.is_singular() {
            return *miss;
        }
        let (half_difference, radius, squares) = self.eigenvalues();
        let [first, second] = squares.map(|square| {
            let above = sqrt(square.max(0.0)) - LEFT_OUT_BELOW;
            (above / (SINGULAR_BELOW - LEFT_OUT_BELOW)).clamp(0.0, 1.0)
        });
        let vector = self.first_direction(half_difference, radius);
        let along = vector * vector.dot(miss);
        along * first + (miss - along) * second
    }

    #[inline(always)]
    fn first_direction(&self, half_difference: f64, radius: f64) -> Vector2<f64> {
        let candidate = if half_difference >= 0.0 {
            Vector2::new(radius + half_difference, self.b)
        } else {
            Vector2::new(self.b, radius - half_difference)
        };
        candidate.try_normalize(0.0).unwrap_or_else(Vector2::x)
    }

    /// True if one of the two singular values is below [`NEAR_SINGULAR_BELOW`], or NaN.
    #[inline(always)]
    pub fn is_near_singular(&self) -> bool {
        let (_, _, [_, smaller]) = self.eigenvalues();
        smaller.is_nan() || smaller < NEAR_SINGULAR_BELOW * NEAR_SINGULAR_BELOW
    }

    /// (A·Aᵀ)⁺·miss on the first `rank` singular directions, and the length (rad) of the part of the tool-axis error
    /// `miss` along them.
    #[inline(always)]
    pub fn solve(&self, rank: usize, miss: &Vector2<f64>) -> (Vector2<f64>, f64) {
        let determinant = self.a * self.c - self.b * self.b;
        if rank >= 2 && determinant > 0.0 {
            let solved =
                Vector2::new(self.c * miss.x - self.b * miss.y, self.a * miss.y - self.b * miss.x);
            return (solved / determinant, miss.norm());
        }
        let (half_difference, radius, [larger, _]) = self.eigenvalues();
        if rank == 0 || larger <= 0.0 {
            return (Vector2::zeros(), 0.0);
        }
        let vector = self.first_direction(half_difference, radius);
        let along = vector.dot(miss);
        (vector * (along / larger), along.abs())
    }
}

/// Derivatives of the tool tip with respect to each correcting linear axis: up to three unit vectors in workpiece axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearColumns {
    columns: [Vector3<f64>; 3],
    kept: [bool; 3],
}

impl LinearColumns {
    /// The first `count` columns at a pose. A column that is (nearly) a combination of the previous ones at this pose is left out.
    #[inline(always)]
    pub fn new(columns: [Vector3<f64>; 3], count: usize) -> Self {
        let mut kept = [count > 0, count > 1, count > 2];
        let cross = columns[0].cross(&columns[1]);
        let area = cross.norm();
        let volume = cross.dot(&columns[2]);
        let independent =
            kept[2] && area >= DEGENERATE_BELOW && volume.abs() >= DEGENERATE_BELOW * area;
        if !independent {
            kept = independent_of(&columns, kept);
        }
        Self { columns, kept }
    }

    /// True if one of the first `count` columns is left out, or is nearly a combination of the others: a share may then be more than
    /// 1/[`NEAR_SINGULAR_BELOW`] times the error.
    #[inline(always)]
    pub fn is_near_singular(&self, count: usize) -> bool {
        let kept = self.kept.iter().filter(|kept| **kept).count();
        let [first, second, third] = filled(&self.columns, self.kept);
        let volume = first.cross(&second).dot(&third).abs();
        kept < count.min(3) || volume.is_nan() || volume < NEAR_SINGULAR_BELOW
    }

    /// This selection of columns at a nearby pose: the set of correcting axes must not change within a step.
    #[must_use]
    pub fn at(&self, columns: [Vector3<f64>; 3]) -> Self {
        Self { columns, kept: self.kept }
    }

    /// Movement of each linear axis, mm, so that the sum along the columns is `error_mm`: exact with three columns, least squares with fewer.
    /// Columns that are left out get 0. NaN if the error is NaN.
    #[inline(always)]
    pub fn shares(&self, error_mm: &Vector3<f64>) -> [f64; 3] {
        self.solved().of(error_mm)
    }

    /// The precomputed solution for the shares of any error.
    #[inline(always)]
    pub fn solved(&self) -> LinearShares {
        let columns =
            if self.kept == [true; 3] { self.columns } else { filled(&self.columns, self.kept) };
        // Cramer's rule. Missing columns are filled with directions normal to the others, so that the system stays regular; their shares
        // are not applied.
        let [first, second, third] = columns;
        let normals = [second.cross(&third), third.cross(&first), first.cross(&second)];
        LinearShares { normals, per_volume: 1.0 / first.dot(&normals[0]), kept: self.kept }
    }

    /// Length of the sum of the columns times these shares, mm: the part of the error that the
    /// columns represent.
    pub fn seen_mm(&self, shares: &[f64; 3]) -> f64 {
        let [x, y, z] = shares;
        let [first, second, third] = &self.columns;
        (first * *x + second * *y + third * *z).norm()
    }
}

/// Precomputed solution for the shares of linear axes with constant directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearShares {
    normals: [Vector3<f64>; 3],
    per_volume: f64,
    kept: [bool; 3],
}

impl LinearShares {
    /// See [`LinearColumns::shares`].
    #[inline(always)]
    pub fn of(&self, error_mm: &Vector3<f64>) -> [f64; 3] {
        core::array::from_fn(|place| {
            if self.kept[place] { self.normals[place].dot(error_mm) * self.per_volume } else { 0.0 }
        })
    }
}

/// Which of the wanted columns are linearly independent of the previous ones.
fn independent_of(columns: &[Vector3<f64>; 3], wanted: [bool; 3]) -> [bool; 3] {
    let mut kept = [false; 3];
    let mut basis = [Vector3::zeros(); 3];
    for place in 0..3 {
        let mut normal = columns[place];
        for unit in &basis {
            normal -= unit * unit.dot(&normal);
        }
        let norm = normal.norm();
        // A NaN pose must give NaN shares, not zeros.
        if wanted[place] && (norm >= DEGENERATE_BELOW || norm.is_nan()) {
            kept[place] = true;
            basis[place] = normal / norm;
        }
    }
    kept
}

/// The kept columns; the others are replaced by unit vectors normal to them and to each other.
fn filled(columns: &[Vector3<f64>; 3], kept: [bool; 3]) -> [Vector3<f64>; 3] {
    match kept {
        [true, true, true] => *columns,
        [true, true, false] => [columns[0], columns[1], unit_cross(&columns[0], &columns[1])],
        [true, false, true] => [columns[0], unit_cross(&columns[2], &columns[0]), columns[2]],
        [false, true, true] => [unit_cross(&columns[1], &columns[2]), columns[1], columns[2]],
        [true, false, false] => {
            let [second, third] = normals(&columns[0]);
            [columns[0], second, third]
        }
        [false, true, false] => {
            let [third, first] = normals(&columns[1]);
            [first, columns[1], third]
        }
        [false, false, true] => {
            let [first, second] = normals(&columns[2]);
            [first, second, columns[2]]
        }
        [false, false, false] => [Vector3::x(), Vector3::y(), Vector3::z()],
    }
}

/// The unit vector normal to two that are not parallel.
fn unit_cross(first: &Vector3<f64>, second: &Vector3<f64>) -> Vector3<f64> {
    first.cross(second).normalize()
}
