//! Hints at runs and readings that differ from the others. They inform; nothing is ever removed.

use std::collections::BTreeMap;

use crate::{Direction, Measurement};

/// A run or a reading that a person should look at.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OutlierHint {
    /// Number of the run among those of its direction.
    pub run: u32,
    /// Direction of the run.
    pub direction: Direction,
    /// The target of a single reading, mm or deg; `None` for a whole run.
    pub target: Option<f64>,
    /// Difference from the median of the runs, in the measurement's unit: signed for a reading, root mean square
    /// over the targets for a run.
    pub size: f64,
    /// The same in words.
    pub text: String,
}

/// A reading is pointed at when it differs from the median of the runs by more than this many scatters.
const READING_LIMIT: f64 = 6.0;

/// With fewer runs nobody can tell which one is wrong.
const FEWEST_RUNS: usize = 3;

/// Points at runs, and at single readings of other runs, that differ from the rest.
///
/// Each reading is compared with the median of all runs at its target and direction; the scatter is estimated from
/// the lower quartile of the differences between runs (one bad run of three does not hide itself), never
/// below the resolution of the readings. Limits: 6 scatters for a reading, 2 + 4/√targets for the root mean square of
/// a run; Gaussian readings of 5 runs each way at 21 targets give no hint in 99 % of tests. Directions with fewer than
/// three runs are passed over.
pub fn outlier_hints(measurement: &Measurement) -> Vec<OutlierHint> {
    let residuals = residuals(measurement);
    let Some(scatter) = scatter(measurement) else {
        return Vec::new();
    };
    let mut runs: BTreeMap<(Direction, u32), Vec<&Residual>> = BTreeMap::new();
    for residual in &residuals {
        runs.entry((residual.direction, residual.run))
            .or_default()
            .push(residual);
    }
    let unit = measurement
        .unit
        .map(|u| format!(" {u}"))
        .unwrap_or_default();
    let mut hints = Vec::new();
    for ((direction, run), residuals) in runs {
        let count = residuals.len() as f64;
        let rms = (residuals.iter().map(|r| r.value.powi(2)).sum::<f64>() / count).sqrt();
        if rms > (2.0 + 4.0 / count.sqrt()) * scatter {
            let text = format!(
                "{} run {run} differs from the other runs by {rms:.2}{unit} (root mean square; usual scatter {scatter:.2}{unit})",
                direction.name()
            );
            hints.push(OutlierHint {
                run,
                direction,
                target: None,
                size: rms,
                text,
            });
            continue;
        }
        for residual in residuals
            .iter()
            .filter(|r| r.value.abs() > READING_LIMIT * scatter)
        {
            let Residual { target, value, .. } = residual;
            let text = format!(
                "target {target} in {} run {run} differs from the other runs by {value:.2}{unit} (usual scatter {scatter:.2}{unit})",
                direction.name()
            );
            hints.push(OutlierHint {
                run,
                direction,
                target: Some(*target),
                size: *value,
                text,
            });
        }
    }
    hints
}

/// A reading minus the median of its target and direction.
struct Residual {
    target: f64,
    run: u32,
    direction: Direction,
    value: f64,
}

fn residuals(measurement: &Measurement) -> Vec<Residual> {
    let mut residuals = Vec::new();
    for at_target in measurement.by_target() {
        for direction in Direction::BOTH {
            let readings = at_target.of(direction);
            if readings.len() < FEWEST_RUNS {
                continue;
            }
            let median = median(at_target.deviations(direction));
            residuals.extend(readings.iter().map(|(run, deviation)| Residual {
                target: at_target.target,
                run: *run,
                direction,
                value: deviation - median,
            }));
        }
    }
    residuals
}

/// Standard deviation of a reading about its target's mean, insensitive to single runs and readings.
fn scatter(measurement: &Measurement) -> Option<f64> {
    // All pairs of five runs; more runs add neighbours only, so that the work stays linear.
    const FARTHEST_RUN: usize = 4;
    // Lower quartile of |a − b| for two Gaussian readings of standard deviation 1.
    const QUARTILE_OF_GAUSSIAN: f64 = 0.450_624;
    let mut differences: Vec<f64> = Vec::new();
    for at_target in measurement.by_target() {
        for direction in Direction::BOTH {
            let deviations = at_target.deviations(direction);
            if deviations.len() < FEWEST_RUNS {
                continue;
            }
            for apart in 1..=FARTHEST_RUN {
                let pairs = deviations.iter().zip(deviations.iter().skip(apart));
                differences.extend(pairs.map(|(a, b)| (a - b).abs()));
            }
        }
    }
    differences.sort_by(f64::total_cmp);
    let quartile = differences.get(differences.len() / 4)?;
    Some((quartile / QUARTILE_OF_GAUSSIAN).max(smallest_scatter(measurement)))
}

/// Rounded readings often coincide; their scatter is not below the rounding step's share, nor below 0.05 µm or µrad.
fn smallest_scatter(measurement: &Measurement) -> f64 {
    const STEPS: [f64; 4] = [10.0, 1.0, 0.1, 0.01];
    const SHARE: f64 = 0.6;
    const SMALLEST: f64 = 0.05;
    let is_multiple = |x: f64, step: f64| (x / step - (x / step).round()).abs() < 1e-6;
    let all_are = |step: &&f64| {
        measurement
            .readings
            .iter()
            .all(|r| is_multiple(r.deviation, **step))
    };
    STEPS
        .iter()
        .find(all_are)
        .map_or(SMALLEST, |step| (SHARE * step).max(SMALLEST))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let upper = values.len() / 2;
    if values.len().is_multiple_of(2) {
        f64::midpoint(values[upper - 1], values[upper])
    } else {
        values[upper]
    }
}
