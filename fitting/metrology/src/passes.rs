//! Least squares for passes of which some lack targets: reading = mean of the target + line of the pass (unbalanced
//! two-way layout).
//!
//! A pass is one run in one direction. Passes have separate lines, because the zero may drift between the two
//! directions. The lines of a direction add up to zero over the runs that were made in both directions. So the reversal
//! is the mean of the reversals of these runs.

use crate::{Direction, Reading, ReferenceLine};

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
    pub(crate) fn is_complete(&self) -> bool {
        let mut targets = self.targets.iter();
        targets.all(|(_, cells)| self.all_hold(cells))
    }

    /// Whether the readings at a target are exactly one reading of each run.
    pub(crate) fn all_hold(&self, cells: &[(usize, f64)]) -> bool {
        cells.iter().map(|(run, _)| *run).eq(0..self.runs.len())
    }

    pub(crate) fn count(&self) -> usize {
        self.targets.iter().map(|(_, cells)| cells.len()).sum()
    }

    /// Sum of the squared distances of the targets of a pass from their mean, for each pass.
    pub(crate) fn spreads(&self) -> Vec<f64> {
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
    pub(crate) fn remove_own_lines(&mut self, alignment: RunAlignment) {
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
    pub(crate) fn first_of_groups(&self) -> Vec<u32> {
        let groups = self.groups();
        let first_runs = (0..groups.len()).filter(|run| groups[*run] == *run);
        first_runs.map(|run| self.runs[run]).collect()
    }

    /// Runs whose lines cannot be determined, because they have too few targets in common with the others. Starting
    /// from the run with the most targets, runs are joined one after the other. Empty if no run lacks a target.
    pub(crate) fn without_line(&self) -> Vec<u32> {
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
