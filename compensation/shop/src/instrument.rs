//! Imperfect instruments: noise, resolution, drift, lost motion, targets and runs.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_document::{InputError, Section, Value};
use volcomp_metrology::{DeviationUnit, Measurement, Reading};
use volcomp_vocabulary::{Direction, Um, Urad};

use crate::error::InstrumentError;

/// An instrument: its imperfections, targets and runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Instrument {
    /// Imperfections of length readings.
    pub length: Imperfections<Um>,
    /// Imperfections of angle readings.
    pub angle: Imperfections<Urad>,
    /// Standard deviation of the slope of a straightness reference relative to its axis.
    pub alignment: Urad,
    /// Number of targets over the travel, both ends included.
    pub targets: usize,
    /// Number of runs in each direction.
    pub runs: u32,
    /// Whether targets are approached in both directions.
    pub both_directions: bool,
}

/// Systematic and random deviations of the readings from the true values, µm or µrad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Imperfections<U> {
    /// Standard deviation of a reading.
    pub noise: U,
    /// Resolution of a reading, 0 for none.
    pub resolution: U,
    /// Drift from the first to the last reading of a line.
    pub drift: U,
    /// Lost motion of the set-up: forward minus backward.
    pub reversal: U,
}

impl Default for Instrument {
    /// A perfect instrument with 21 targets and five bidirectional runs.
    fn default() -> Self {
        Self {
            length: Imperfections::default(),
            angle: Imperfections::default(),
            alignment: Urad(0.0),
            targets: 21,
            runs: 5,
            both_directions: true,
        }
    }
}

pub(crate) const MAX_TARGETS: usize = 100_000;

pub(crate) const MAX_READINGS: usize = 1_000_000;

impl Instrument {
    /// Checks the instrument: counts within limits, numbers finite and, except for drift and reversal, not negative.
    ///
    /// # Errors
    /// The first invalid quantity.
    pub fn check(&self) -> Result<(), InstrumentError> {
        let (targets, runs) = (self.targets, self.runs);
        if !(2..=MAX_TARGETS).contains(&targets) {
            let most = MAX_TARGETS;
            return Err(InstrumentError::Targets { found: targets, most });
        }
        if runs == 0 {
            return Err(InstrumentError::NoRuns);
        }
        self.check_count(targets)?;
        let (length, angle) = (&self.length, &self.angle);
        for (what, found) in [
            ("noise_um", length.noise.0),
            ("noise_urad", angle.noise.0),
            ("resolution_um", length.resolution.0),
            ("resolution_urad", angle.resolution.0),
            ("alignment_urad", self.alignment.0),
        ] {
            let expected = "0 or more";
            if !(found.is_finite() && found >= 0.0) {
                return Err(InstrumentError::Number { what, found, expected });
            }
        }
        for (what, found) in [
            ("drift_um", length.drift.0),
            ("drift_urad", angle.drift.0),
            ("reversal_um", length.reversal.0),
            ("reversal_urad", angle.reversal.0),
        ] {
            let expected = "a finite number";
            if !found.is_finite() {
                return Err(InstrumentError::Number { what, found, expected });
            }
        }
        Ok(())
    }

    /// Checks that the runs over `targets` targets do not exceed the maximum number of readings in one direction.
    pub(crate) fn check_count(&self, targets: usize) -> Result<(), InstrumentError> {
        let (runs, most) = (self.runs, MAX_READINGS);
        if targets.saturating_mul(runs as usize) > most {
            return Err(InstrumentError::Readings { targets, runs, most });
        }
        Ok(())
    }

    pub(crate) fn targets_over(&self, [low, high]: [f64; 2]) -> Vec<f64> {
        let last = self.targets.saturating_sub(1).max(1) as f64;
        (0..self.targets).map(|index| low + (high - low) * index as f64 / last).collect()
    }

