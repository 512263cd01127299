//! Best-fit rigid-body alignment of the workpiece: separates error vectors into a workpiece position and form errors.
//!
//! The position and orientation of the workpiece are a convention: an operator probes them, or a coordinate measuring machine aligns them. Only
//! the error that remains after any alignment is an error of form.

use volcomp_kinematics::nalgebra::{Matrix3, Vector3};

/// Threshold of the squared ratio of the points' distance from a line to their spread along it: 10 µm in 100 m. Below it the rotation about the line
/// cannot be distinguished from rounding errors.
const COLLINEAR_BELOW: f64 = 1e-14;

/// Sums over points and their error vectors, which determine the best-fit rigid motion.
///
/// State: means, and second moments about the means, updated with each point (Welford), so that points far from zero lose no digits.
/// [`merge`](Self::merge) combines partial sums.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RigidSums {
    count: f64,
    place_mm: Vector3<f64>,
    error_mm: Vector3<f64>,
    /// Σ p pᵀ, p relative to the mean.
    places: Matrix3<f64>,
    /// Σ p eᵀ, both relative to their means.
    products: Matrix3<f64>,
    /// Σ |e|², e relative to the mean.
    squares: f64,
}

impl RigidSums {
    /// Adds a point and its error vector, both in workpiece axes, mm.
    pub fn take(&mut self, place_mm: &Vector3<f64>, error_mm: &Vector3<f64>) {
        self.merge(&Self {
            count: 1.0,
            place_mm: *place_mm,
            error_mm: *error_mm,
            ..Self::default()
        });
    }

    /// Adds the sums of other points.
    pub fn merge(&mut self, other: &Self) {
        let count = self.count + other.count;
        if count == 0.0 {
            return;
        }
        let (place, error) = (other.place_mm - self.place_mm, other.error_mm - self.error_mm);
        let share = other.count / count;
        let both = self.count * share;
        self.places += other.places + place * place.transpose() * both;
        self.products += other.products + place * error.transpose() * both;
        self.squares += other.squares + error.norm_squared() * both;
        self.place_mm += place * share;
        self.error_mm += error * share;
        self.count = count;
    }

    /// The least-squares rigid motion. A rotation that the points do not determine (about a line through all of them, or about a single point) is
    /// zero. Points or errors that are not finite give NaN.
    pub fn motion(&self) -> RigidMotion {
        // With points and errors relative to their means, the translation is the mean error, and the rotation ω solves
        // Σ (|p|² − p pᵀ) ω = Σ p × e.
        RigidMotion {
            about_mm: self.place_mm,
            shift_mm: self.error_mm,
            rotation_rad: self.rotation(),
        }
    }

    /// Root mean square after best-fit rigid-body alignment, mm; 0 without a point. The value is a
    /// difference of sums: for errors of 1 mm that are an exact rigid motion, rounding leaves about
    /// 1e-8 mm.
    pub fn rms_left_mm(&self) -> f64 {
        let left = self.squares - self.rotation().dot(&self.turning());
        (left.max(0.0) / self.count.max(1.0)).sqrt()
    }

    /// Σ p × e.
    fn turning(&self) -> Vector3<f64> {
        let of = &self.products;
        Vector3::new(of[(1, 2)] - of[(2, 1)], of[(2, 0)] - of[(0, 2)], of[(0, 1)] - of[(1, 0)])
    }

    fn rotation(&self) -> Vector3<f64> {
        let turning = self.turning();
        let extent = self.places.trace();
        if extent == 0.0 {
            return Vector3::zeros();
        }
        // Both sides are divided by the extent, so that the threshold does not depend on the size of the machine or the
        // unit.
        let matrix = Matrix3::identity() - self.places / extent;
        let right = turning / extent;
        if !matrix.iter().chain(&right).all(|x| x.is_finite()) {
            return Vector3::repeat(f64::NAN);
        }
        let eigen = matrix.symmetric_eigen();
        let columns = eigen.eigenvectors.column_iter();
        columns
            .zip(&eigen.eigenvalues)
            .filter(|(_, value)| **value > COLLINEAR_BELOW)
            .map(|(about, value)| about * (about.dot(&right) / value))
            .sum()
    }
}

/// A small rigid motion: a rotation about a point, and a translation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RigidMotion {
    /// Centre of rotation, mm: the mean of the fitted points.
    pub about_mm: Vector3<f64>,
    /// Translation of the point `about_mm`, mm.
    pub shift_mm: Vector3<f64>,
    /// Small rotation about `about_mm`, as a vector along its axis, rad.
    pub rotation_rad: Vector3<f64>,
}

impl RigidMotion {
    /// Displacement of a point by the motion, mm.
    pub fn at_mm(&self, place_mm: &Vector3<f64>) -> Vector3<f64> {
        self.shift_mm + self.rotation_rad.cross(&(place_mm - self.about_mm))
    }

    /// Error at a point minus its displacement by the motion, mm.
    pub fn left_mm(&self, place_mm: &Vector3<f64>, error_mm: &Vector3<f64>) -> Vector3<f64> {
        error_mm - self.at_mm(place_mm)
    }

    /// Orientation error minus the rotation of the motion, rad.
    pub fn left_rad(&self, rotation_rad: &Vector3<f64>) -> Vector3<f64> {
        rotation_rad - self.rotation_rad
    }
}

/// Root mean square and maximum length of vectors, in their unit (mm or rad).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lengths {
    count: f64,
    squares: f64,
    largest: f64,
}

impl Lengths {
    /// Adds a vector.
    pub fn take(&mut self, vector: &Vector3<f64>) {
        let squared = vector.norm_squared();
        self.merge(&Self { count: 1.0, squares: squared, largest: squared.sqrt() });
    }

    /// Adds the vectors of another instance.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.squares += other.squares;
        self.largest = self.largest.max(other.largest);
    }

    /// Root mean square, in the unit of the vectors; 0 without a vector.
    pub fn rms(&self) -> f64 {
        (self.squares / self.count.max(1.0)).sqrt()
    }

    /// Maximum length, in the unit of the vectors; 0 without a vector.
    pub fn max(&self) -> f64 {
        self.largest
    }
}

/// Unit vectors to the corners, edges and faces of a cube.
pub(crate) fn directions() -> impl Iterator<Item = Vector3<f64>> {
    (0..27).filter_map(|number| {
        let of = |divisor: i32| f64::from(number / divisor % 3 - 1);
        Vector3::new(of(1), of(3), of(9)).try_normalize(0.5)
    })
}
