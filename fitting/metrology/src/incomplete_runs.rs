//! Uncertainty of the mean curve if some runs lack targets.
//!
//! Two sources vary the aligned means. The lines of the runs (zero of the instrument, slope of a straightness
//! reference) shift all means of a run together, and there are only as many lines as runs. The rest of a reading counts
//! as independent. Its scatter is pooled over all readings about the aligned means, because a target with few runs
//! shows too little of it, and a target with a single run shows none.

use std::collections::BTreeMap;

use crate::passes::{Passes, RunAlignment};
use crate::runs::{Alignment, RunScatter, pooled_scatter};
use crate::{Direction, Measurement, ReferenceLine, SlopeUncertainty};

/// Values at the targets, forward and then backward. Each list has the order of [`Measurement::mean_curve_in`].
pub type AtTargets = [Vec<f64>; 2];

/// Aligned runs of which some lack targets, with the scatter of their means.
#[derive(Clone, Debug, PartialEq)]
pub struct IncompleteRuns {
    alignment: Alignment,
    scatter: Option<RunScatter>,
    /// Shift of the means by one standard deviation of the line of each run.
    of_lines: BTreeMap<u32, AtTargets>,
    /// Shift of the means by one standard deviation of the residuals of each run, at the targets that no run lacks.
    of_residuals: BTreeMap<u32, AtTargets>,
}

impl Measurement {
    /// The aligned runs with the scatter of their means. `None` if the plain means are correct, for example because no
    /// run lacks a target.
    pub fn incomplete_runs(&self) -> Option<IncompleteRuns> {
        let alignment = self.alignment();
        alignment.moves().then(|| IncompleteRuns::of(alignment))
    }
}

impl IncompleteRuns {
    fn of(alignment: Alignment) -> Self {
        let scatter = pooled_scatter(&alignment.passes, alignment.kind);
        Self {
            of_lines: line_shifts(&alignment),
            of_residuals: residual_shifts(&alignment),
            scatter,
            alignment,
        }
    }

    /// Standard deviation of a single reading about the aligned means; `None` without degrees of freedom.
    pub fn scatter(&self) -> Option<RunScatter> {
        self.scatter
    }

    /// Targets that were measured in a direction, ascending.
    pub fn targets(&self, direction: Direction) -> impl Iterator<Item = f64> {
        let passes = &self.alignment.passes[direction as usize];
        passes.targets.iter().map(|(target, _)| *target)
    }

    /// Independent shifts of the means by the lines of the runs. The variance is the sum of the squared shifts. A
    /// single run gives none.
    pub fn shifts_by_lines(&self) -> impl Iterator<Item = &AtTargets> {
        self.of_lines.values()
    }

    /// Degrees of freedom of [`shifts_by_lines`](Self::shifts_by_lines) for these directions. If runs were made in both
    /// directions, they have one common mean. If the runs are numbered separately in the two directions, each direction
    /// has its own mean.
    pub fn freedom_of_lines(&self, directions: &[Direction]) -> usize {
        if !self.has_separate_numbers() {
            return self.of_lines.len().saturating_sub(1);
        }
        let passes = directions.iter().map(|direction| &self.alignment.passes[*direction as usize]);
        passes.map(|of| of.runs.len().saturating_sub(1)).sum()
    }

    /// Whether each run was made in one direction only.
    fn has_separate_numbers(&self) -> bool {
        let [forward, backward] = &self.alignment.passes;
        let mut runs = forward.runs.iter();
        !runs.any(|run| backward.runs.binary_search(run).is_ok())
    }

    /// Uncertainty of the slope of the mean of both directions, from the slopes of the runs. `None` with one run, or if
    /// the runs are aligned only by their offsets.
    pub(crate) fn slope_uncertainty(&self) -> Option<SlopeUncertainty> {
        if self.alignment.kind == RunAlignment::Offset {
            return None;
        }
        let slope = |by: &AtTargets| -> Option<f64> {
            let targets = self.alignment.passes.iter().flat_map(|of| &of.targets);
            let shifts = targets.map(|(target, _)| *target).zip(by.iter().flatten().copied());
            let line = ReferenceLine::least_squares(&shifts.collect::<Vec<_>>()).ok()?;
            Some(line.slope().0)
        };
        let slopes: Vec<f64> = self.of_lines.values().filter_map(slope).collect();
        let mut squares: f64 = slopes.iter().map(|slope| slope * slope).sum();
        let runs = self.alignment.passes.each_ref().map(|of| of.runs.len());
        if self.has_separate_numbers() && runs.contains(&1) {
            // A direction with a single pass does not show the scatter of its line. So take the scatter of a single
            // pass of the other direction.
            let more = shares(&self.alignment.weights[usize::from(runs[1] > runs[0])]);
            squares *= 1.0 + 1.0 / more.iter().map(|w| w * w).sum::<f64>();
        }
        let degrees = self.freedom_of_lines(&Direction::BOTH);
        (degrees > 0)
            .then(|| SlopeUncertainty { standard_urad: squares.sqrt(), degrees: degrees as f64 })
    }

