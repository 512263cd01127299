//! Samples a calibration file within the measurement uncertainty of its readings.

use std::collections::BTreeMap;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_fit::student_widening;
use volcomp_identify::{Observations, Row, RowReading};
use volcomp_metrology::{Measurement, MotionKind, Quantity, Reading};
use volcomp_vocabulary::{Direction, Urad};

use crate::calibration_file::{CalibrationFile, Line, SquarenessSource, Uncertainty};

impl CalibrationFile {
    /// The same calibration with readings sampled from their covariance (JCGM 101, propagation of distributions). The means of the targets vary jointly
    /// as the runs do, and by [`Uncertainty`]. A `trial` of a `seed` is reproducible and independent of other trials.
    #[must_use]
    pub fn varied(&self, seed: u64, trial: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(trial);
        let mut varied = self.clone();
        varied.vary_direct(&mut |_| normal(&mut rng));
        if let Some(observations) = &mut varied.observations {
            vary_observations(observations, &mut || normal(&mut rng));
        }
        varied
    }

    /// Shifts every directly measured value by its standard uncertainty times an independent number from `next`.
    pub(crate) fn vary_direct(&mut self, next: &mut impl FnMut(Part) -> f64) {
        let uncertainty = self.uncertainty;
        let laser = uncertainty.laser_um_per_m * next(Part::Stated);
        for line in &mut self.measurements {
            vary(line, &uncertainty, laser, next);
        }
        for squareness in &mut self.squareness {
            let shift = uncertainty.square_urad * next(Part::Stated);
            match &mut squareness.source {
                SquarenessSource::Value(Urad(angle))
                | SquarenessSource::Slopes { reference_angle: Urad(angle) } => *angle += shift,
                // The rows of the diagonals vary instead.
                SquarenessSource::Diagonals => {}
            }
        }
        for location in &mut self.locations {
            location.value += location.uncertainty * next(Part::Stated);
        }
        for diagonals in &mut self.diagonals {
            vary_observations(&mut diagonals.observations, &mut || next(Part::Stated));
        }
    }

    /// Whether all directly measured values equal those of another file with the same measurements.
    pub(crate) fn reads_as(&self, other: &Self) -> bool {
        let mut lines = self.measurements.iter().zip(&other.measurements);
        let mut diagonals = self.diagonals.iter().zip(&other.diagonals);
        let rows = |of: &Observations| -> Vec<Row> {
            let observations = of.observations.iter();
            observations.flat_map(|of| of.rows.clone()).collect()
        };
        self.squareness == other.squareness
            && self.locations == other.locations
            && lines.all(|(a, b)| a.readings.readings == b.readings.readings)
            && diagonals.all(|(a, b)| {
                let [a, b] = [&a.observations, &b.observations];
                rows(a) == rows(b) && a.setup.numbers == b.setup.numbers
            })
    }

    /// Lines with repeated runs; their uncertainty comes from the scatter of a few runs.
    pub fn scatters(&self) -> impl Iterator<Item = LineScatter> {
        let lines = self.measurements.iter().enumerate();
        lines.filter_map(|(line, of)| LineScatter::of(line, &of.readings))
    }

    /// The same calibration with one line shifted by the contribution of one of its runs to its uncertainty. The shifts
    /// of the runs are independent; the sum of the squared changes that they cause is the variance from the scatter of
    /// the line.
    #[must_use]
    pub fn shifted_by_run(&self, line: usize, run: u32) -> Self {
        let mut shifted = self.clone();
        if let Some(line) = shifted.measurements.get_mut(line) {
            let mut shifts = BTreeMap::new();
            add_runs(&mut shifts, line, |of| if of == run { 1.0 } else { 0.0 }, &mut || 0.0);
            for reading in &mut line.readings.readings {
                reading.deviation += shifts.get(&place(reading)).copied().unwrap_or_default();
            }
        }
        shifted
    }