    /// Measures a line. `perfect` returns the reading of a perfect instrument, µm or µrad, at a target in a direction; 0 at the first target.
    pub(crate) fn run(
        &self,
        targets: &[f64],
        unit: DeviationUnit,
        perfect: impl Fn(f64, Direction) -> f64,
        random: &mut impl Rng,
    ) -> Measurement {
        let imperfections = match unit {
            DeviationUnit::Um => plain(&self.length, |length| length.0),
            DeviationUnit::Urad => plain(&self.angle, |angle| angle.0),
        };
        let directions = &Direction::BOTH[..if self.both_directions { 2 } else { 1 }];
        let count = targets.len() * self.runs as usize * directions.len();
        let mut readings = Vec::with_capacity(count);
        for run in 1..=self.runs {
            for &direction in directions {
                for place in 0..targets.len() {
                    let (target, lost) = match direction {
                        Direction::Positive => (targets[place], 0.5),
                        Direction::Negative => (targets[targets.len() - 1 - place], -0.5),
                    };
                    let elapsed = readings.len() as f64 / (count - 1).max(1) as f64;
                    let noise: f64 = StandardNormal.sample(random);
                    let value = perfect(target, direction)
                        + lost * imperfections.reversal
                        + imperfections.drift * elapsed
                        + imperfections.noise * noise;
                    readings.push(Reading {
                        target,
                        run,
                        direction,
                        deviation: rounded(value, imperfections.resolution),
                    });
                }
            }
        }
        Measurement { unit: Some(unit), readings, ..Measurement::default() }
    }
}

/// Targets of a bridge over a travel, mm, from the lower end on, spaced by the distance of its feet.
pub(crate) fn bridge_targets([low, high]: [f64; 2], bridge_mm: f64) -> Vec<f64> {
    (0..=MAX_TARGETS)
        .map(|step| low + bridge_mm * step as f64)
        .take_while(|target| *target <= high + 1e-9)
        .collect()
}

fn plain<U: Copy>(of: &Imperfections<U>, number: fn(U) -> f64) -> Imperfections<f64> {
    Imperfections {
        noise: number(of.noise),
        resolution: number(of.resolution),
        drift: number(of.drift),
        reversal: number(of.reversal),
    }
}

fn rounded(value: f64, step: f64) -> f64 {
    if step > 0.0 { (value / step).round() * step } else { value }
}

/// Keys of an instrument, which are valid in its own table and in a `[[measurement]]`, where they override it.
pub(crate) const INSTRUMENT_KEYS: [&str; 12] = [
    "noise_um",
    "noise_urad",
    "resolution_um",
    "resolution_urad",
    "drift_um",
    "drift_urad",
    "reversal_um",
    "reversal_urad",
    "alignment_urad",
    "targets",
    "runs",
    "both_directions",
];

/// Decodes the instrument of a section, whose keys override those of `base`.
pub(crate) fn decode_instrument(
    section: &Section<'_>,
    base: &Instrument,
) -> Result<Instrument, InputError> {
    let number =
        |key: &str, default: f64| section.get(key).map_or(Ok(default), |value| value.number());
    let positive = |key: &str, default: f64| {
        section.get(key).map_or(Ok(default), |value| not_negative(&value))
    };
    let count = |key: &str, least: usize, default: usize| {
        section.get(key).map_or(Ok(default), |value| match value.count(MAX_TARGETS)? {
            count if count >= least => Ok(count),
            count => Err(value.error(format!("found {count}, expected at least {least}"))),
        })
    };
    let runs = count("runs", 1, base.runs as usize)?;
    let targets = count("targets", 2, base.targets)?;
    if targets * runs > MAX_READINGS {
        return Err(section.error(format!(
            "found {targets} targets in {runs} runs, expected at most {MAX_READINGS} readings"
        )));
    }
    let (length, angle) = (&base.length, &base.angle);
    Ok(Instrument {
        length: Imperfections {
            noise: Um(positive("noise_um", length.noise.0)?),
            resolution: Um(positive("resolution_um", length.resolution.0)?),
            drift: Um(number("drift_um", length.drift.0)?),
            reversal: Um(number("reversal_um", length.reversal.0)?),
        },
        angle: Imperfections {
            noise: Urad(positive("noise_urad", angle.noise.0)?),
            resolution: Urad(positive("resolution_urad", angle.resolution.0)?),
            drift: Urad(number("drift_urad", angle.drift.0)?),
            reversal: Urad(number("reversal_urad", angle.reversal.0)?),
        },
        alignment: Urad(positive("alignment_urad", base.alignment.0)?),
        targets,
        runs: u32::try_from(runs).unwrap_or(base.runs),
        both_directions: section
            .get("both_directions")
            .map_or(Ok(base.both_directions), |value| value.truth())?,
    })
}

fn not_negative(value: &Value<'_>) -> Result<f64, InputError> {
    match value.number()? {
        number if number >= 0.0 => Ok(number),
        number => Err(value.error(format!("found {number}, expected 0 or more"))),
    }
}
