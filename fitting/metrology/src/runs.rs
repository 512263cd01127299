//! Runs of a measurement: their alignment if some runs lack targets, and their scatter.
//!
//! An instrument is zeroed before each run, so each run has a constant offset. A straightness reference is also
//! realigned, so each run has a slope too. The mean of complete runs contains the mean of these lines. If a run lacks a
//! target, the mean at this target lacks its line, and the mean would have a step although no run has one. In that case
//! the lines of the passes are fitted (`Passes`) and removed.

use std::borrow::Cow;

use crate::passes::{Passes, RunAlignment};
use crate::{
    DeviationUnit, Direction, Measurement, MetrologyError, Quantity, Reading, ReferenceLine,
};

/// Maximum number of runs that a message names individually.
const MAX_NAMED: usize = 3;

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Alignment {
    pub(crate) passes: [Passes; 2],
    /// Lines of the passes of each direction; `None` if the plain means are correct. If the plain means of one
    /// direction are not correct, the lines of both directions are stored, for the scatter of the runs.
    pub(crate) lines: [Option<Vec<ReferenceLine>>; 2],
    /// Weight of each run in the averaged line, which remains in the means. If any run was made in both directions, the
    /// weight of a run made in one direction is 0.
    pub(crate) weights: [Vec<f64>; 2],
    /// Kind of alignment that was removed. It is the offset if the slopes cannot be determined.
    pub(crate) kind: RunAlignment,
}

impl Alignment {
    pub(crate) fn of(readings: &[Reading], kind: RunAlignment) -> Self {
        let passes = Direction::BOTH.map(|direction| Passes::of(readings, direction));
        Self::of_passes(passes, kind)
    }

    pub(crate) fn of_passes(passes: [Passes; 2], kind: RunAlignment) -> Self {
        let kind = determined(&passes, kind);
        let [forward, backward] = &passes;
        let is_backward = |run: &&u32| backward.runs.binary_search(run).is_ok();
        let both_ways: Vec<u32> = forward.runs.iter().filter(is_backward).copied().collect();
        let spreads = passes.each_ref().map(|of| match kind {
            RunAlignment::Offset => vec![1.0; of.runs.len()],
            RunAlignment::Line => of.spreads(),
        });
        // A run has the same weight in both directions. Otherwise its line would appear as a reversal.
        let weight = |run: &u32| {
            let places = passes.each_ref().map(|of| of.runs.binary_search(run).ok());
            let spreads = places.iter().zip(&spreads);
            let spreads = spreads.filter_map(|(place, spreads)| place.map(|place| spreads[place]));
            spreads.fold(f64::INFINITY, f64::min)
        };
        let is_counted = |run: &u32| both_ways.is_empty() || both_ways.binary_search(run).is_ok();
        let mut is_plain = true;
        let weighed = passes.each_ref().map(|of| {
            let mut own: Vec<f64> = of.runs.iter().map(weight).collect();
            let counted: Vec<bool> = of.runs.iter().map(is_counted).collect();
            let weights_counted = own.iter().zip(&counted).filter(|(_, counted)| **counted);
            // A single target has no spread, so all weights would be 0.
            if weights_counted.map(|(weight, _)| weight).sum::<f64>() <= 0.0 {
                own.fill(1.0);
            }
            is_plain &= of.is_complete()
                && counted.iter().all(|counted| *counted)
                && own.iter().all(|weight| *weight == own[0]);
            (own, counted)
        });
        let mut weights = [Vec::new(), Vec::new()];
        let mut lines = [None, None];
        for (direction, (own, counted)) in weighed.into_iter().enumerate() {
            if !is_plain {
                let mut found = passes[direction].least_squares(kind);
                passes[direction].zero(&mut found, &own, &counted);
                lines[direction] = Some(found);
            }
            let own = own.into_iter().zip(counted);
            weights[direction] = own.map(|(w, counted)| if counted { w } else { 0.0 }).collect();
        }
        Self { passes, lines, weights, kind }
    }

    pub(crate) fn moves(&self) -> bool {
        self.lines.iter().any(Option::is_some)
    }

    fn line_at(&self, reading: &Reading) -> f64 {
        let direction = reading.direction as usize;
        let place = self.passes[direction].runs.binary_search(&reading.run);
        let lines = self.lines[direction].as_ref();
        let line = place.ok().zip(lines);
        line.map_or(0.0, |(place, lines)| lines[place].value_um(reading.target))
    }
}