    /// Change of the means if each reading changes by its standard deviation times a number from `next`.
    pub fn shifted_by_noise(&self, next: &mut impl FnMut() -> f64) -> AtTargets {
        let noise = self.noise(next);
        means(&Alignment::of_passes(noise, self.alignment.kind))
    }

    /// Sample of the change of the means. The lines and residuals of each run are multiplied by `factor(run)`, and the
    /// independent noise of the readings by numbers from `next` (standard normal). At targets that no run lacks, the
    /// readings vary with their runs, as in complete runs.
    pub fn sampled(
        &self,
        factor: impl Fn(u32) -> f64,
        next: &mut impl FnMut() -> f64,
    ) -> AtTargets {
        let noise = self.noise(next);
        let plain = noise.each_ref().map(|of| of.means(None));
        let mut shifts = means(&Alignment::of_passes(noise, self.alignment.kind));
        let targets = self.alignment.passes.iter().zip(&mut shifts).zip(plain);
        for ((passes, shifts), plain) in targets {
            for (((_, cells), shift), plain) in passes.targets.iter().zip(shifts).zip(plain) {
                // The residuals of the runs already vary these means, so the noise shifts them only through the
                // alignment.
                if passes.all_hold(cells) && cells.len() > 1 {
                    *shift -= plain;
                }
            }
        }
        for (run, by) in self.of_lines.iter().chain(&self.of_residuals) {
            let factor = factor(*run);
            for (shift, by) in shifts.iter_mut().flatten().zip(by.iter().flatten()) {
                *shift += factor * by;
            }
        }
        shifts
    }

    /// Independent noise of the readings, without the part that the lines of the passes absorb. That part is included
    /// in the scatter of the lines of the runs.
    fn noise(&self, next: &mut impl FnMut() -> f64) -> [Passes; 2] {
        let deviation = self.scatter.map_or(0.0, |scatter| scatter.deviation);
        let mut passes = self.alignment.passes.clone();
        let cells = passes.iter_mut().flat_map(|of| &mut of.targets);
        for (_, reading) in cells.flat_map(|(_, cells)| cells) {
            *reading = deviation * next();
        }
        for of in &mut passes {
            of.remove_own_lines(self.alignment.kind);
        }
        passes
    }
}

fn means(alignment: &Alignment) -> AtTargets {
    let [forward, backward] = &alignment.passes;
    let [of_forward, of_backward] = &alignment.lines;
    [forward.means(of_forward.as_deref()), backward.means(of_backward.as_deref())]
}

/// Shifts of the means by each run: its residuals at the targets that no run of the direction lacks, divided by √(n (n
/// − 1)).
fn residual_shifts(alignment: &Alignment) -> BTreeMap<u32, AtTargets> {
    let zeros = alignment.passes.each_ref().map(|of| vec![0.0; of.targets.len()]);
    let mut shifts: BTreeMap<u32, AtTargets> = BTreeMap::new();
    let means = means(alignment);
    for (direction, of) in alignment.passes.iter().enumerate() {
        let n = of.runs.len() as f64;
        for (place, (target, cells)) in of.targets.iter().enumerate() {
            if !of.all_hold(cells) || cells.len() < 2 {
                continue;
            }
            for (run, deviation) in cells {
                let lines = alignment.lines[direction].as_ref();
                let line = lines.map_or(0.0, |lines| lines[*run].value_um(*target));
                let residual = deviation - line - means[direction][place];
                let shift = shifts.entry(of.runs[*run]).or_insert_with(|| zeros.clone());
                shift[direction][place] = residual / (n * (n - 1.0)).sqrt();
            }
        }
    }
    shifts
}

