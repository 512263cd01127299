//! Runs of a measurement: alignment by their offsets where not all runs hold all targets, and their scatter.
//!
//! An instrument is zeroed for each run, so a run is shifted by a constant. The mean of complete runs is shifted by the mean of these constants. Where a
//! run lacks a target, the mean would step by offset / number of runs, although no run has a step. There the readings are fitted with
//! reading = mean of the target + offset of the pass (least squares, unbalanced two-way layout), and the offsets are removed.
//!
//! A pass is one run in one direction. Passes have separate offsets, because the zero may drift between both directions. The offsets of a
//! direction add up to zero over the runs that were made in both directions: the reversal is the mean of the reversals of these runs.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use crate::{Direction, Measurement, Reading, ReferenceLine};

/// Maximum number of steps of the conjugate gradients. They end after as many steps as there are passes with different targets.
const MAX_STEPS: usize = 1000;
/// Relative residual at which the offsets are final.
const CONVERGED: f64 = 1e-13;
/// Maximum number of readings of completed runs in one direction.
const MAX_COMPLETED: usize = 10_000_000;
const MAX_NAMED: usize = 3;

struct Passes {
    direction: Direction,
    /// Numbers of the runs, ascending.
    runs: Vec<u32>,
    /// Targets, ascending, with their readings: index of the run in `runs`, ascending, and deviation.
    targets: Vec<(f64, Vec<(usize, f64)>)>,
}

impl Passes {
    fn of(readings: &[Reading], direction: Direction) -> Self {
        let in_direction = readings.iter().filter(|r| r.direction == direction);
        let mut sorted: Vec<&Reading> = in_direction.collect();
        sorted.sort_by(|a, b| a.target.total_cmp(&b.target).then(a.run.cmp(&b.run)));
        let mut runs: Vec<u32> = sorted.iter().map(|r| r.run).collect();
        runs.sort_unstable();
        runs.dedup();
        let cell = |reading: &&Reading| {
            let index = runs.partition_point(|run| *run < reading.run);
            (index, reading.deviation)
        };
        let at_target = sorted.chunk_by(|a, b| a.target == b.target);
        let targets = at_target
            .map(|readings| (readings[0].target, readings.iter().map(cell).collect()))
            .collect();
        Self {
            direction,
            runs,
            targets,
        }
    }

    /// Whether each run holds each target once.
    fn is_complete(&self) -> bool {
        let mut targets = self.targets.iter();
        targets.all(|(_, cells)| cells.iter().map(|(run, _)| *run).eq(0..self.runs.len()))
    }

    /// Offset of each run; `None` if the plain means are right. `both_ways`: the runs that were made in both directions.
    fn offsets(&self, both_ways: &[u32]) -> Option<Vec<f64>> {
        if self.is_complete() && (both_ways.is_empty() || both_ways == self.runs) {
            return None;
        }
        let mut offsets = self.least_squares();
        let groups = self.groups();
        let is_both_ways: Vec<bool> = (self.runs.iter())
            .map(|run| both_ways.binary_search(run).is_ok())
            .collect();
        let mut has_both_ways = vec![false; groups.len()];
        for (group, both_ways) in groups.iter().zip(&is_both_ways) {
            has_both_ways[*group] |= both_ways;
        }
        let mut zeros = vec![(0.0, 0.0); groups.len()];
        for (run, &group) in groups.iter().enumerate() {
            if is_both_ways[run] || !has_both_ways[group] {
                zeros[group].0 += offsets[run];
                zeros[group].1 += 1.0;
            }
        }
        for (offset, group) in offsets.iter_mut().zip(groups) {
            let (sum, count) = zeros[group];
            *offset -= sum / count;
        }
        Some(offsets)
    }

