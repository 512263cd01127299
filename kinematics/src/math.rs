//! The few elementary functions that `core` lacks: from `std` where it is there, else from `libm`.

#[cfg(feature = "std")]
mod functions {
    pub(crate) fn sin_cos(x: f64) -> (f64, f64) {
        x.sin_cos()
    }
    pub(crate) fn sqrt(x: f64) -> f64 {
        x.sqrt()
    }
    pub(crate) fn atan2(y: f64, x: f64) -> f64 {
        y.atan2(x)
    }
}

#[cfg(not(feature = "std"))]
mod functions {
    pub(crate) use libm::{atan2, sincos as sin_cos, sqrt};
}

pub(crate) use functions::{atan2, sin_cos, sqrt};
