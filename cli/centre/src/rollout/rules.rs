//! The rules of a roll-out, and whether they make sense.

use std::{fmt::Display, ops::RangeInclusive};

use serde::{Deserialize, Serialize};

/// By what rules a roll-out goes on and stops.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rules {
    /// After the canaries: how many percent of the others have had their turn at the end of each wave, rising to 100.
    pub waves: Vec<u32>,
    /// A machine that has activated the model is watched for so long before its turn is done, s.
    pub soak_s: f64,
    /// A machine that has not answered after so long stays out, s.
    pub answer_s: f64,
    /// So many machines after the canaries may stay out before the roll-out stops.
    pub tolerate: u32,
    /// It stops where the residual is above this many times what it was before, …
    pub residual_ratio: f64,
    /// … and above what it was before by this, µm.
    pub residual_um: f64,
}

impl Default for Rules {
    /// A quarter, then all; ten minutes of watching, five for an answer; none may stay out; half as much again and 2 µm.
    fn default() -> Self {
        Self {
            waves: vec![25, 100],
            soak_s: 600.0,
            answer_s: 300.0,
            tolerate: 0,
            residual_ratio: 1.5,
            residual_um: 2.0,
        }
    }
}

/// Why a roll-out cannot go by such rules.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{key}: found {found}, expected {expected}")]
pub struct NoRules {
    /// The key of the rule.
    pub key: &'static str,
    pub found: String,
    pub expected: String,
}

impl Rules {
    /// The times for which a machine may be watched, s.
    pub const SOAK_S: RangeInclusive<f64> = 0.0..=1e7;
    /// The times that an answer may be given, s.
    pub const ANSWER_S: RangeInclusive<f64> = 1.0..=1e7;
    /// How many machines may be let out.
    pub const TOLERATE: RangeInclusive<u32> = 0..=1_000_000;
    /// The ratios of residuals.
    pub const RESIDUAL_RATIO: RangeInclusive<f64> = 1.0..=1e3;
    /// The differences of residuals, µm.
    pub const RESIDUAL_UM: RangeInclusive<f64> = 0.0..=1e4;
    /// What is expected of waves, in words.
    pub const WAVES: &'static str = "percentages from 1 on that rise to 100, such as [25, 100]";

    /// Whether these are the waves of a roll-out.
    pub fn are_waves(waves: &[u32]) -> bool {
        let rises = waves.windows(2).all(|two| two[0] < two[1]);
        rises && waves.first().is_some_and(|first| *first > 0) && waves.last() == Some(&100)
    }

    /// Whether a roll-out can go by these rules.
    ///
    /// # Errors
    /// The first that makes no sense.
    pub fn check(&self) -> Result<(), NoRules> {
        if !Self::are_waves(&self.waves) {
            return Err(NoRules {
                key: "waves",
                found: format!("{:?}", self.waves),
                expected: Self::WAVES.to_owned(),
            });
        }
        within("soak_s", &self.soak_s, &Self::SOAK_S)?;
        within("answer_s", &self.answer_s, &Self::ANSWER_S)?;
        within("tolerate", &self.tolerate, &Self::TOLERATE)?;
        within(
            "residual_ratio",
            &self.residual_ratio,
            &Self::RESIDUAL_RATIO,
        )?;
        within("residual_um", &self.residual_um, &Self::RESIDUAL_UM)
    }
}

fn within<N: PartialOrd + Display>(
    key: &'static str,
    found: &N,
    range: &RangeInclusive<N>,
) -> Result<(), NoRules> {
    if range.contains(found) {
        return Ok(());
    }
    Err(NoRules {
        key,
        found: found.to_string(),
        expected: format!("{} to {}", range.start(), range.end()),
    })
}
