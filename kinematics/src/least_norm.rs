//! The two small linear systems of a correction step: rotary axes from the tool-axis error (least norm), linear axes
//! from the position error. The exact correction and the compiled machine share them.

#![allow(
    clippy::inline_always,
    reason = "measured: the compiled machine's correction takes a few nanoseconds more with calls"
)]

use nalgebra::{Vector2, Vector3};

use crate::{correctors::INDEPENDENT_ABOVE, math::sqrt};

/// Singular value below which a direction of the tool axis is corrected only in part, about 1° from the singular pose.
/// A rotary correction is thus at most 1/0.02 = 50 times the tool-axis error.
pub const SINGULAR_BELOW: f64 = 0.02;

/// Singular value below which a direction of the tool axis is not corrected. Between this limit and [`SINGULAR_BELOW`],
/// the corrected part grows from 0 to 1, so that corrections do not jump when a rotary axis passes the limit or toggles
/// there by its last digit.
pub const LEFT_OUT_BELOW: f64 = 0.75 * SINGULAR_BELOW;

/// Singular value below which a pose is treated as nearly singular, about 6° from the singular pose. In the affected
/// direction a rotary correction is then more than 1/0.1 = 10 times the tool-axis error, or the direction is not
/// corrected.
pub const NEAR_SINGULAR_BELOW: f64 = 0.1;

/// A linear axis is left out at a pose if the component of its direction normal to the axes before it is below this
/// limit, because rotary axes can make linear axes parallel. The limit is half of [`INDEPENDENT_ABOVE`], so that axes
/// that were chosen at machine zero and keep their angles are never near it.
const DEGENERATE_BELOW: f64 = 0.5 * INDEPENDENT_ABOVE;

/// Two unit vectors that form a right-handed frame with `unit` as the third (Duff et al., Building an Orthonormal
/// Basis, Revisited, JCGT 6, 2017).
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

/// The matrix A·Aᵀ. The 2×n matrix A has one column for each rotary axis: the motion of the tool axis along its two
/// normals, rad per rad. The least-norm solution of A·x = m is Aᵀ·(A·Aᵀ)⁺·m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RotaryGram {
    a: f64,
    b: f64,
    c: f64,
}

impl RotaryGram {
    /// Adds the column of a rotary axis to A.
    #[inline(always)]
    pub fn add(&mut self, column: &Vector2<f64>) {
        self.a += column.x * column.x;
        self.b += column.x * column.y;
        self.c += column.y * column.y;
    }

    /// Half the difference of the diagonal elements, half the difference of the eigenvalues, and the two eigenvalues,
    /// the larger first.
    #[inline(always)]
    fn eigenvalues(&self) -> (f64, f64, [f64; 2]) {
        let half_difference = 0.5 * (self.a - self.c);
        let radius = sqrt(half_difference * half_difference + self.b * self.b);
        let larger = 0.5 * (self.a + self.c) + radius;
        // The determinant divided by the larger eigenvalue avoids cancellation in the smaller one.
        let smaller = if larger > 0.0 { (self.a * self.c - self.b * self.b) / larger } else { 0.0 };
        (half_difference, radius, [larger, smaller])
    }

    /// Number of directions of the tool axis, 0 to 2, that are corrected in part or wholly: those with a singular value
    /// of at least [`LEFT_OUT_BELOW`].
    #[inline(always)]
    pub fn rank(&self) -> usize {
        let (_, _, squares) = self.eigenvalues();
        let least = LEFT_OUT_BELOW * LEFT_OUT_BELOW;
        usize::from(squares[0] >= least) + usize::from(squares[1] >= least)
    }

    /// True if at least one direction of the tool axis is corrected only in part or not at all: the smaller singular
    /// value is below [`SINGULAR_BELOW`] or NaN.
    #[inline(always)]
    pub fn is_singular(&self) -> bool {
        let (_, _, [_, smaller]) = self.eigenvalues();
        smaller.is_nan() || smaller < SINGULAR_BELOW * SINGULAR_BELOW
    }

