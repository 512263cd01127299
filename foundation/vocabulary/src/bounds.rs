//! Bounds of plausible values: one bound for each quantity, used by all readers, writers and controllers.

use core::ops::RangeInclusive;

use crate::{
    axis::AxisKind,
    units::{Displacement, Mm, Rad},
};

/// Maximum correction, deviation or error of a linear axis. The volumetric error of a machine tool is some tenths of a
/// millimetre; a larger value is a mistake in the unit.
pub const LARGEST_CORRECTION: Mm = Mm(2.0);
/// Maximum correction, deviation or error of a rotary axis, and maximum angular error: 2 mrad are 412 arcsec.
pub const LARGEST_CORRECTION_ROTARY: Rad = Rad(0.002);

/// Plausible temperatures, °C: the range of platinum thermometers according to IEC 60751. Temperatures of a machine
/// tool are far inside this range; a value read in a wrong byte order is usually far outside.
pub const PLAUSIBLE_DEGC: RangeInclusive<f64> = -200.0..=850.0;
/// Plausible magnitudes of a non-zero floating-point number from a thermometer, °C, K or Ω. No thermometer resolves 1
/// µK or 1 µΩ, and a 32-bit float in a wrong byte order is nearly always outside this range.
pub const PLAUSIBLE_READING: RangeInclusive<f64> = 1e-6..=1e6;

/// Whether a floating-point number can come from a thermometer: it is 0, or its magnitude is within
/// [`PLAUSIBLE_READING`].
pub fn is_plausible_reading(number: f64) -> bool {
    number == 0.0 || PLAUSIBLE_READING.contains(&number.abs())
}

/// Maximum correction, deviation or error for this kind of axis, mm or rad.
pub fn largest_correction(kind: AxisKind) -> f64 {
    match kind {
        AxisKind::Linear => LARGEST_CORRECTION.0,
        AxisKind::Rotary => LARGEST_CORRECTION_ROTARY.0,
    }
}

/// Whether a correction, deviation or error is finite and within ±[`largest_correction`] of its kind of axis.
pub fn is_plausible_error(error: Displacement) -> bool {
    within(error.mm_or_rad(), largest_correction(error.kind()))
}

/// Whether a number is within ±`bound`, with a relative tolerance of 1e-9 for the conversion from µm or µrad; false for
/// NaN.
fn within(number: f64, bound: f64) -> bool {
    number.abs() <= bound * (1.0 + 1e-9)
}

/// Maximum correction that may be written to an NC program or a table. One number applies to both kinds of axis, in µm
/// for linear and in µrad for rotary axes: above 0, at most 2000.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectionLimit {
    micro: f64,
}

/// A limit that is zero, negative, NaN, or above 2000.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("found {found}, expected µm above 0, at most 2000")]
pub struct CorrectionLimitError {
    /// The rejected number, µm for linear and µrad for rotary axes.
    pub found: f64,
}

impl Default for CorrectionLimit {
    /// 250 µm, and 250 µrad for rotary axes.
    fn default() -> Self {
        Self { micro: 250.0 }
    }
}

impl CorrectionLimit {
    /// Upper bound of the limit: 2 mm, and 2 mrad for rotary axes.
    pub const LARGEST: Self = Self { micro: 2000.0 };

    /// Creates a limit: the number is in µm for linear axes and in µrad for rotary axes.
    ///
    /// # Errors
    /// The number is not above 0, or is above 2000.
    pub fn new(um_and_urad: f64) -> Result<Self, CorrectionLimitError> {
        if um_and_urad > 0.0 && um_and_urad <= Self::LARGEST.micro {
            Ok(Self { micro: um_and_urad })
        } else {
            Err(CorrectionLimitError { found: um_and_urad })
        }
    }

    /// Limit for this kind of axis.
    pub fn of(self, kind: AxisKind) -> Displacement {
        Displacement::from_micro(kind, self.micro)
    }

    /// Whether a correction is within ± this limit for its kind of axis; false for NaN.
    pub fn allows(self, correction: Displacement) -> bool {
        within(correction.um_or_urad(), self.micro)
    }
}