/// Shifts of the means by the line of each run. A shift is the contribution of the line to the weighted mean of the
/// lines, which remains in the means.
fn line_shifts(alignment: &Alignment) -> BTreeMap<u32, AtTargets> {
    let [forward, backward] = &alignment.weights;
    let counted = |weights: &[f64]| weights.iter().filter(|weight| **weight > 0.0).count();
    let mut lines: BTreeMap<u32, [Option<ReferenceLine>; 2]> = BTreeMap::new();
    if counted(forward).max(counted(backward)) > 1 {
        for direction in 0..2 {
            for (run, line) in weighted(alignment, direction) {
                lines.entry(run).or_default()[direction] = Some(line);
            }
        }
    } else {
        // Both directions keep the line of the same run. The scatter of such lines is estimated from the direction with
        // more runs.
        let more = usize::from(alignment.passes[1].runs.len() > alignment.passes[0].runs.len());
        for (run, line) in weighted_as_one(alignment, more) {
            lines.insert(run, [Some(line); 2]);
        }
    }
    let at_targets = |lines: [Option<ReferenceLine>; 2]| -> AtTargets {
        [0, 1].map(|direction: usize| {
            let targets = alignment.passes[direction].targets.iter();
            let value = |target: f64| lines[direction].map_or(0.0, |line| line.value_um(target));
            targets.map(|(target, _)| value(*target)).collect()
        })
    };
    let lines = lines.into_iter();
    lines.map(|(run, lines)| (run, at_targets(lines))).collect()
}

/// Weighted deviations of the lines of the passes of a direction from their mean. They are scaled so that the sum of
/// their squares is the variance of the mean: w² (line − mean)² is on average w² (1 − 2 w + Σ w²) times the variance of
/// a line. Empty if the plain means are correct.
fn weighted(alignment: &Alignment, direction: usize) -> Vec<(u32, ReferenceLine)> {
    let Some(lines) = &alignment.lines[direction] else {
        return Vec::new();
    };
    let weights = shares(&alignment.weights[direction]);
    let squares: f64 = weights.iter().map(|w| w * w).sum();
    let scaled = |((line, run), weight): ((ReferenceLine, &u32), &f64)| {
        let share = 1.0 - 2.0 * weight + squares;
        (*weight > 0.0 && share > 0.0).then(|| (*run, times(line, weight / share.sqrt())))
    };
    let lines = about_mean(lines, &weights).into_iter();
    let lines = lines.zip(&alignment.passes[direction].runs);
    lines.zip(&weights).filter_map(scaled).collect()
}

/// Deviations of the lines of the passes of a direction from their mean. They are scaled so that the sum of their
/// squares is the variance of a single line.
fn weighted_as_one(alignment: &Alignment, direction: usize) -> Vec<(u32, ReferenceLine)> {
    let Some(lines) = &alignment.lines[direction] else {
        return Vec::new();
    };
    let passes = &alignment.passes[direction];
    let weights = shares(&match alignment.kind {
        RunAlignment::Offset => vec![1.0; lines.len()],
        RunAlignment::Line => passes.spreads(),
    });
    let left = 1.0 - weights.iter().map(|w| w * w).sum::<f64>();
    let scaled = |((line, run), weight): ((ReferenceLine, &u32), &f64)| {
        (left > 0.0).then(|| (*run, times(line, (weight / left).sqrt())))
    };
    let lines = about_mean(lines, &weights).into_iter().zip(&passes.runs);
    lines.zip(&weights).filter_map(scaled).collect()
}

fn shares(weights: &[f64]) -> Vec<f64> {
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|weight| weight / sum).collect()
}

fn about_mean(lines: &[ReferenceLine], shares: &[f64]) -> Vec<ReferenceLine> {
    let mean = |of: fn(&ReferenceLine) -> f64| -> f64 {
        lines.iter().zip(shares).map(|(line, share)| share * of(line)).sum()
    };
    let (slope, intercept) = (mean(|l| l.slope_um_per_mm), mean(|l| l.intercept_um));
    let about = |line: &ReferenceLine| ReferenceLine {
        slope_um_per_mm: line.slope_um_per_mm - slope,
        intercept_um: line.intercept_um - intercept,
    };
    lines.iter().map(about).collect()
}

fn times(line: ReferenceLine, factor: f64) -> ReferenceLine {
    ReferenceLine {
        slope_um_per_mm: line.slope_um_per_mm * factor,
        intercept_um: line.intercept_um * factor,
    }
}
