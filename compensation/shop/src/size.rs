//! Limit on the number of readings of a shop, which are all in memory at once.

use volcomp_calibrate::Method;

use crate::{
    error::ShopError,
    instrument::{Instrument, bridge_targets},
    observation::{Poses, Setting, ShopObservation},
    shop::{Shop, ShopLine},
};

const MOST_READINGS: usize = 5_000_000;

impl Shop {
    pub(crate) fn check_size(&self) -> Result<(), ShopError> {
        let lines = self.lines.iter().map(|line| self.readings_of(line));
        let observations = self.observations.iter().map(rows_of);
        let found = lines.chain(observations).fold(0, usize::saturating_add);
        if found > MOST_READINGS {
            let most = MOST_READINGS;
            return Err(ShopError::Readings { found, most });
        }
        Ok(())
    }

    fn readings_of(&self, line: &ShopLine) -> usize {
        let targets = match line.setup.method {
            Method::Direct => line.instrument.targets,
            Method::Angular { bridge_mm, .. } => {
                let axis = self.truth.axis(line.setup.error.axis);
                axis.map_or(0, |axis| bridge_targets(axis.travel, bridge_mm).len())
            }
        };
        over(&line.instrument, targets)
    }
}

fn over(instrument: &Instrument, targets: usize) -> usize {
    let directions = 1 + usize::from(instrument.both_directions);
    targets.saturating_mul(instrument.runs as usize).saturating_mul(directions)
}

fn rows_of(observation: &ShopObservation) -> usize {
    let instrument = &observation.instrument;
    match &observation.setting {
        Setting::Sphere { poses: Poses::Drawn(poses), centres, .. } => {
            poses.saturating_mul(centres.len())
        }
        Setting::Points { poses, .. }
        | Setting::Sphere { poses, .. }
        | Setting::Distance { poses, .. } => poses.count(),
        Setting::StepGauge(bar) | Setting::BallRow { bar, .. } => {
            over(instrument, bar.distances.len())
        }
        Setting::Diagonals { names } => {
            over(instrument, instrument.targets).saturating_mul(names.len())
        }
    }
}
