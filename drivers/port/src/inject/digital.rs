//! A digital port with faults.

use std::time::{Duration, Instant};

use rand::RngExt;

use super::{Faulty, held::Write};
use crate::{DigitalIo, Fault, InputLevels};

fn deliver<D: DigitalIo>(device: &mut D, write: &Write, deadline: Instant) -> Result<(), Fault> {
    match write {
        Write::Levels(levels) => device.write(*levels, deadline),
        Write::Frame(_) | Write::Values(_) => Ok(()),
    }
}

impl<D: DigitalIo> DigitalIo for Faulty<D> {
    fn device(&self) -> &str {
        self.device.device()
    }

    fn inputs(&self) -> u32 {
        self.device.inputs()
    }

    fn outputs(&self) -> u32 {
        self.device.outputs()
    }

    fn shortest_cycle(&self) -> Duration {
        self.device.shortest_cycle() + self.faults.delay
    }

    fn read(&mut self, deadline: Instant) -> Result<InputLevels, Fault> {
        self.before(deadline)?;
        self.deliver_due(deliver);
        let frozen = self.is_frozen();
        let mut found = match self.last_levels {
            Some(last) if frozen => last,
            _ => {
                let found = self.device.read(deadline)?;
                self.way_back(deadline);
                found
            }
        };
        self.last_levels = Some(found);
        if self.happens(self.faults.corrupt) {
            found.levels ^= 1
                << self
                    .random
                    .random_range(0..self.device.inputs().clamp(1, 64));
        }
        self.after_reading();
        Ok(found)
    }

    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault> {
        self.put(Write::Levels(levels), deadline, deliver)
    }

    fn confirmed(&self) -> Option<u64> {
        self.device.confirmed()
    }

    fn tells_outputs(&self) -> bool {
        self.device.tells_outputs()
    }
}
