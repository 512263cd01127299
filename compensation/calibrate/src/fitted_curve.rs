//! How well a fitted curve follows its readings.

use volcomp_fit::{Band, BandOptions, Between, Choice, Method, band, band_places};
use volcomp_vocabulary::{Direction, ErrorName, Um, Urad};

use crate::profile::Run;

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
    /// The method that the curve was fitted with.
    pub method: Method,
    /// How it was chosen from the readings, those of both directions; `None` where the calibration file states it. In the unit of the error.
    pub choice: Option<Choice>,
    /// The mean readings that the curve was fitted to, cleared of what does not belong to the error (Abbe, the line of a
    /// straightness, the zero of each line): coordinate in mm or deg, reading and value of the curve there in the unit of the
    /// error.
    pub points: Vec<[f64; 3]>,
    /// The curve from the first to the last of its readings, in equal steps: coordinate and value.
    pub sampled: Vec<[f64; 2]>,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) between: Between,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) resampled: Option<Resampled>,
}

/// What the band of a curve is resampled from.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Resampled {
    pub(crate) runs: Vec<Run>,
    pub(crate) targets: Vec<f64>,
    /// What the readings were multiplied by for this curve.
    pub(crate) factor: f64,
}

impl FittedCurve {
    /// Whether the curve follows its readings, as far as these repeat.
    pub fn follows(&self) -> bool {
        !self.between.is_not_followed()
    }

    /// The band of 95 % at the targets and between them, of the readings alone, in the unit of the error; `None` where it is not known. It is
    /// resampled from the runs at each call, which takes longer than the curve.
    pub fn band(&self) -> Option<Band> {
        let of = self.resampled.as_ref()?;
        let runs: Vec<(&[f64], &[f64])> = of.runs.iter().map(|(x, u)| (&x[..], &u[..])).collect();
        // A method that the readings of some runs do not carry has no band.
        let places = band_places(&of.targets);
        let mut band = band(self.method, &runs, &places, &BandOptions::default()).ok()?;
        for half in &mut band.half_width {
            *half *= of.factor.abs();
        }
        let is_known = band.half_width.iter().all(|half| half.is_finite());
        is_known.then_some(band)
    }
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

impl Quality {
    /// The leave-one-out error in the unit of the error.
    pub(crate) fn leave_one_out(&self) -> Option<f64> {
        match self {
            Self::Length(quality) => quality.leave_one_out.map(|Um(um)| um),
            Self::Angle(quality) => quality.leave_one_out.map(|Urad(urad)| urad),
        }
    }
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
    /// Leave-one-out error: root mean square of each reading minus the curve fitted without it; `None` where one cannot be predicted from the
    /// others.
    pub leave_one_out: Option<U>,
    /// Largest difference forward − backward of the curves over the targets, with its sign; `None` with one curve for
    /// both directions.
    pub reversal: Option<U>,
}
