//! Runs of a measurement: their alignment, their scatter, and their mean curve with its uncertainty.
//!
//! An instrument is zeroed before each run, so each run has a constant offset. A straightness reference is also
//! realigned, so each run has a slope too. The mean of complete runs contains the mean of these lines. If a run lacks a
//! target, the mean at this target lacks the line of the run, and the mean would have a step although no run has a
//! step. In that case the lines of the passes are fitted (`Passes`) and removed.
//!
//! A pass is one run in one direction. Passes have separate lines, because the zero may drift between the two
//! directions. The lines of a direction add up to zero over the runs that were made in both directions. So the reversal
//! is the mean of the reversals of these runs.
//!
//! Two sources vary the aligned means. The lines of the runs (zero of the instrument, slope of a straightness
//! reference) shift all means of a run together, and there are only as many lines as runs. The rest of a reading counts
//! as independent. Its scatter is pooled over all readings about the aligned means, because a target with few runs
//! shows too little of it, and a target with a single run shows none.

use std::borrow::Cow;
use std::collections::BTreeMap;

use crate::{
    DeviationUnit, Direction, Measurement, MetrologyError, Quantity, Reading, ReferenceLine,
    SlopeUncertainty,
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

    fn of_passes(passes: [Passes; 2], kind: RunAlignment) -> Self {
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
fn pooled_scatter(passes: &[Passes; 2], alignment: RunAlignment) -> Option<RunScatter> {
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

/// Maximum number of conjugate-gradient steps per unknown. In exact arithmetic one step per unknown suffices. A chain
/// of 200 runs that overlap by half takes five.
const STEPS_PER_UNKNOWN: usize = 20;
/// Lower limit of the maximum number of conjugate-gradient steps.
const MIN_STEPS: usize = 1000;
/// Relative residual at which the conjugate gradients have converged.
const CONVERGED: f64 = 1e-13;
/// Minimum number of targets that a pass must have in common with others to determine its offset and slope, with one
/// target as a check.
const MIN_COMMON_TARGETS: usize = 3;

const ZERO: ReferenceLine = ReferenceLine { slope_um_per_mm: 0.0, intercept_um: 0.0 };

/// Misalignment of each run. It is fitted instead of counted as scatter, because before each run an instrument is
/// zeroed and a straightness reference is aligned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunAlignment {
    /// Offset of each run: the zero of the instrument.
    Offset,
    /// Offset and slope of each run, as of a straightness reference.
    Line,
}

impl RunAlignment {
    /// Number of fitted parameters of each run.
    pub(crate) fn parameters(self) -> usize {
        match self {
            Self::Offset => 1,
            Self::Line => 2,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Passes {
    /// Numbers of the runs, ascending.
    pub(crate) runs: Vec<u32>,
    /// Targets, ascending, each with its readings. A reading is the index of its run in `runs` (ascending) and the
    /// deviation.
    pub(crate) targets: Vec<(f64, Vec<(usize, f64)>)>,
}

/// Orthonormal functions over the targets of a pass: a constant, and for [`RunAlignment::Line`] a slope about the mean
/// target.
struct Basis {
    mean_target: f64,
    scales: [f64; 2],
}

impl Basis {
    fn at(&self, target: f64) -> [f64; 2] {
        let [constant, slope] = self.scales;
        [constant, slope * (target - self.mean_target)]
    }

    fn line(&self, coefficients: [f64; 2]) -> ReferenceLine {
        let slope = coefficients[1] * self.scales[1];
        ReferenceLine {
            slope_um_per_mm: slope,
            intercept_um: coefficients[0] * self.scales[0] - slope * self.mean_target,
        }
    }
}

fn dot(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a[0] * b[0] + a[1] * b[1]).sum()
}

impl Passes {
    pub(crate) fn of(readings: &[Reading], direction: Direction) -> Self {
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
        Self { runs, targets }
    }

    /// Whether every run has exactly one reading at every target.
    fn is_complete(&self) -> bool {
        let mut targets = self.targets.iter();
        targets.all(|(_, cells)| self.all_hold(cells))
    }

    /// Whether the readings at a target are exactly one reading of each run.
    fn all_hold(&self, cells: &[(usize, f64)]) -> bool {
        cells.iter().map(|(run, _)| *run).eq(0..self.runs.len())
    }

    pub(crate) fn count(&self) -> usize {
        self.targets.iter().map(|(_, cells)| cells.len()).sum()
    }

    /// Sum of the squared distances of the targets of a pass from their mean, for each pass.
    fn spreads(&self) -> Vec<f64> {
        let bases = self.bases(RunAlignment::Line);
        let of = |basis: &Basis| match basis.scales[1] {
            0.0 => 0.0,
            scale => scale.powi(-2),
        };
        bases.iter().map(of).collect()
    }

    fn bases(&self, alignment: RunAlignment) -> Vec<Basis> {
        let mut sums = vec![[0.0; 2]; self.runs.len()];
        for (target, cells) in &self.targets {
            for (run, _) in cells {
                sums[*run][0] += 1.0;
                sums[*run][1] += target;
            }
        }
        let mut bases: Vec<Basis> = (sums.iter())
            .map(|[count, sum]| Basis {
                mean_target: sum / count,
                scales: [1.0 / count.sqrt(), 0.0],
            })
            .collect();
        if alignment == RunAlignment::Line {
            let mut spreads = vec![0.0; self.runs.len()];
            for (target, cells) in &self.targets {
                for (run, _) in cells {
                    spreads[*run] += (target - bases[*run].mean_target).powi(2);
                }
            }
            for (basis, spread) in bases.iter_mut().zip(spreads) {
                if spread > 0.0 {
                    basis.scales[1] = 1.0 / spread.sqrt();
                }
            }
        }
        bases
    }

    /// Least-squares line of each pass. A line that is common to all passes of a group stays undetermined. The means of
    /// the targets are eliminated from the normal equations, which are solved by conjugate gradients.
    pub(crate) fn least_squares(&self, alignment: RunAlignment) -> Vec<ReferenceLine> {
        let bases = self.bases(alignment);
        let mut lines = vec![[0.0; 2]; bases.len()];
        let mut residual = self.about_means(&bases, |_, _, deviation| deviation);
        let mut search = residual.clone();
        let mut squares = dot(&residual, &residual);
        let converged = CONVERGED * CONVERGED * squares;
        let unknowns = self.runs.len() * alignment.parameters();
        for _ in 0..MIN_STEPS.max(STEPS_PER_UNKNOWN * unknowns) {
            let product = self.about_means(&bases, |run, [constant, slope], _| {
                search[run][0] * constant + search[run][1] * slope
            });
            let curvature = dot(&search, &product);
            // Both conditions also stop the iteration if readings are not finite.
            if !(squares > converged && curvature > 0.0) {
                break;
            }
            let step = squares / curvature;
            for run in 0..lines.len() {
                for part in 0..2 {
                    lines[run][part] += step * search[run][part];
                    residual[run][part] -= step * product[run][part];
                }
            }
            let before = std::mem::replace(&mut squares, dot(&residual, &residual));
            for (search, residual) in search.iter_mut().zip(&residual) {
                for part in 0..2 {
                    search[part] = residual[part] + squares / before * search[part];
                }
            }
        }
        bases.iter().zip(lines).map(|(b, c)| b.line(c)).collect()
    }

    /// Replaces each reading by `value` minus the mean of these values at the target, and projects the results of each
    /// run on the basis of the run.
    fn about_means(
        &self,
        bases: &[Basis],
        value: impl Fn(usize, [f64; 2], f64) -> f64,
    ) -> Vec<[f64; 2]> {
        let mut sums = vec![[0.0; 2]; self.runs.len()];
        for (target, cells) in &self.targets {
            let value = |run: usize, deviation| value(run, bases[run].at(*target), deviation);
            let values = cells.iter().map(|(run, deviation)| value(*run, *deviation));
            let mean = values.sum::<f64>() / cells.len() as f64;
            for (run, deviation) in cells {
                let left = value(*run, *deviation) - mean;
                for (sum, basis) in sums[*run].iter_mut().zip(bases[*run].at(*target)) {
                    *sum += left * basis;
                }
            }
        }
        sums
    }

    /// Subtracts from the readings of each pass its own least-squares line.
    fn remove_own_lines(&mut self, alignment: RunAlignment) {
        let bases = self.bases(alignment);
        let mut coefficients = vec![[0.0; 2]; bases.len()];
        for (target, cells) in &self.targets {
            for (run, deviation) in cells {
                let [constant, slope] = bases[*run].at(*target);
                coefficients[*run][0] += deviation * constant;
                coefficients[*run][1] += deviation * slope;
            }
        }
        let lines = bases.iter().zip(coefficients).map(|(b, c)| b.line(c));
        let lines: Vec<ReferenceLine> = lines.collect();
        for (target, cells) in &mut self.targets {
            for (run, deviation) in cells {
                *deviation -= lines[*run].value_um(*target);
            }
        }
    }

    /// Mean of each target, after the lines of the passes are subtracted.
    pub(crate) fn means(&self, lines: Option<&[ReferenceLine]>) -> Vec<f64> {
        let mean = |(target, cells): &(f64, Vec<(usize, f64)>)| {
            let aligned = cells.iter().map(|(run, deviation)| match lines {
                Some(lines) => deviation - lines[*run].value_um(*target),
                None => *deviation,
            });
            aligned.sum::<f64>() / cells.len() as f64
        };
        self.targets.iter().map(mean).collect()
    }

    /// Subtracts from the lines of each group their weighted mean over the runs with `is_counted`. In a group without
    /// such runs, the mean is over all runs.
    pub(crate) fn zero(&self, lines: &mut [ReferenceLine], weights: &[f64], is_counted: &[bool]) {
        let groups = self.groups();
        let mut has_counted = vec![false; groups.len()];
        for (group, is_counted) in groups.iter().zip(is_counted) {
            has_counted[*group] |= is_counted;
        }
        let mut zeros = vec![(ZERO, 0.0); groups.len()];
        for (run, &group) in groups.iter().enumerate() {
            if is_counted[run] || !has_counted[group] {
                let (zero, sum) = &mut zeros[group];
                zero.intercept_um += weights[run] * lines[run].intercept_um;
                zero.slope_um_per_mm += weights[run] * lines[run].slope_um_per_mm;
                *sum += weights[run];
            }
        }
        for (line, group) in lines.iter_mut().zip(groups) {
            let (zero, sum) = zeros[group];
            line.intercept_um -= zero.intercept_um / sum;
            line.slope_um_per_mm -= zero.slope_um_per_mm / sum;
        }
    }

    /// For each run, the first run of its group. The runs of a group are connected by common targets, directly or
    /// through other runs.
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
        (0..groups.len()).map(|run| first_of(&mut groups, run)).collect()
    }

    /// The first run of each group of runs that are connected by common targets.
    fn first_of_groups(&self) -> Vec<u32> {
        let groups = self.groups();
        let first_runs = (0..groups.len()).filter(|run| groups[*run] == *run);
        first_runs.map(|run| self.runs[run]).collect()
    }

    /// Runs whose lines cannot be determined, because they have too few targets in common with the others. Starting
    /// from the run with the most targets, runs are joined one after the other. Empty if no run lacks a target.
    fn without_line(&self) -> Vec<u32> {
        if self.is_complete() {
            return Vec::new();
        }
        let mut held = vec![Vec::new(); self.runs.len()];
        for (place, (_, cells)) in self.targets.iter().enumerate() {
            for (run, _) in cells {
                held[*run].push(place);
            }
        }
        held.iter_mut().for_each(Vec::dedup);
        let first = (0..held.len()).rev().max_by_key(|run| held[*run].len());
        let mut is_covered = vec![false; self.targets.len()];
        let mut joined = Vec::from_iter(first);
        let mut left: Vec<usize> = (0..held.len()).filter(|run| Some(*run) != first).collect();
        while !joined.is_empty() {
            for place in joined.iter().flat_map(|run| &held[*run]) {
                is_covered[*place] = true;
            }
            let common = |run: &usize| held[*run].iter().filter(|place| is_covered[**place]);
            (joined, left) =
                (left.into_iter()).partition(|run| common(run).count() >= MIN_COMMON_TARGETS);
        }
        left.into_iter().map(|run| self.runs[run]).collect()
    }

    /// Sum of the squared residuals of the readings, and its degrees of freedom. Residuals remain after the means of
    /// the targets and the least-squares lines of the passes are removed.
    pub(crate) fn squares(&self, alignment: RunAlignment) -> (f64, f64) {
        let lines = self.least_squares(alignment);
        let means = self.means(Some(&lines));
        let mut squares = 0.0;
        for ((target, cells), mean) in self.targets.iter().zip(means) {
            let left =
                |(run, deviation): &(usize, f64)| deviation - lines[*run].value_um(*target) - mean;
            squares += cells.iter().map(|cell| left(cell).powi(2)).sum::<f64>();
        }
        let differences = self.runs.len() - self.first_of_groups().len();
        let parameters = self.targets.len() + alignment.parameters() * differences;
        (squares, self.count() as f64 - parameters as f64)
    }
}

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
