//! Measurement uncertainty: what a calibration would have found with other readings of the same
//! measurement.

use std::collections::BTreeMap;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_identify::{Row, Seen};
use volcomp_metrology::{Measurement, MotionKind, Reading};
use volcomp_vocabulary::{Direction, Urad};

use crate::calibration_file::{CalibrationFile, Line, SquarenessSource, Uncertainty};

impl CalibrationFile {
    /// The same calibration with readings drawn from their covariance (JCGM 101, propagation of
    /// distributions): the means of the targets vary jointly as the runs did, and by [`Uncertainty`].
    /// Every `trial` of a `seed` is the same whatever was drawn before it.
    #[must_use]
    pub fn varied(&self, seed: u64, trial: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(trial);
        let mut varied = self.clone();
        let laser = self.uncertainty.laser_um_per_m * normal(&mut rng);
        for line in &mut varied.measurements {
            vary(line, &self.uncertainty, laser, &mut rng);
        }
        for squareness in &mut varied.squareness {
            let shift = self.uncertainty.square_urad * normal(&mut rng);
            match &mut squareness.source {
                SquarenessSource::Value(Urad(angle))
                | SquarenessSource::Slopes {
                    reference_angle: Urad(angle),
                } => *angle += shift,
                // Its rows vary.
                SquarenessSource::Diagonals { .. } => {}
            }
        }
        for location in &mut varied.locations {
            location.value += location.uncertainty * normal(&mut rng);
        }
        let diagonals = varied.diagonals.iter_mut().map(|d| &mut d.observations);
        for observations in diagonals.chain(&mut varied.observations) {
            // Nobody reads how well a drawn one predicts.
            observations.folds = 0;
            // What a calibration says of the distances of balls is a reading like those of this machine.
            for number in &mut observations.setup.numbers {
                if let (Some(value), Some(within)) = (&mut number.value, number.known_within) {
                    *value += within * normal(&mut rng);
                }
            }
            for observation in &mut observations.observations {
                for row in &mut observation.rows {
                    vary_row(row, &mut rng);
                }
            }
        }
        varied
    }

    /// The files whose scatter is not known: one run only in each direction.
    pub fn without_scatter(&self) -> impl Iterator<Item = &Line> {
        self.measurements
            .iter()
            .filter(|line| most_runs(&line.readings) < 2)
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

fn most_runs(readings: &Measurement) -> usize {
    let runs = Direction::BOTH.map(|direction| readings.runs(direction).len());
    runs[0].max(runs[1])
}

/// Shifts what was seen at a pose by its uncertainty.
fn vary_row(row: &mut Row, rng: &mut ChaCha8Rng) {
    let mut shift = || row.uncertainty_mm * normal(rng);
    match &mut row.seen {
        Seen::Point { at_mm: seen, .. }
        | Seen::Sphere {
            offset_mm: seen, ..
        } => {
            for number in seen.iter_mut() {
                *number += shift();
            }
        }
        Seen::Distance {
            length_mm: seen, ..
        }
        | Seen::Pair {
            length_mm: seen, ..
        }
        | Seen::Line {
            deviation_mm: seen, ..
        } => *seen += shift(),
        Seen::Ball { offset_mm, .. } => {
            for number in offset_mm.iter_mut().flatten() {
                *number += shift();
            }
        }
    }
}

/// Target and direction of a reading, as a key.
fn place(reading: &Reading) -> (Direction, u64) {
    (reading.direction, reading.target.to_bits())
}

/// Shifts the readings of a target together. One number for each run multiplies its deviations from the
/// means: the covariance of the shifts is that of the runs by their count, between targets and
/// directions too.
fn vary(line: &mut Line, uncertainty: &Uncertainty, laser_um_per_m: f64, rng: &mut ChaCha8Rng) {
    let positioning =
        MotionKind::of(line.setup.error) == MotionKind::Positioning && !line.setup.reads_angles();
    let independent = if line.setup.reads_angles() {
        uncertainty.reading_urad
    } else {
        uncertainty.reading_um
    };
    let mut by_run: BTreeMap<u32, f64> = BTreeMap::new();
    let mut means: BTreeMap<(Direction, u64), (f64, f64)> = BTreeMap::new();
    for reading in &line.readings.readings {
        by_run.entry(reading.run).or_default();
        let (sum, count) = means.entry(place(reading)).or_default();
        *sum += reading.deviation;
        *count += 1.0;
    }
    for factor in by_run.values_mut() {
        *factor = normal(rng);
    }
    let mut shifts: BTreeMap<(Direction, u64), f64> = BTreeMap::new();
    for key in means.keys() {
        let scale = if positioning {
            laser_um_per_m * f64::from_bits(key.1) * 1e-3
        } else {
            0.0
        };
        shifts.insert(*key, scale + independent * normal(rng));
    }
    for reading in &line.readings.readings {
        let (sum, count) = means[&place(reading)];
        if count > 1.0 {
            let deviation = reading.deviation - sum / count;
            let shift = by_run[&reading.run] * deviation / f64::sqrt(count * (count - 1.0));
            *shifts.entry(place(reading)).or_default() += shift;
        }
    }
    for reading in &mut line.readings.readings {
        reading.deviation += shifts[&place(reading)];
    }
}
