//! The best rigid motion of the workpiece: what of a set of error vectors is where the workpiece lies, and what is error.
//!
//! Where the workpiece zero is and how the workpiece is turned on the table is a convention (an operator probes it, a measuring machine
//! aligns it); what no such motion takes away is the error of form.

use volcomp_kinematics::nalgebra::{Matrix3, Vector3};

/// Squared ratio of how far points are off a line to how far they spread along it, below which the turn about that line cannot be told from
/// rounding: 10 µm in 100 m.
const UNSEEN: f64 = 1e-14;

/// State: sums over places and the error vectors there, from which the best rigid motion follows.
///
/// Places and errors are counted from their means, which are updated with each point (Welford), so that places far off zero lose no
/// digits; sums of parts are put together by [`merge`](Self::merge).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RigidSums {
    count: f64,
    place_mm: Vector3<f64>,
    error_mm: Vector3<f64>,
    /// Σ p pᵀ, p from the mean.
    places: Matrix3<f64>,
    /// Σ p eᵀ, both from their means.
    products: Matrix3<f64>,
    /// Σ |e|², from the mean.
    squares: f64,
}

impl RigidSums {
    /// Takes a place and the error vector there, both in workpiece axes, mm.
    pub fn take(&mut self, place_mm: &Vector3<f64>, error_mm: &Vector3<f64>) {
        self.merge(&Self {
            count: 1.0,
            place_mm: *place_mm,
            error_mm: *error_mm,
            ..Self::default()
        });
    }

    /// Takes the sums of other points.
    pub fn merge(&mut self, other: &Self) {
        let count = self.count + other.count;
        if count == 0.0 {
            return;
        }
        let (place, error) = (
            other.place_mm - self.place_mm,
            other.error_mm - self.error_mm,
        );
        let share = other.count / count;
        let both = self.count * share;
        self.places += other.places + place * place.transpose() * both;
        self.products += other.products + place * error.transpose() * both;
        self.squares += other.squares + error.norm_squared() * both;
        self.place_mm += place * share;
        self.error_mm += error * share;
        self.count = count;
    }

    /// The rigid motion by least squares: three shifts and three small rotations. A rotation that the points do not see (about a line on which
    /// all of them are, or about a single point) is zero. Of places or errors that are not finite the motion is not a number either.
    pub fn motion(&self) -> RigidMotion {
        // With everything counted from the means, the shift is that of the means, and the rotation solves
        // Σ (|p|² − p pᵀ) ω = Σ p × e.
        RigidMotion {
            about_mm: self.place_mm,
            shift_mm: self.error_mm,
            rotation_rad: self.rotation(),
        }
    }

    /// The root of the mean square of what is left beside the best rigid motion, mm; 0 without a point. It is a difference of
    /// sums: of errors of 1 mm that are a rigid motion up to some 1e-8 mm are left.
    pub fn rms_left_mm(&self) -> f64 {
        let left = self.squares - self.rotation().dot(&self.turning());
        (left.max(0.0) / self.count.max(1.0)).sqrt()
    }

    /// Σ p × e.
    fn turning(&self) -> Vector3<f64> {
        let of = &self.products;
        Vector3::new(
            of[(1, 2)] - of[(2, 1)],
            of[(2, 0)] - of[(0, 2)],
            of[(0, 1)] - of[(1, 0)],
        )
    }

    fn rotation(&self) -> Vector3<f64> {
        let turning = self.turning();
        let extent = self.places.trace();
        if extent == 0.0 {
            return Vector3::zeros();
        }
        // In units of the extent: neither the size of the machine nor the unit counts.
        let matrix = Matrix3::identity() - self.places / extent;
        let right = turning / extent;
        if !matrix.iter().chain(&right).all(|x| x.is_finite()) {
            return Vector3::repeat(f64::NAN);
        }
        let eigen = matrix.symmetric_eigen();
        let columns = eigen.eigenvectors.column_iter();
        columns
            .zip(&eigen.eigenvalues)
            .filter(|(_, value)| **value > UNSEEN)
            .map(|(about, value)| about * (about.dot(&right) / value))
            .sum()
    }
}

/// A small rigid motion: a rotation about a point, and a shift.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RigidMotion {
    /// The point about which it turns, mm: the mean of the places it was found from.
    pub about_mm: Vector3<f64>,
    /// The shift of that point, mm.
    pub shift_mm: Vector3<f64>,
    /// The rotation vector, rad.
    pub rotation_rad: Vector3<f64>,
}

impl RigidMotion {
    /// How far it moves a place, mm.
    pub fn at_mm(&self, place_mm: &Vector3<f64>) -> Vector3<f64> {
        self.shift_mm + self.rotation_rad.cross(&(place_mm - self.about_mm))
    }

    /// What is left of an error beside it, mm.
    pub fn left_mm(&self, place_mm: &Vector3<f64>, error_mm: &Vector3<f64>) -> Vector3<f64> {
        error_mm - self.at_mm(place_mm)
    }

    /// What is left of an orientation error beside it, rad.
    pub fn left_rad(&self, rotation_rad: &Vector3<f64>) -> Vector3<f64> {
        rotation_rad - self.rotation_rad
    }
}

/// State: how large vectors are, by the root of the mean square and at most. All vectors that it takes have one unit, mm or rad, and
/// what it tells has the same.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lengths {
    count: f64,
    squares: f64,
    largest: f64,
}

impl Lengths {
    /// Takes a vector.
    pub fn take(&mut self, vector: &Vector3<f64>) {
        let squared = vector.norm_squared();
        self.merge(&Self {
            count: 1.0,
            squares: squared,
            largest: squared.sqrt(),
        });
    }

    /// Takes the lengths of other vectors.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.squares += other.squares;
        self.largest = self.largest.max(other.largest);
    }

    /// The root of the mean square, in the unit of the vectors; 0 without a vector.
    pub fn rms(&self) -> f64 {
        (self.squares / self.count.max(1.0)).sqrt()
    }

    /// The largest length, in the unit of the vectors; 0 without a vector.
    pub fn max(&self) -> f64 {
        self.largest
    }
}
