//! The JSON document of `volcomp calibrate`.

#![expect(clippy::struct_field_names, reason = "the keys are named in full")]

use std::collections::BTreeMap;

use super::identify::Found;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::{Calibration, FitQuality, FittedCurve, Quality};
use volcomp_vocabulary::{Direction, Um, Urad};

/// The document of `volcomp calibrate`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Calibrate {
    /// The machine file that was written.
    pub(crate) file: String,
    /// Every fitted curve, angular errors first.
    pub(crate) curves: Vec<Curve>,
    /// Every squareness by its error name, µrad.
    pub(crate) squareness_urad: BTreeMap<String, f64>,
    /// Every location error that the calibration file states, by its name; not there where it states none.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub(crate) locations: BTreeMap<String, Stated>,
    /// What was found from observations of the whole machine; not there where the calibration file has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) identified: Option<Identified>,
    /// Warnings in words: errors that were not measured, Abbe offsets that could not be removed, notes on the files.
    pub(crate) warnings: Vec<String>,
}

/// What was found from observations, and how often it was looked for.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Identified {
    /// How often the unknowns were identified until the measured lines, cleared of them, had settled.
    pub(crate) rounds: usize,
    /// What was found.
    #[serde(flatten)]
    pub(crate) found: Found,
}

/// A location error as the calibration file states it.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Stated {
    /// The value in `unit`.
    pub(crate) value: f64,
    /// `um` or `urad`.
    pub(crate) unit: &'static str,
    /// Standard uncertainty (k = 1) in the same unit.
    pub(crate) uncertainty: f64,
}

/// One fitted error curve and how well it follows its readings.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Curve {
    /// The error that the curve states: `EXX`.
    pub(crate) error: String,
    /// `forward` or `backward`; null: one curve for both directions.
    pub(crate) direction: Option<&'static str>,
    /// Kind of curve, as the machine file names it.
    pub(crate) curve: &'static str,
    /// Number of mean readings: targets times lines.
    pub(crate) readings: usize,
    /// `um` or `urad`; the keys of the values end in it.
    pub(crate) unit: &'static str,
    /// How far the readings are from the curve.
    #[serde(flatten)]
    pub(crate) quality: CurveQuality,
}

/// How far readings are from their curve.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum CurveQuality {
    /// Of a linear error.
    Length(LengthQuality),
    /// Of an angular error.
    Angle(AngleQuality),
}

/// How far readings of a linear error are from their curve.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct LengthQuality {
    /// Readings minus curve, µm.
    pub(crate) residual_um: Residual,
    /// Root mean square of the leave-one-out errors, µm.
    pub(crate) leave_one_out_um: f64,
    /// Largest difference forward − backward of the curves, µm; null: one curve for both directions.
    pub(crate) reversal_um: Option<f64>,
}

/// How far readings of an angular error are from their curve.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct AngleQuality {
    /// Readings minus curve, µrad.
    pub(crate) residual_urad: Residual,
    /// Root mean square of the leave-one-out errors, µrad.
    pub(crate) leave_one_out_urad: f64,
    /// Largest difference forward − backward of the curves, µrad; null: one curve for both directions.
    pub(crate) reversal_urad: Option<f64>,
}

/// The range and the size of the residuals, readings minus curve, in the unit of their key.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub(crate) struct Residual {
    /// The smallest residual, with its sign.
    pub(crate) min: f64,
    /// The largest residual, with its sign.
    pub(crate) max: f64,
    /// Root mean square of the residuals.
    pub(crate) rms: f64,
}

impl Calibrate {
    /// The document of a calibration whose machine was written to `file`.
    pub(crate) fn new(file: String, calibration: &Calibration) -> Self {
        let squareness = calibration.squareness.iter();
        Self {
            file,
            curves: calibration.curves.iter().map(Curve::from).collect(),
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
            identified: calibration
                .identified
                .as_ref()
                .map(|identified| Identified {
                    rounds: identified.rounds,
                    found: (&identified.found).into(),
                }),
            warnings: calibration.warnings.clone(),
        }
    }
}

impl From<&FittedCurve> for Curve {
    fn from(curve: &FittedCurve) -> Self {
        Self {
            error: curve.error.to_string(),
            direction: curve.direction.map(Direction::name),
            curve: curve.kind,
            readings: curve.readings,
            unit: curve.error.component.unit(),
            quality: match curve.quality {
                Quality::Length(quality) => CurveQuality::Length(quality.into()),
                Quality::Angle(quality) => CurveQuality::Angle(quality.into()),
            },
        }
    }
}

impl From<FitQuality<Um>> for LengthQuality {
    fn from(quality: FitQuality<Um>) -> Self {
        Self {
            residual_um: Residual {
                min: quality.residual_min.0,
                max: quality.residual_max.0,
                rms: quality.residual_rms.0,
            },
            leave_one_out_um: quality.leave_one_out.0,
            reversal_um: quality.reversal.map(|Um(reversal)| reversal),
        }
    }
}

impl From<FitQuality<Urad>> for AngleQuality {
    fn from(quality: FitQuality<Urad>) -> Self {
        Self {
            residual_urad: Residual {
                min: quality.residual_min.0,
                max: quality.residual_max.0,
                rms: quality.residual_rms.0,
            },
            leave_one_out_urad: quality.leave_one_out.0,
            reversal_urad: quality.reversal.map(|Urad(reversal)| reversal),
        }
    }
}

impl Curve {
    /// Residuals and leave-one-out error, in the unit of the curve.
    pub(crate) fn residual_and_leave_one_out(&self) -> (Residual, f64) {
        match &self.quality {
            CurveQuality::Length(q) => (q.residual_um, q.leave_one_out_um),
            CurveQuality::Angle(q) => (q.residual_urad, q.leave_one_out_urad),
        }
    }
}
