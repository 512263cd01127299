//! How well a fitted curve follows its readings.

use volcomp_vocabulary::{Direction, ErrorName, Um, Urad};

/// One branch of a fitted error.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct FittedCurve {
    /// The error that the curve states.
    pub error: ErrorName,
    /// The direction of travel, `None` when one curve holds for both.
    pub direction: Option<Direction>,
    /// Kind of curve, as the machine file names it.
    pub kind: &'static str,
    /// Number of mean readings: targets times lines.
    pub readings: usize,
    /// How far the readings are from the curve.
    pub quality: Quality,
}

/// How far readings are from their curve: lengths of a linear error, angles of an angular one.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Quality {
    /// Of an error in µm.
    Length(FitQuality<Um>),
    /// Of an error in µrad.
    Angle(FitQuality<Urad>),
}

/// How far readings are from their curve, in the unit of the error.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct FitQuality<U> {
    /// The smallest reading minus curve.
    pub residual_min: U,
    /// The largest reading minus curve.
    pub residual_max: U,
    /// Root mean square of the readings minus curve.
    pub residual_rms: U,
    /// Leave-one-out error: root mean square of each reading minus the curve fitted without it.
    pub leave_one_out: U,
    /// Largest difference forward − backward of the curves over the targets, with its sign; `None` with one curve for
    /// both directions.
    pub reversal: Option<U>,
}
