use std::fmt;

use crate::{Fit, Method, Noise};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(default))]
pub struct FitOptions {
    /// Largest valid deviation of a mean reading from the curve, in the unit of the readings. It is ignored if no
    /// candidate meets it.
    pub required_residual: Option<f64>,
    /// Scatter of a single reading. `None`: it is estimated from repeated readings of the same target, if there are
    /// any.
    pub noise: Option<Noise>,
    /// Period of the coordinate (360 for a rotary axis in degrees). If the targets cover at least half of the period,
    /// Fourier series are candidates too. If the targets cover the full period, a curve that would jump at its end is
    /// removed.
    pub period: Option<f64>,
}

/// A candidate with its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Score {
    /// Method of the candidate.
    pub method: Method,
    /// Number of coefficients that the readings determine: the trace of the hat matrix, summed over the sets.
    pub coefficients: f64,
    /// Root mean square error of predicting the mean of each inner target after leaving out all its
    /// readings; infinite if a target cannot be predicted.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub leave_one_out_rms: f64,
    /// Largest deviation of a target's mean reading from the curve.
    pub largest_residual: f64,
    /// Whether the required residual is met; true if none is required.
    pub meets_required: bool,
    /// Whether the residuals are explained by the scatter of the readings; true if the scatter is
    /// unknown.
    pub follows: bool,
    /// Whether the candidate was rejected because its curve leaves the band of the readings between
    /// targets. This is checked only for candidates that would otherwise be chosen.
    pub swings: bool,
}

/// Reason for the choice of a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum Reason {
    /// There are too few targets for any other candidate.
    FewTargets,
    /// The candidate has the smallest leave-one-out error.
    Smallest,
    /// The candidate is the simplest whose leave-one-out error is within one standard error of the smallest.
    Simplest,
}

/// Describes the rule, such as `the simplest of those that predict as well as the best`.
impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::FewTargets => "the targets are too few for anything else",
            Self::Smallest => "smallest leave-one-out error",
            Self::Simplest => "simplest of those that predict as well as the best",
        })
    }
}

/// The chosen method, and all candidates.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Choice {
    /// The method chosen.
    pub method: Method,
    /// Rule by which the method was chosen.
    pub reason: Reason,
    /// All candidates, simplest first.
    pub scores: Vec<Score>,
}

impl Choice {
    pub fn chosen(&self) -> Option<&Score> {
        self.scores.iter().find(|score| score.method == self.method)
    }

    /// Message if the residuals of the chosen curve exceed the scatter of the readings; `None` if they do not. `unit`
    /// is the unit of the readings.
    pub fn not_followed(&self, unit: &str) -> Option<String> {
        let score = self.chosen().filter(|score| !score.follows)?;
        Some(format!(
            "the curve chosen, {}, does not follow the readings: it leaves up to {:.1} {unit} of them, more than the runs scatter, and a curve that follows them misses targets that are left out by far more. Look for an error with a period shorter than the spacing of the targets, and for single targets that are wrong; measure more densely, or state the kind of curve",
            score.method, score.largest_residual
        ))
    }

    /// Candidate with the smallest leave-one-out error of each kind, in the order of the candidates.
    pub fn best_of_kinds(&self) -> Vec<Score> {
        let mut best: Vec<Score> = Vec::new();
        for score in &self.scores {
            match best.iter_mut().find(|b| b.method.kind() == score.method.kind()) {
                Some(known) if score.leave_one_out_rms < known.leave_one_out_rms => *known = *score,
                Some(_) => {}
                None => best.push(*score),
            }
        }
        best
    }
}

#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AutoFit {
    pub fit: Fit,
    pub choice: Choice,
}