    /// The part of the tool-axis error `miss` that the rotary axes correct. Both are in rad, along the two normals of
    /// the tool axis.
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

    /// Whether the smaller singular value is below [`NEAR_SINGULAR_BELOW`] or NaN.
    #[inline(always)]
    pub fn is_near_singular(&self) -> bool {
        let (_, _, [_, smaller]) = self.eigenvalues();
        smaller.is_nan() || smaller < NEAR_SINGULAR_BELOW * NEAR_SINGULAR_BELOW
    }

    /// Returns (A·Aᵀ)⁺·`miss` in the first `rank` singular directions, and the length of the component of the tool-axis
    /// error `miss` in these directions, rad.
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
    /// Selects the linearly independent ones among the first `count` columns at a pose: a column that is nearly a
    /// linear combination of the previous columns is left out.
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

    /// Whether one of the first `count` columns is left out, or the columns are nearly dependent. A movement of an axis
    /// may then be more than 1/[`NEAR_SINGULAR_BELOW`] times the error.
    #[inline(always)]
    pub fn is_near_singular(&self, count: usize) -> bool {
        let kept = self.kept.iter().filter(|kept| **kept).count();
        let [first, second, third] = filled(&self.columns, self.kept);
        let volume = first.cross(&second).dot(&third).abs();
        kept < count.min(3) || volume.is_nan() || volume < NEAR_SINGULAR_BELOW
    }

    /// The columns at a nearby pose, with the selection of `self`. The set of correcting axes must not change within
    /// one correction.
    #[must_use]
    pub fn at(&self, columns: [Vector3<f64>; 3]) -> Self {
        Self { columns, kept: self.kept }
    }

    /// Movement of each linear axis, mm, whose sum along the columns is `error_mm`: exact for three columns, least
    /// squares for fewer. Columns that are left out get 0; a NaN error gives NaN.
    #[inline(always)]
    pub fn shares(&self, error_mm: &Vector3<f64>) -> [f64; 3] {
        self.solved().of(error_mm)
    }

    /// Precomputes the solution of [`LinearColumns::shares`] for these columns.
    #[inline(always)]
    pub fn solved(&self) -> LinearShares {
        let columns =
            if self.kept == [true; 3] { self.columns } else { filled(&self.columns, self.kept) };
        // Cramer's rule. Columns that are left out are replaced by directions normal to the others, so that the system
        // stays regular; their movements are not used.
        let [first, second, third] = columns;
        let normals = [second.cross(&third), third.cross(&first), first.cross(&second)];
        LinearShares { normals, per_volume: 1.0 / first.dot(&normals[0]), kept: self.kept }
    }

    /// Length of the sum of the columns times these shares, mm: the part of the error that the linear axes can correct.
    pub fn seen_mm(&self, shares: &[f64; 3]) -> f64 {
        let [x, y, z] = shares;
        let [first, second, third] = &self.columns;
        (first * *x + second * *y + third * *z).norm()
    }
}

/// Precomputed solution of [`LinearColumns::shares`] for constant columns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearShares {
    normals: [Vector3<f64>; 3],
    per_volume: f64,
    kept: [bool; 3],
}

impl LinearShares {
    /// The movements of the linear axes for an error; see [`LinearColumns::shares`].
    #[inline(always)]
    pub fn of(&self, error_mm: &Vector3<f64>) -> [f64; 3] {
        core::array::from_fn(|place| {
            if self.kept[place] { self.normals[place].dot(error_mm) * self.per_volume } else { 0.0 }
        })
    }
}

/// Which of the columns selected by `wanted` are linearly independent of the previous ones.
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

/// Replaces each column that is not kept by a unit vector normal to the other columns.
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

/// The unit vector normal to two vectors that are not parallel.
fn unit_cross(first: &Vector3<f64>, second: &Vector3<f64>) -> Vector3<f64> {
    first.cross(second).normalize()
}