    /// Files of lines whose scatter is unknown: the line has no repeated runs or targets, and `[uncertainty]` states
    /// nothing for its readings.
    pub fn files_without_scatter(&self) -> Vec<String> {
        let is_stated = |line: &Line| independent(line, &self.uncertainty) > 0.0;
        let is_repeated = |readings: &Measurement| match readings.incomplete_runs() {
            Some(runs) => runs.scatter().is_some(),
            None => readings.most_runs() > 1,
        };
        let lines = self.measurements.iter();
        lines
            .filter(|line| !is_repeated(&line.readings) && !is_stated(line))
            .map(|line| line.file.display().to_string())
            .collect()
    }
}

/// Scatter of the runs of one line, and its degrees of freedom.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LineScatter {
    /// Index of the line in [`CalibrationFile::measurements`].
    pub line: usize,
    /// Numbers of the line's runs.
    pub runs: Vec<u32>,
    /// Degrees of freedom of the scatter: the number of runs of each mean minus one. If some runs of a straightness
    /// have one direction only, at most the degrees of freedom of its slope.
    pub degrees: usize,
}

impl LineScatter {
    /// The scatter of a line; `None` for a line without repeated runs.
    fn of(line: usize, readings: &Measurement) -> Option<Self> {
        let [forward, backward] = Direction::BOTH.map(|direction| readings.runs(direction));
        let one_less = |runs: usize| runs.saturating_sub(1);
        // A bidirectional run has one number and shifts both means together.
        let is_there_and_back = forward.iter().any(|run| backward.contains(run));
        let degrees = if is_there_and_back {
            one_less(forward.len().max(backward.len()))
        } else {
            one_less(forward.len()) + one_less(backward.len())
        };
        // If some runs of a straightness have both directions, its slope is computed from these runs only, and so are
        // its degrees of freedom.
        let incomplete = (readings.quantity == Some(Quantity::Straightness))
            .then(|| readings.incomplete_runs())
            .flatten();
        let degrees =
            incomplete.map_or(degrees, |of| degrees.min(of.freedom_of_lines(&Direction::BOTH)));
        let mut runs = [forward, backward].concat();
        runs.sort_unstable();
        runs.dedup();
        (degrees > 0).then_some(Self { line, runs, degrees })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// Scatter of the runs of a line, see [`CalibrationFile::scatters`].
    Run,
    Stated,
}

pub(crate) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn vary_observations(observations: &mut Observations, next: &mut impl FnMut() -> f64) {
    // The cross-validation of a sample is not used, so it is switched off.
    observations.folds = 0;
    // Calibrated distances of balls and calibrated positions of targets vary like the readings.
    for number in &mut observations.setup.numbers {
        if let (Some(value), Some(within)) = (&mut number.value, number.known_within) {
            *value += within * next();
        }
    }
    for point in &mut observations.setup.points {
        if let (Some(value), Some(within)) = (&mut point.value, point.known_within) {
            for number in value {
                *number += within * next();
            }
        }
    }
    for observation in &mut observations.observations {
        for row in &mut observation.rows {
            vary_row(row, next);
        }
    }
}

fn vary_row(row: &mut Row, next: &mut impl FnMut() -> f64) {
    let mut shift = || row.uncertainty_mm * next();
    match &mut row.reading {
        RowReading::Point { at_mm: seen, .. } | RowReading::Sphere { offset_mm: seen, .. } => {
            for number in seen.iter_mut() {
                *number += shift();
            }
        }
        RowReading::Distance { length_mm: seen, .. }
        | RowReading::Pair { length_mm: seen, .. }
        | RowReading::Line { deviation_mm: seen, .. } => *seen += shift(),
        RowReading::Ball { offset_mm, .. } => {
            for number in offset_mm.iter_mut().flatten() {
                *number += shift();
            }
        }
    }
}

/// Target and direction of a reading, as a key.
fn place(reading: &Reading) -> (Direction, u64) {
    key(reading.direction, reading.target)
}

fn key(direction: Direction, target: f64) -> (Direction, u64) {
    // −0.0 and 0.0 are one target.
    (direction, (target + 0.0).to_bits())
}

/// Stated standard uncertainty that is independent between targets, µm or µrad.
fn independent(line: &Line, uncertainty: &Uncertainty) -> f64 {
    if line.setup.reads_angles() { uncertainty.reading_urad } else { uncertainty.reading_um }
}

/// Shifts the mean readings of all targets together. One random number per run multiplies the deviations of the run
/// from the means. The covariance of the shifts, also between targets and directions, is therefore the covariance of
/// the runs divided by their number.
fn vary(
    line: &mut Line,
    uncertainty: &Uncertainty,
    laser_um_per_m: f64,
    next: &mut impl FnMut(Part) -> f64,
) {
    let positioning =
        MotionKind::of(line.setup.error) == MotionKind::Positioning && !line.setup.reads_angles();
    let independent = independent(line, uncertainty);
    let mut factors: BTreeMap<u32, f64> = BTreeMap::new();
    let mut shifts: BTreeMap<(Direction, u64), f64> = BTreeMap::new();
    for reading in &line.readings.readings {
        factors.entry(reading.run).or_default();
        shifts.entry(place(reading)).or_default();
    }
    for factor in factors.values_mut() {
        *factor = next(Part::Run);
    }
    for (key, shift) in &mut shifts {
        let scale = if positioning { laser_um_per_m * f64::from_bits(key.1) * 1e-3 } else { 0.0 };
        *shift = scale + independent * next(Part::Stated);
    }
    add_runs(&mut shifts, line, |run| factors[&run], &mut || next(Part::Stated));
    for reading in &mut line.readings.readings {
        reading.deviation += shifts[&place(reading)];
    }
}

/// Adds the shift of each target to `shifts`: the sum over the runs of the deviation from the mean of the target, times
/// the factor of the run, divided by √(n (n − 1)). If some runs lack targets, the shifts are those of
/// [`volcomp_metrology::IncompleteRuns::sampled`]; only in that case `next` supplies random numbers that do not belong
/// to a run.
fn add_runs(
    shifts: &mut BTreeMap<(Direction, u64), f64>,
    line: &Line,
    factor: impl Fn(u32) -> f64,
    next: &mut impl FnMut() -> f64,
) {
    if let Some(runs) = line.readings.incomplete_runs() {
        // ±1.96 times the widened scatter is the 95 % band of the pooled scatter.
        let widening = runs.scatter().map_or(1.0, |of| student_widening(of.freedom));
        let sampled = runs.sampled(factor, &mut || widening * next());
        for (direction, sampled) in Direction::BOTH.into_iter().zip(sampled) {
            for (target, shift) in runs.targets(direction).zip(sampled) {
                *shifts.entry(key(direction, target)).or_default() += shift;
            }
        }
        return;
    }
    let mut means: BTreeMap<(Direction, u64), (f64, f64)> = BTreeMap::new();
    let readings = &line.readings.readings;
    for reading in readings {
        let (sum, count) = means.entry(place(reading)).or_default();
        *sum += reading.deviation;
        *count += 1.0;
    }
    for reading in readings {
        let (sum, count) = means[&place(reading)];
        if count > 1.0 {
            let deviation = reading.deviation - sum / count;
            let shift = factor(reading.run) * deviation / f64::sqrt(count * (count - 1.0));
            *shifts.entry(place(reading)).or_default() += shift;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// −0.0 and 0.0 are one target, whose runs scatter about one mean.
    #[test]
    fn a_target_at_minus_zero_is_at_zero() {
        let at = |target: f64| {
            place(&Reading { target, run: 1, direction: Direction::Positive, deviation: 0.0 })
        };
        assert_eq!(at(-0.0), at(0.0));
        assert_ne!(at(-1.0), at(1.0));
    }
}
