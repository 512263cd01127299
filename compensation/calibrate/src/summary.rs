//! A calibration as a document: the curves with their residuals, squareness, location errors and messages.

use std::collections::BTreeMap;

use volcomp_vocabulary::{Direction, ErrorName, Urad};

use crate::{
    branches::{FitQuality, FittedCurve, Quality},
    calibration::Calibration,
    identified::Identified,
};

/// What a calibration found, without its machine: the document of `volcomp calibrate`.
#[derive(Debug, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CalibrationSummary {
    /// Every fitted curve, angular errors first.
    pub curves: Vec<FittedRow>,
    /// Squareness errors by name, µrad.
    pub squareness_urad: BTreeMap<String, f64>,
    /// Location errors stated in the calibration file, by name; missing if it states none.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub locations: BTreeMap<String, Stated>,
    /// Parameters identified from observations of the whole machine; missing if the calibration
    /// file has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub identified: Option<Identified>,
    /// Warnings: unmeasured errors, Abbe offsets that could not be removed, notes on the files.
    pub warnings: Vec<String>,
}

/// A location error stated in the calibration file.
#[derive(Debug, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Stated {
    /// The value in `unit`.
    pub value: f64,
    /// `um` or `urad`.
    pub unit: &'static str,
    /// Standard uncertainty (k = 1) in the same unit.
    pub uncertainty: f64,
}

/// A fitted error curve and its residuals, in `unit`.
#[derive(Debug, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FittedRow {
    /// Name of the error.
    pub error: ErrorName,
    /// `forward` or `backward`; null: one curve for both directions.
    pub direction: Option<&'static str>,
    /// Kind of curve, as in the machine file.
    pub curve: &'static str,
    /// Number of mean readings: targets times lines.
    pub readings: usize,
    /// Unit of the values below: `um` or `urad`.
    pub unit: &'static str,
    /// Readings minus curve.
    pub residual: Residual,
    /// Root mean square of the leave-one-out errors; null if a reading cannot be predicted from the
    /// others.
    pub leave_one_out: Option<f64>,
    /// Largest difference forward − backward of the curves; null: one curve for both directions.
    pub reversal: Option<f64>,
}

/// Range and size of the residuals, readings minus curve.
#[derive(Clone, Copy, Debug, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Residual {
    /// The smallest residual, with its sign.
    pub min: f64,
    /// The largest residual, with its sign.
    pub max: f64,
    /// Root mean square of the residuals.
    pub rms: f64,
}

impl CalibrationSummary {
    pub fn new(calibration: &Calibration) -> Self {
        let squareness = calibration.squareness.iter();
        Self {
            curves: calibration.curves.iter().map(FittedRow::new).collect(),
            squareness_urad: squareness
                .map(|(error, Urad(value))| (error.to_string(), *value))
                .collect(),
            locations: (calibration.locations.iter())
                .map(|location| {
                    let stated = Stated {
                        value: location.value,
                        unit: location.error.component.unit(),
                        uncertainty: location.uncertainty,
                    };
                    (location.error.to_string(), stated)
                })
                .collect(),
            identified: calibration.identified.clone(),
            warnings: calibration.warnings.clone(),
        }
    }
}

impl FittedRow {
    fn new(curve: &FittedCurve) -> Self {
        match curve.quality {
            Quality::Length(quality) => Self::of(curve, &quality, |um| um.0),
            Quality::Angle(quality) => Self::of(curve, &quality, |urad| urad.0),
        }
    }

    fn of<U: Copy>(curve: &FittedCurve, quality: &FitQuality<U>, number: fn(U) -> f64) -> Self {
        Self {
            error: curve.error,
            direction: curve.direction.map(Direction::name),
            curve: curve.kind,
            readings: curve.readings,
            unit: curve.error.component.unit(),
            residual: Residual {
                min: number(quality.residual_min),
                max: number(quality.residual_max),
                rms: number(quality.residual_rms),
            },
            leave_one_out: quality.leave_one_out.map(number),
            reversal: quality.reversal.map(number),
        }
    }
}