/// The alignment that the passes determine: `kind`, or offsets if `kind` is lines and the line of a pass cannot be
/// determined.
fn determined(passes: &[Passes; 2], kind: RunAlignment) -> RunAlignment {
    let mut passes = passes.iter();
    if kind == RunAlignment::Line && passes.any(|of| !of.without_line().is_empty()) {
        return RunAlignment::Offset;
    }
    kind
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
    /// Alignment of the runs: a line for straightness in lengths, otherwise an offset.
    fn run_alignment(&self) -> RunAlignment {
        let is_straightness = self.quantity == Some(Quantity::Straightness);
        if is_straightness && self.unit != Some(DeviationUnit::Urad) {
            RunAlignment::Line
        } else {
            RunAlignment::Offset
        }
    }

    pub(crate) fn alignment(&self) -> Alignment {
        Alignment::of(&self.readings, self.run_alignment())
    }

    /// Readings for a curve fit. If the plain means are valid, the readings are unchanged. Otherwise the fitted offset
    /// (for straightness: line) of each run is subtracted, relative to the weighted mean of the runs.
    pub(crate) fn aligned_readings(&self) -> Cow<'_, [Reading]> {
        let alignment = self.alignment();
        if !alignment.moves() {
            return Cow::Borrowed(&self.readings);
        }
        let aligned = self.readings.iter().map(|reading| Reading {
            deviation: reading.deviation - alignment.line_at(reading),
            ..*reading
        });
        aligned.collect()
    }

    /// Checks that straightness runs with missing targets can be aligned by offset and slope. Without the slopes, the
    /// mean would have a step at the end of a run.
    ///
    /// # Errors
    ///
    /// The runs whose lines cannot be determined.
    pub fn check_lines_of_runs(&self) -> Result<(), MetrologyError> {
        if self.run_alignment() == RunAlignment::Offset {
            return Ok(());
        }
        for direction in Direction::BOTH {
            let unknown = Passes::of(&self.readings, direction).without_line();
            if !unknown.is_empty() {
                return Err(MetrologyError::RunLineUnknown {
                    name: self.name.clone(),
                    runs: listed(&unknown),
                    direction,
                });
            }
        }
        Ok(())
    }
}

pub(crate) fn alignment_notes(readings: &[Reading]) -> Vec<String> {
    let alignment = Alignment::of(readings, RunAlignment::Offset);
    let mut notes = Vec::new();
    if alignment.moves() {
        notes.push("not all runs hold all targets: for curves the runs are aligned at common targets, by their offsets and for straightness also by their slopes; ISO 230-2 uses the readings as they are".to_owned());
    }
    for (passes, direction) in alignment.passes.iter().zip(Direction::BOTH) {
        let first_runs = passes.first_of_groups();
        if first_runs.len() > 1 {
            notes.push(format!(
                "runs {} {direction} have no common target, not even through other runs: their offsets are unknown, so the curve may have a false step between their targets",
                listed(&first_runs),
            ));
        }
    }
    notes
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunScatter {
    /// Standard deviation, µm or µrad.
    pub deviation: f64,
    /// Degrees of freedom of the standard deviation.
    pub freedom: f64,
}

/// Standard deviation of a reading, pooled over targets and directions after the lines of the passes are subtracted;
/// `None` without degrees of freedom.
pub(crate) fn pooled_scatter(passes: &[Passes; 2], alignment: RunAlignment) -> Option<RunScatter> {
    let (mut squares, mut freedom) = (0.0, 0.0);
    for passes in passes {
        let own = passes.squares(alignment);
        squares += own.0;
        freedom += own.1;
    }
    (freedom > 0.0).then(|| RunScatter { deviation: (squares / freedom).sqrt(), freedom })
}

impl Measurement {
    /// Standard deviation of the mean reading of a target in one direction, for the target with the fewest readings. It
    /// is pooled over targets and directions after the alignment of each run is removed. If runs lack targets and their
    /// slopes cannot be determined, only the offset is removed. `None` without repeated runs, or without scatter.
    pub fn scatter_of_mean(&self, alignment: RunAlignment) -> Option<RunScatter> {
        let passes = Direction::BOTH.map(|direction| Passes::of(&self.readings, direction));
        let scatter = pooled_scatter(&passes, determined(&passes, alignment))?;
        let targets = passes.iter().flat_map(|of| &of.targets);
        let fewest = targets.map(|(_, cells)| cells.len()).min().unwrap_or(0);
        let deviation = scatter.deviation / (fewest as f64).sqrt();
        // For exactly straight lines, least squares leaves rounding errors.
        let largest = self.readings.iter().map(|r| r.deviation.abs());
        let rounding = 1e-12 * largest.fold(0.0, f64::max);
        (deviation > rounding && deviation.is_finite())
            .then_some(RunScatter { deviation, freedom: scatter.freedom })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three runs with different offsets and slopes, each with a pattern of ±1 about its line. After the lines are
    /// subtracted, s² = 8 / (12 − 4), and the variance of the mean of three runs is a third of s².
    #[test]
    fn offsets_and_slopes_of_runs_are_not_scatter() {
        let reading = |run: u32, place: u32| {
            let pattern = [1.0, -1.0, -1.0, 1.0, 0.0, 0.0][place as usize];
            let times = [1.0, -1.0, 0.0][run as usize];
            let (zero, slope) = ([5.0, -3.0, 40.0][run as usize], [0.1, -0.2, 0.3][run as usize]);
            // Over these targets the pattern has no mean and no slope.
            let target = [0.0, 10.0, 20.0, 30.0, 40.0, -10.0][place as usize];
            Reading {
                target,
                run,
                direction: Direction::Positive,
                deviation: zero + slope * target + times * pattern,
            }
        };
        let readings = (0..3).flat_map(|run| (0..6).map(move |at| reading(run, at)));
        let mut measurement =
            Measurement { readings: readings.collect(), ..Measurement::default() };
        let of_lines = measurement.scatter_of_mean(RunAlignment::Line).expect("a scatter");
        let expected = (8.0 / 8.0_f64 / 3.0).sqrt();
        assert!((of_lines.deviation - expected).abs() < 1e-12, "{of_lines:?}");
        assert_eq!(of_lines.freedom, 12.0 - 4.0);
        let of_zeros = measurement.scatter_of_mean(RunAlignment::Offset).expect("a scatter");
        assert!(of_zeros.deviation > 1.0);
        measurement.readings.retain(|reading| reading.run == 2);
        assert_eq!(measurement.scatter_of_mean(RunAlignment::Line), None);
    }
}