    /// Least-squares offsets, undetermined by a constant for each group of runs. The normal equations L o = b, with the means of the targets eliminated,
    /// are solved by conjugate gradients.
    fn least_squares(&self) -> Vec<f64> {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut offsets = vec![0.0; self.runs.len()];
        let mut residual = self.about_means(|_, deviation| deviation);
        let mut search = residual.clone();
        let mut squares = dot(&residual, &residual);
        let converged = CONVERGED * CONVERGED * squares;
        for _ in 0..MAX_STEPS {
            let product = self.about_means(|run, _| search[run]);
            let curvature = dot(&search, &product);
            // Both also end it for readings that are not finite.
            if !(squares > converged && curvature > 0.0) {
                break;
            }
            let step = squares / curvature;
            for run in 0..offsets.len() {
                offsets[run] += step * search[run];
                residual[run] -= step * product[run];
            }
            let before = std::mem::replace(&mut squares, dot(&residual, &residual));
            for (search, residual) in search.iter_mut().zip(&residual) {
                *search = residual + squares / before * *search;
            }
        }
        offsets
    }

    fn predicted(&self, offsets: &[f64]) -> Vec<Reading> {
        let groups = self.groups();
        let mut predicted = Vec::new();
        for (target, cells) in &self.targets {
            let aligned = cells
                .iter()
                .map(|(run, deviation)| deviation - offsets[*run]);
            let mean = aligned.sum::<f64>() / cells.len() as f64;
            let mut held = vec![false; self.runs.len()];
            for (run, _) in cells {
                held[*run] = true;
            }
            let group = groups[cells[0].0];
            let lacking = (0..held.len()).filter(|run| !held[*run] && groups[*run] == group);
            predicted.extend(lacking.map(|run| Reading {
                target: *target,
                run: self.runs[run],
                direction: self.direction,
                deviation: mean + offsets[run],
            }));
        }
        predicted
    }

    /// Sum over the readings of each run of a value minus its mean at the target.
    fn about_means(&self, value: impl Fn(usize, f64) -> f64) -> Vec<f64> {
        let mut sums = vec![0.0; self.runs.len()];
        for (_, cells) in &self.targets {
            let values = cells.iter().map(|(run, deviation)| value(*run, *deviation));
            let mean = values.sum::<f64>() / cells.len() as f64;
            for (run, deviation) in cells {
                sums[*run] += value(*run, *deviation) - mean;
            }
        }
        sums
    }

    /// For each run the first run that is connected with it by common targets, directly or through other runs.
    fn groups(&self) -> Vec<usize> {
        fn first_of(groups: &mut [usize], mut run: usize) -> usize {
            while groups[run] != run {
                groups[run] = groups[groups[run]];
                run = groups[run];
            }
            run
        }
        let mut groups: Vec<usize> = (0..self.runs.len()).collect();
        for (_, cells) in &self.targets {
            for pair in cells.windows(2) {
                let [a, b] = [pair[0].0, pair[1].0].map(|run| first_of(&mut groups, run));
                groups[a.max(b)] = a.min(b);
            }
        }
        (0..groups.len())
            .map(|run| first_of(&mut groups, run))
            .collect()
    }

    /// Runs and targets of the part in which each of the runs holds each of the targets, chosen for the most degrees of freedom that are left by
    /// `parameters` fitted to each run.
    fn complete_part(&self, parameters: usize) -> (BTreeSet<u32>, BTreeSet<u64>) {
        let mut held = vec![0_usize; self.runs.len()];
        for (run, _) in self.targets.iter().flat_map(|(_, cells)| cells) {
            held[*run] += 1;
        }
        let mut by_held: Vec<usize> = (0..held.len()).collect();
        by_held.sort_by_key(|run| std::cmp::Reverse(held[*run]));
        let mut places = vec![0; held.len()];
        for (place, run) in by_held.iter().enumerate() {
            places[*run] = place;
        }
        // Number of runs, in this order, that hold a target before the first one that lacks it.
        let runs_at = |(_, cells): &(f64, Vec<(usize, f64)>)| -> usize {
            let mut here: Vec<usize> = cells.iter().map(|(run, _)| places[*run]).collect();
            here.sort_unstable();
            here.iter().zip(0..).take_while(|(a, b)| **a == *b).count()
        };
        let runs_at: Vec<usize> = self.targets.iter().map(runs_at).collect();
        let mut targets_of = vec![0_usize; held.len() + 1];
        for runs in &runs_at {
            targets_of[*runs] += 1;
        }
        let (mut best, mut most, mut targets) = (0, 0, 0);
        for runs in (1..=held.len()).rev() {
            targets += targets_of[runs];
            let freedom = (runs - 1) * targets.saturating_sub(parameters);
            if freedom > most {
                (best, most) = (runs, freedom);
            }
        }
        let runs = by_held[..best].iter().map(|run| self.runs[*run]);
        let at = self.targets.iter().zip(&runs_at);
        let at = at.filter(|(_, runs)| best > 0 && **runs >= best);
        (
            runs.collect(),
            at.map(|((target, _), _)| key(*target)).collect(),
        )
    }

