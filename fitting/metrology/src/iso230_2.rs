//! ISO 230-2: accuracy and repeatability of positioning, from the readings of all runs.

use crate::measurement::{TargetReadings, mean};
use crate::number::LARGEST;
use crate::{
    DeviationUnit, Direction, Measurement, MetrologyError, OutlierHint, Reading, outlier_hints,
};

/// The results of ISO 230-2 for one direction of approach at one target, in the unit of the deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Approach {
    /// Number of readings n.
    pub n: usize,
    /// Mean positioning deviation x̄_i↑ or x̄_i↓.
    pub mean: f64,
    /// Estimator of the standard deviation s_i↑ or s_i↓ (n − 1); `None` for one reading.
    pub s: Option<f64>,
    /// Unidirectional repeatability R_i↑ or R_i↓ = 4 s_i.
    pub repeatability: Option<f64>,
}

/// One line of the per-target table; values in the measurement's unit, `None` where they cannot be evaluated.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TargetRow {
    /// Target position, mm or deg.
    pub target: f64,
    /// Readings approached forward (↑).
    pub forward: Option<Approach>,
    /// Readings approached backward (↓).
    pub backward: Option<Approach>,
    /// Reversal value B_i = x̄_i↑ − x̄_i↓.
    pub reversal: Option<f64>,
    /// Bidirectional repeatability R_i = max(2s↑ + 2s↓ + |B_i|, R_i↑, R_i↓).
    pub repeatability: Option<f64>,
    /// Mean bidirectional positioning deviation x̄_i.
    pub mean: Option<f64>,
}

/// Result of ISO 230-2, in the standard's symbols and the measurement's unit (µm or µrad).
///
/// With one run in each direction (n = 1) all R and A are `None`; with a single direction, so are
/// the bidirectional values and those of the other direction.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Iso230Part2 {
    /// Unit of all values; `None` if the file does not state it.
    pub unit: Option<DeviationUnit>,
    /// The per-target table, targets ascending.
    pub targets: Vec<TargetRow>,
    /// Bidirectional accuracy A = max(x̄ + 2s) − min(x̄ − 2s) over both directions.
    #[cfg_attr(feature = "serde", serde(rename = "A"))]
    pub a: Option<f64>,
    /// Unidirectional accuracy A↑ of the forward approaches.
    #[cfg_attr(feature = "serde", serde(rename = "A_forward"))]
    pub a_forward: Option<f64>,
    /// Unidirectional accuracy A↓ of the backward approaches.
    #[cfg_attr(feature = "serde", serde(rename = "A_backward"))]
    pub a_backward: Option<f64>,
    /// Bidirectional repeatability R = max R_i.
    #[cfg_attr(feature = "serde", serde(rename = "R"))]
    pub r: Option<f64>,
    /// Unidirectional repeatability R↑ of the forward approaches.
    #[cfg_attr(feature = "serde", serde(rename = "R_forward"))]
    pub r_forward: Option<f64>,
    /// Unidirectional repeatability R↓ of the backward approaches.
    #[cfg_attr(feature = "serde", serde(rename = "R_backward"))]
    pub r_backward: Option<f64>,
    /// Bidirectional systematic deviation E: the range of all x̄_i↑ and x̄_i↓.
    #[cfg_attr(feature = "serde", serde(rename = "E"))]
    pub e: Option<f64>,
    /// Unidirectional systematic deviation E↑.
    #[cfg_attr(feature = "serde", serde(rename = "E_forward"))]
    pub e_forward: Option<f64>,
    /// Unidirectional systematic deviation E↓.
    #[cfg_attr(feature = "serde", serde(rename = "E_backward"))]
    pub e_backward: Option<f64>,
    /// Mean bidirectional positioning deviation M: the range of x̄_i.
    #[cfg_attr(feature = "serde", serde(rename = "M"))]
    pub m: Option<f64>,
    /// Reversal value B = max |B_i|.
    #[cfg_attr(feature = "serde", serde(rename = "B"))]
    pub b: Option<f64>,
    /// Mean reversal value B̄, signed.
    #[cfg_attr(feature = "serde", serde(rename = "mean_B"))]
    pub mean_b: Option<f64>,
    /// Runs and readings that differ from the others; nothing is removed.
    pub outlier_hints: Vec<OutlierHint>,
}

