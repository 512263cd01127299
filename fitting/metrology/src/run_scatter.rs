//! Scatter of readings of the same targets from run to run.

use std::collections::BTreeMap;

use crate::{Measurement, Reading, ReferenceLine};

/// Alignment that is specific to each run and does not count as scatter: an instrument is zeroed, and a straightness reference aligned, before each
/// run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OfRun {
    /// Zero offset.
    Zero,
    /// Zero offset and slope.
    Line,
}

/// Scatter of mean readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunScatter {
    /// Standard deviation of the mean reading of a target in one direction, µm or µrad.
    pub deviation: f64,
    /// Degrees of freedom of the standard deviation.
    pub freedom: f64,
}

impl Measurement {
    /// Standard deviation of a mean reading, pooled over targets and directions after removing the alignment of each run; `None` without repeated
    /// runs, or without scatter. If not all runs hold all targets, it is estimated from the part of them that is complete.
    pub fn scatter_of_mean(&self, of_run: OfRun) -> Option<RunScatter> {
        let parameters = match of_run {
            OfRun::Zero => 1,
            OfRun::Line => 2,
        };
        // Sort once: a search for the readings of each target takes seconds with ten thousand targets.
        let mut sorted = self.complete_readings(parameters);
        let place = |of: &Reading| of.direction as usize;
        sorted.sort_by(|a, b| (a.target.total_cmp(&b.target)).then(place(a).cmp(&place(b))));
        let mut freedom = 0.0;
        let mut runs: [BTreeMap<u32, Vec<(f64, f64)>>; 2] = Default::default();
        for here in sorted.chunk_by(|a, b| a.target == b.target && a.direction == b.direction) {
            let n = here.len() as f64;
            let mean = here.iter().map(|r| r.deviation).sum::<f64>() / n;
            for reading in here {
                let run = runs[place(reading)].entry(reading.run).or_default();
                run.push((reading.target, reading.deviation - mean));
            }
            freedom += n - 1.0;
        }
        for runs in &runs {
            freedom -= parameters as f64 * (runs.len() as f64 - 1.0).max(0.0);
        }
        let all = runs.iter().flat_map(BTreeMap::values);
        let squares: f64 = all.map(|run| squares_without(run, of_run)).sum();
        let variance = squares / freedom / self.readings_per_target();
        // Least squares of exactly straight lines leaves rounding errors.
        let largest = self.readings.iter().map(|r| r.deviation.abs());
        let rounding = (1e-12 * largest.fold(0.0, f64::max)).powi(2);
        (freedom > 0.0 && variance > rounding && variance.is_finite()).then(|| RunScatter {
            deviation: variance.sqrt(),
            freedom,
        })
    }
}

/// Sum of the squared residuals of a run after removing its alignment.
fn squares_without(run: &[(f64, f64)], of_run: OfRun) -> f64 {
    if of_run == OfRun::Line
        && let Ok(line) = ReferenceLine::least_squares(run)
    {
        return line.removed_from(run).iter().map(|(_, v)| v * v).sum();
    }
    let mean = run.iter().map(|(_, v)| v).sum::<f64>() / run.len() as f64;
    run.iter().map(|(_, v)| (v - mean).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use crate::Direction;

    use super::*;

    /// Three runs with zeros and slopes of their own, and of each a pattern of ±1 beside its line: without lines
    /// s² = 8 / (12 − 4), of the mean of three a third of it.
    #[test]
    fn zeros_and_slopes_of_runs_are_no_scatter() {
        let reading = |run: u32, place: u32| {
            let pattern = [1.0, -1.0, -1.0, 1.0, 0.0, 0.0][place as usize];
            let times = [1.0, -1.0, 0.0][run as usize];
            let (zero, slope) = (
                [5.0, -3.0, 40.0][run as usize],
                [0.1, -0.2, 0.3][run as usize],
            );
            // The pattern has no mean and no slope over these targets.
            let target = [0.0, 10.0, 20.0, 30.0, 40.0, -10.0][place as usize];
            Reading {
                target,
                run,
                direction: Direction::Positive,
                deviation: zero + slope * target + times * pattern,
            }
        };
        let readings = (0..3).flat_map(|run| (0..6).map(move |at| reading(run, at)));
        let mut measurement = Measurement {
            readings: readings.collect(),
            ..Measurement::default()
        };
        let of_lines = measurement.scatter_of_mean(OfRun::Line).expect("a scatter");
        let expected = (8.0 / 8.0_f64 / 3.0).sqrt();
        assert!(
            (of_lines.deviation - expected).abs() < 1e-12,
            "{of_lines:?}"
        );
        assert_eq!(of_lines.freedom, 12.0 - 4.0);
        let of_zeros = measurement.scatter_of_mean(OfRun::Zero).expect("a scatter");
        assert!(of_zeros.deviation > 1.0);
        measurement.readings.retain(|reading| reading.run == 2);
        assert_eq!(measurement.scatter_of_mean(OfRun::Line), None);
    }
}
