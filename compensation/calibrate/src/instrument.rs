//! An instrument that is not perfect: noise, resolution, drift, lost motion, targets and runs.

use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_document::{InputError, Section, Value};
use volcomp_metrology::{DeviationUnit, Measurement, Reading};
use volcomp_vocabulary::Direction;

/// How an instrument reads and how a line is run. Lengths in µm, angles in µrad: `[length, angle]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Instrument {
    /// Standard deviation of a reading.
    pub noise: [f64; 2],
    /// Step of a reading, 0 for none.
    pub resolution: [f64; 2],
    /// Growth of the readings from the first to the last of a line.
    pub drift: [f64; 2],
    /// Lost motion of the set-up: forward minus backward.
    pub reversal: [f64; 2],
    /// Standard deviation of the slope at which a straightness reference is aligned, µrad.
    pub alignment_urad: f64,
    /// Number of targets over the travel.
    pub targets: usize,
    /// Runs in each direction.
    pub runs: u32,
    /// Whether targets are approached in both directions.
    pub both_directions: bool,
}

impl Default for Instrument {
    /// A perfect instrument, 21 targets, five bidirectional runs.
    fn default() -> Self {
        Self {
            noise: [0.0; 2],
            resolution: [0.0; 2],
            drift: [0.0; 2],
            reversal: [0.0; 2],
            alignment_urad: 0.0,
            targets: 21,
            runs: 5,
            both_directions: true,
        }
    }
}

/// Targets of one line, and runs, at the most.
pub(crate) const MAX_TARGETS: usize = 100_000;

/// Readings of one line in one direction at the most.
const MAX_READINGS: usize = 1_000_000;

/// The keys that [`Instrument::decode`] reads.
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

impl Instrument {
    /// The keys of a section over `base`.
    pub(crate) fn decode(section: &Section<'_>, base: &Self) -> Result<Self, InputError> {
        let number =
            |key: &str, default: f64| section.get(key).map_or(Ok(default), |value| value.number());
        let positive = |key: &str, default: f64| {
            section
                .get(key)
                .map_or(Ok(default), |value| not_negative(&value))
        };
        let count = |key: &str, least: usize, default: usize| {
            section
                .get(key)
                .map_or(Ok(default), |value| match value.count(MAX_TARGETS)? {
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
        Ok(Self {
            noise: [
                positive("noise_um", base.noise[0])?,
                positive("noise_urad", base.noise[1])?,
            ],
            resolution: [
                positive("resolution_um", base.resolution[0])?,
                positive("resolution_urad", base.resolution[1])?,
            ],
            drift: [
                number("drift_um", base.drift[0])?,
                number("drift_urad", base.drift[1])?,
            ],
            reversal: [
                number("reversal_um", base.reversal[0])?,
                number("reversal_urad", base.reversal[1])?,
            ],
            alignment_urad: positive("alignment_urad", base.alignment_urad)?,
            targets,
            runs: u32::try_from(runs).unwrap_or(base.runs),
            both_directions: section
                .get("both_directions")
                .map_or(Ok(base.both_directions), |value| value.truth())?,
        })
    }

    /// The targets over a travel, both ends included.
    pub fn targets_over(&self, [low, high]: [f64; 2]) -> Vec<f64> {
        let last = (self.targets - 1) as f64;
        (0..self.targets)
            .map(|index| low + (high - low) * index as f64 / last)
            .collect()
    }

    /// Runs a line: `perfect` is what a perfect instrument reads at a target in a direction, and 0 at
    /// the first target.
    pub(crate) fn run(
        &self,
        targets: &[f64],
        unit: DeviationUnit,
        perfect: impl Fn(f64, Direction) -> f64,
        random: &mut impl Rng,
    ) -> Measurement {
        let kind = usize::from(unit == DeviationUnit::Urad);
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
                        + lost * self.reversal[kind]
                        + self.drift[kind] * elapsed
                        + self.noise[kind] * noise;
                    readings.push(Reading {
                        target,
                        run,
                        direction,
                        deviation: rounded(value, self.resolution[kind]),
                    });
                }
            }
        }
        Measurement {
            unit: Some(unit),
            readings,
            ..Measurement::default()
        }
    }
}

fn rounded(value: f64, step: f64) -> f64 {
    if step > 0.0 {
        (value / step).round() * step
    } else {
        value
    }
}

fn not_negative(value: &Value<'_>) -> Result<f64, InputError> {
    match value.number()? {
        number if number >= 0.0 => Ok(number),
        number => Err(value.error(format!("found {number}, expected 0 or more"))),
    }
}
