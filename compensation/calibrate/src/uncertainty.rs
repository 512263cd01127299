//! Measurement uncertainty: what a calibration would have found with other readings of the same
//! measurement.

use std::collections::BTreeMap;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_document::{InputError, Section};
use volcomp_metrology::{Measurement, Reading};
use volcomp_vocabulary::Direction;

use crate::{
    calibration_file::{CalibrationFile, Line, SquarenessSource},
    track::Kind,
};

/// Standard uncertainties (k = 1) that the scatter of the readings does not show: the table
/// `[uncertainty]` of a calibration file. All 0 by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Uncertainty {
    /// Of the laser's scale, its material temperature included, µm/m: the same for every positioning line.
    pub laser_um_per_m: f64,
    /// Of the reference angle of each squareness, µrad.
    pub square_urad: f64,
    /// Of the mean at each target of a linear reading, µm, independent between targets.
    pub reading_um: f64,
    /// Of the mean at each target of an angular reading, µrad, independent between targets.
    pub reading_urad: f64,
}

impl Uncertainty {
    pub(crate) fn decode(section: &Section<'_>) -> Result<Self, InputError> {
        section.allow(&[
            "laser_um_per_m",
            "square_urad",
            "reading_um",
            "reading_urad",
        ])?;
        let number = |key: &str| {
            let Some(value) = section.get(key) else {
                return Ok(0.0);
            };
            let found = value.number()?;
            if found < 0.0 {
                return Err(value.error(format!(
                    "found {found}, expected a standard uncertainty of 0 or more"
                )));
            }
            Ok(found)
        };
        Ok(Self {
            laser_um_per_m: number("laser_um_per_m")?,
            square_urad: number("square_urad")?,
            reading_um: number("reading_um")?,
            reading_urad: number("reading_urad")?,
        })
    }
}

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
            let (SquarenessSource::Value(angle)
            | SquarenessSource::Slopes {
                reference_angle_urad: angle,
            }) = &mut squareness.source;
            *angle += self.uncertainty.square_urad * normal(&mut rng);
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

/// Target and direction of a reading, as a key.
fn place(reading: &Reading) -> (Direction, u64) {
    (reading.direction, reading.target.to_bits())
}

/// Shifts the readings of a target together. One number for each run multiplies its deviations from the
/// means: the covariance of the shifts is that of the runs by their count, between targets and
/// directions too.
fn vary(line: &mut Line, uncertainty: &Uncertainty, laser_um_per_m: f64, rng: &mut ChaCha8Rng) {
    let positioning = Kind::of(line.setup.error) == Kind::Positioning && !line.setup.reads_angles();
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