/// Evaluates positioning readings by ISO 230-2. The editions from 1997 to 2014 have the same formulas.
///
/// # Errors
///
/// No readings, readings that are not finite, or a target that lacks readings in a direction that was measured.
pub fn evaluate(measurement: &Measurement) -> Result<Iso230Part2, MetrologyError> {
    check_readings(measurement)?;
    measurement.check_directions()?;
    let targets = measurement.by_target().iter().map(target_row).collect::<Vec<_>>();
    let forward = direction_summary(targets.iter().map(|row| row.forward));
    let backward = direction_summary(targets.iter().map(|row| row.backward));
    let both = direction_summary(targets.iter().flat_map(|row| [row.forward, row.backward]));
    let reversals: Option<Vec<f64>> = targets.iter().map(|row| row.reversal).collect();
    let means: Option<Vec<f64>> = targets.iter().map(|row| row.mean).collect();
    let repeatabilities: Option<Vec<f64>> = targets.iter().map(|row| row.repeatability).collect();
    Ok(Iso230Part2 {
        unit: measurement.unit,
        a: both.accuracy,
        a_forward: forward.accuracy,
        a_backward: backward.accuracy,
        r: repeatabilities.and_then(|r| largest(&r)),
        r_forward: forward.repeatability,
        r_backward: backward.repeatability,
        e: both.systematic,
        e_forward: forward.systematic,
        e_backward: backward.systematic,
        m: means.and_then(|x| range(&x)),
        b: reversals.as_ref().and_then(|b| largest(&b.iter().map(|b| b.abs()).collect::<Vec<_>>())),
        mean_b: reversals.and_then(|b| mean(&b)),
        outlier_hints: outlier_hints(measurement),
        targets,
    })
}

fn check_readings(measurement: &Measurement) -> Result<(), MetrologyError> {
    let refuse = |found: &str, expected: &str| {
        let name = measurement.name.as_str();
        Err(MetrologyError::readings(name, "readings", found, expected))
    };
    if measurement.readings.is_empty() {
        return refuse("none", "at least one reading");
    }
    let sound = |x: f64| x.abs() <= LARGEST;
    let unsound = |r: &&Reading| !sound(r.target) || !sound(r.deviation);
    match measurement.readings.iter().find(unsound) {
        Some(r) => refuse(
            &format!("deviation {} at target {}", r.deviation, r.target),
            "finite numbers, at most 1e12",
        ),
        None => Ok(()),
    }
}

fn target_row(readings: &TargetReadings) -> TargetRow {
    let [forward, backward] =
        Direction::BOTH.map(|direction| approach(&readings.deviations(direction)));
    let pair = forward.zip(backward);
    TargetRow {
        target: readings.target,
        forward,
        backward,
        reversal: pair.map(|(up, down)| up.mean - down.mean),
        repeatability: pair.and_then(|(up, down)| bidirectional_repeatability(&up, &down)),
        mean: pair.map(|(up, down)| f64::midpoint(up.mean, down.mean)),
    }
}

pub(crate) fn approach(deviations: &[f64]) -> Option<Approach> {
    let (n, mean) = (deviations.len(), mean(deviations)?);
    let sum_of_squares: f64 = deviations.iter().map(|x| (x - mean).powi(2)).sum();
    let s = (n > 1).then(|| (sum_of_squares / (n - 1) as f64).sqrt());
    Some(Approach { n, mean, s, repeatability: s.map(|s| 4.0 * s) })
}

fn bidirectional_repeatability(up: &Approach, down: &Approach) -> Option<f64> {
    let (s_up, s_down) = (up.s?, down.s?);
    let across = 2.0 * s_up + 2.0 * s_down + (up.mean - down.mean).abs();
    Some(across.max(4.0 * s_up).max(4.0 * s_down))
}

struct DirectionSummary {
    accuracy: Option<f64>,
    repeatability: Option<f64>,
    systematic: Option<f64>,
}

/// Accuracy A, largest repeatability 4 s_i and systematic deviation E over these approaches. All are `None` if an
/// approach is missing. A and 4 s_i are also `None` if an approach has no s.
fn direction_summary(approaches: impl Iterator<Item = Option<Approach>>) -> DirectionSummary {
    let all: Option<Vec<Approach>> = approaches.collect();
    let means = all.as_ref().map(|all| all.iter().map(|x| x.mean).collect::<Vec<_>>());
    let limits = all.as_ref().and_then(|all| {
        let limits = all.iter().map(|x| x.s.map(|s| [x.mean - 2.0 * s, x.mean + 2.0 * s]));
        limits.collect::<Option<Vec<_>>>()
    });
    let repeatabilities: Option<Vec<f64>> =
        all.and_then(|all| all.iter().map(|x| x.repeatability).collect());
    DirectionSummary {
        accuracy: limits.and_then(|limits| range(limits.as_flattened())),
        repeatability: repeatabilities.and_then(|r| largest(&r)),
        systematic: means.and_then(|x| range(&x)),
    }
}

fn largest(values: &[f64]) -> Option<f64> {
    values.iter().copied().reduce(f64::max)
}

fn range(values: &[f64]) -> Option<f64> {
    Some(largest(values)? - values.iter().copied().reduce(f64::min)?)
}