    fn unconnected(&self) -> Option<String> {
        let groups = self.groups();
        let first_runs = (0..groups.len()).filter(|run| groups[*run] == *run);
        let first_runs: Vec<u32> = first_runs.map(|run| self.runs[run]).collect();
        (first_runs.len() > 1).then(|| {
            format!(
                "runs {} {} have no common target, not even through other runs: their offsets are unknown, so the curve may have a false step between their targets",
                listed(&first_runs),
                self.direction
            )
        })
    }
}

struct Alignment {
    passes: [Passes; 2],
    /// `None` for a direction whose plain means are right.
    offsets: [Option<Vec<f64>>; 2],
}

impl Alignment {
    fn of(readings: &[Reading]) -> Self {
        let passes = Direction::BOTH.map(|direction| Passes::of(readings, direction));
        let [forward, backward] = &passes;
        let is_backward = |run: &&u32| backward.runs.binary_search(run).is_ok();
        let both_ways: Vec<u32> = forward.runs.iter().filter(is_backward).copied().collect();
        let offsets = passes.each_ref().map(|of| of.offsets(&both_ways));
        Self { passes, offsets }
    }

    fn moves(&self) -> bool {
        self.offsets.iter().any(Option::is_some)
    }

    fn offset(&self, reading: &Reading) -> f64 {
        let direction = reading.direction as usize;
        let place = self.passes[direction].runs.binary_search(&reading.run);
        let offsets = self.offsets[direction].as_ref();
        let offset = place.ok().zip(offsets);
        offset.map_or(0.0, |(place, offsets)| offsets[place])
    }
}

/// A target as a key; −0.0 and 0.0 are one target.
fn key(target: f64) -> u64 {
    (target + 0.0).to_bits()
}

fn listed(runs: &[u32]) -> String {
    let named: Vec<String> = runs.iter().take(MAX_NAMED).map(u32::to_string).collect();
    let named = named.join(", ");
    match runs.len().saturating_sub(MAX_NAMED) {
        0 => named,
        more => format!("{named} and {more} more"),
    }
}

