//! Elementary functions that `core` lacks.
//!
//! Sine and cosine always come from the `libm` crate. For the `twist` form of the error model it is faster than the
//! functions of the platform. Results are bit-identical with and without `std`.

#[cfg(feature = "std")]
mod functions {
    pub(crate) fn sqrt(x: f64) -> f64 {
        x.sqrt()
    }
    pub(crate) fn atan2(y: f64, x: f64) -> f64 {
        y.atan2(x)
    }
}

#[cfg(not(feature = "std"))]
mod functions {
    pub(crate) use libm::{atan2, sqrt};
}

pub(crate) use functions::{atan2, sqrt};
pub(crate) use libm::sincos as sin_cos;
