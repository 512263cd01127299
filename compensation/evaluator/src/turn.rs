use volcomp_kinematics::nalgebra::{Matrix3, Vector3};

use crate::table::Registers;

/// The direction of an axis. A rotation about X, Y or Z leaves one component of a vector unchanged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Along {
    X(f64),
    Y(f64),
    Z(f64),
    Oblique([f64; 3]),
}

impl Along {
    pub(crate) fn of(direction: &Vector3<f64>) -> Self {
        match <[f64; 3]>::from(*direction) {
            [x, 0.0, 0.0] => Self::X(x),
            [0.0, y, 0.0] => Self::Y(y),
            [0.0, 0.0, z] => Self::Z(z),
            oblique => Self::Oblique(oblique),
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Turn {
    along: Along,
    sin: f64,
    cos: f64,
}

impl Turn {
    #[inline(always)]
    pub(crate) fn new(registers: impl Registers, along: Along, q_rad: f64) -> Self {
        let (sin, cos) = sin_cos(registers, q_rad);
        Self { along, sin, cos }
    }

    /// Rotates vectors. About X, Y or Z, two components rotate in their plane; other directions use Rodrigues' formula.
    /// Several vectors are rotated in one call, so that the direction is dispatched once.
    #[inline(always)]
    pub(crate) fn apply<const N: usize>(
        &self,
        registers: impl Registers,
        mut vectors: [Vector3<f64>; N],
    ) -> [Vector3<f64>; N] {
        let cos = self.cos;
        match self.along {
            Along::X(sense) => {
                let sin = sense * self.sin;
                for v in &mut vectors {
                    (v.y, v.z) = in_plane(registers, sin, cos, v.y, v.z);
                }
            }
            Along::Y(sense) => {
                let sin = sense * self.sin;
                for v in &mut vectors {
                    (v.z, v.x) = in_plane(registers, sin, cos, v.z, v.x);
                }
            }
            Along::Z(sense) => {
                let sin = sense * self.sin;
                for v in &mut vectors {
                    (v.x, v.y) = in_plane(registers, sin, cos, v.x, v.y);
                }
            }
            Along::Oblique(direction) => {
                let u = Vector3::from(direction);
                for v in &mut vectors {
                    *v = *v * cos + u.cross(v) * self.sin + u * (u.dot(v) * (1.0 - cos));
                }
            }
        }
        vectors
    }

    #[inline(always)]
    pub(crate) fn matrix(&self, registers: impl Registers) -> Matrix3<f64> {
        let unit = [Vector3::x(), Vector3::y(), Vector3::z()];
        Matrix3::from_columns(&self.apply(registers, unit))
    }
}

/// Rotates the vector (u, v) in its plane. A positive angle rotates the first axis towards the second.
#[inline(always)]
fn in_plane(registers: impl Registers, sin: f64, cos: f64, u: f64, v: f64) -> (f64, f64) {
    (registers.mul_add(cos, u, -(sin * v)), registers.mul_add(sin, u, cos * v))
}

/// Maximum angle, rad, for which the reduction by quarter turns is accurate to the last digits.
const REDUCED_BELOW_RAD: f64 = 1e5;
/// Adding and subtracting this rounds to a whole number.
const ROUND: f64 = 6_755_399_441_055_744.0;
/// π/2 in two parts: 33 bits, whose product with a number of quarter turns is exact, and the remainder.
const QUARTER: f64 = 1.570_796_326_734_125_6;
const QUARTER_REST: f64 = 6.077_100_506_506_192e-11;

/// Sine and cosine without calls or branches for angles below `REDUCED_BELOW_RAD`: reduction by quarter turns, then the
/// minimax polynomials of Sun's fdlibm (k_sin.c, k_cos.c) over ±π/4. Larger angles use `libm`.
#[inline(always)]
pub(crate) fn sin_cos<R: Registers>(registers: R, q_rad: f64) -> (f64, f64) {
    // NaN takes the slow path as well.
    if q_rad.abs() >= REDUCED_BELOW_RAD || q_rad.is_nan() {
        return libm::sincos(q_rad);
    }
    let shifted = q_rad * core::f64::consts::FRAC_2_PI + ROUND;
    let quarters = shifted - ROUND;
    let r = (q_rad - quarters * QUARTER) - quarters * QUARTER_REST;
    let z = r * r;
    let fma = R::mul_add;
    let k = registers;
    let s = fma(k, z, 1.589_690_995_211_55e-10, -2.505_076_025_340_686_3e-8);
    let s = fma(k, z, fma(k, z, s, 2.755_731_370_707_006_8e-6), -1.984_126_982_985_795e-4);
    let s = fma(k, z, fma(k, z, s, 8.333_333_333_322_49e-3), -1.666_666_666_666_663_2e-1);
    let c = fma(k, z, -1.135_964_755_778_819_5e-11, 2.087_572_321_298_175e-9);
    let c = fma(k, z, fma(k, z, c, -2.755_731_435_139_066_3e-7), 2.480_158_728_947_673e-5);
    let c = fma(k, z, fma(k, z, c, -1.388_888_888_887_411e-3), 4.166_666_666_666_66e-2);
    let (s, c) = (fma(k, r * z, s, r), fma(k, z * z, c, fma(k, z, -0.5, 1.0)));
    // The last two bits are the number of quarter turns modulo 4.
    let bits = shifted.to_bits();
    let (sin, cos) = if bits & 1 == 0 { (s, c) } else { (c, s) };
    let sign = |bit: u64| bit << 62 & 1 << 63;
    (f64::from_bits(sin.to_bits() ^ sign(bits)), f64::from_bits(cos.to_bits() ^ sign(bits + 1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::Baseline;

    #[test]
    fn sine_and_cosine_are_those_of_libm() {
        let angles = (-200_000..200_000).map(|i| f64::from(i) * 0.501_3);
        let quarters = (-50..50).map(|i| f64::from(i) * core::f64::consts::FRAC_PI_2);
        let special = [0.0, -0.0, 1e-300, 1e5, -1e5, 1e300];
        for q in angles.chain(quarters).chain(special) {
            let ((sin, cos), (s, c)) = (sin_cos(Baseline, q), libm::sincos(q));
            assert!(
                (sin - s).abs() < 3e-16 && (cos - c).abs() < 3e-16,
                "{q}: {sin} {s}, {cos} {c}"
            );
        }
        for q in [f64::NAN, f64::INFINITY] {
            let (sin, cos) = sin_cos(Baseline, q);
            assert!(sin.is_nan() && cos.is_nan());
        }
    }
}