impl Measurement {
    /// The readings for a curve: without the offsets of the passes if not all runs hold all targets, otherwise as they are.
    pub(crate) fn aligned_readings(&self) -> Cow<'_, [Reading]> {
        let alignment = Alignment::of(&self.readings);
        if !alignment.moves() {
            return Cow::Borrowed(&self.readings);
        }
        let aligned = self.readings.iter().map(|reading| Reading {
            deviation: reading.deviation - alignment.offset(reading),
            ..*reading
        });
        aligned.collect()
    }

    /// The readings, and for each target that a pass lacks what the others predict for it: their mean, shifted by the offset of the pass. So runs can be
    /// compared as a whole. Passes without common targets predict nothing of each other; beyond ten million readings nothing is predicted.
    pub fn completed_readings(&self) -> Cow<'_, [Reading]> {
        let alignment = Alignment::of(&self.readings);
        let mut predicted = Vec::new();
        for (passes, offsets) in alignment.passes.iter().zip(&alignment.offsets) {
            let Some(offsets) = offsets else { continue };
            if passes.runs.len().saturating_mul(passes.targets.len()) <= MAX_COMPLETED {
                predicted.extend(passes.predicted(offsets));
            }
        }
        if predicted.is_empty() {
            return Cow::Borrowed(&self.readings);
        }
        Cow::Owned([&self.readings[..], &predicted].concat())
    }

    /// The readings of the complete part of each direction, in the order of the file: in it, least squares need no iteration to separate the means of
    /// the targets from `parameters` of each run. All readings if the runs are complete.
    pub(crate) fn complete_readings(&self, parameters: usize) -> Vec<&Reading> {
        let passes = Direction::BOTH.map(|direction| Passes::of(&self.readings, direction));
        let parts = passes.each_ref().map(|of| {
            let is_incomplete = !of.is_complete();
            is_incomplete.then(|| of.complete_part(parameters))
        });
        let is_in_part = |reading: &&Reading| {
            let part = parts[reading.direction as usize].as_ref();
            part.is_none_or(|(runs, targets)| {
                runs.contains(&reading.run) && targets.contains(&key(reading.target))
            })
        };
        self.readings.iter().filter(is_in_part).collect()
    }

    pub(crate) fn readings_per_target(&self) -> f64 {
        let passes = Direction::BOTH.map(|direction| Passes::of(&self.readings, direction));
        let targets: usize = passes.iter().map(|of| of.targets.len()).sum();
        self.readings.len() as f64 / targets as f64
    }
}

pub(crate) fn alignment_notes(readings: &[Reading]) -> Vec<String> {
    let alignment = Alignment::of(readings);
    let mut notes = Vec::new();
    if alignment.moves() {
        notes.push("not all runs hold all targets: for curves the runs are aligned by their offsets at common targets; a run of another slope leaves a step where it ends, and bands are too narrow where few runs hold a target; ISO 230-2 uses the readings as they are".to_owned());
    }
    notes.extend(alignment.passes.iter().filter_map(Passes::unconnected));
    notes
}

/// Alignment that is specific to each run and is not treated as scatter: an instrument is zeroed, and a straightness reference aligned, before each
/// run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunAlignment {
    /// Offset.
    Offset,
    /// Offset and slope.
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
    pub fn scatter_of_mean(&self, alignment: RunAlignment) -> Option<RunScatter> {
        let parameters = match alignment {
            RunAlignment::Offset => 1,
            RunAlignment::Line => 2,
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
        let squares: f64 = all.map(|run| squares_without(run, alignment)).sum();
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

fn squares_without(run: &[(f64, f64)], alignment: RunAlignment) -> f64 {
    if alignment == RunAlignment::Line
        && let Ok(line) = ReferenceLine::least_squares(run)
    {
        return line.removed_from(run).iter().map(|(_, v)| v * v).sum();
    }
    let mean = run.iter().map(|(_, v)| v).sum::<f64>() / run.len() as f64;
    run.iter().map(|(_, v)| (v - mean).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three runs with different offsets and slopes, each with a pattern of ±1 about its line: with the lines removed
    /// s² = 8 / (12 − 4), and a third of it for the mean of three.
    #[test]
    fn offsets_and_slopes_of_runs_are_not_scatter() {
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
        let of_lines = measurement
            .scatter_of_mean(RunAlignment::Line)
            .expect("a scatter");
        let expected = (8.0 / 8.0_f64 / 3.0).sqrt();
        assert!(
            (of_lines.deviation - expected).abs() < 1e-12,
            "{of_lines:?}"
        );
        assert_eq!(of_lines.freedom, 12.0 - 4.0);
        let of_zeros = measurement
            .scatter_of_mean(RunAlignment::Offset)
            .expect("a scatter");
        assert!(of_zeros.deviation > 1.0);
        measurement.readings.retain(|reading| reading.run == 2);
        assert_eq!(measurement.scatter_of_mean(RunAlignment::Line), None);
    }
}
