//! Faults on purpose, seeded: wrap a device in [`Faulty`] and see what the rest makes of it.

use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_vocabulary::PerChannel;

use crate::{
    Controller, Description, DigitalIo, Fault, InputLevels, Snapshot, Temperature, Thermometer,
    Words,
};

/// How often what goes wrong: chances of a call, 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Faults {
    /// The call takes so long besides.
    pub delay: Duration,
    /// The delay is random up to that.
    pub jitter: bool,
    /// The answer does not come before the deadline.
    pub drop: f64,
    /// One number or bit of the answer is wrong: a jump, a NaN, an infinity.
    pub corrupt: f64,
    /// The next `calls` answers are the last one again.
    pub freeze: f64,
    /// The next `calls` calls find no connection.
    pub disconnect: f64,
    /// The number of calls that a freeze or a disconnection lasts.
    pub calls: u32,
}

/// A device with faults.
#[derive(Debug)]
pub struct Faulty<D> {
    /// The device that is wrapped.
    pub device: D,
    /// The faults that are injected; may be changed between calls.
    pub faults: Faults,
    random: ChaCha8Rng,
    frozen: u32,
    disconnected: u32,
    last_snapshot: Option<Snapshot>,
    last_levels: Option<InputLevels>,
    last_temperatures: Vec<Temperature>,
}

impl<D> Faulty<D> {
    /// Wraps a device; the same seed makes the same faults.
    pub fn new(device: D, faults: Faults, seed: u64) -> Self {
        Self {
            device,
            faults,
            random: ChaCha8Rng::seed_from_u64(seed),
            frozen: 0,
            disconnected: 0,
            last_snapshot: None,
            last_levels: None,
            last_temperatures: Vec::new(),
        }
    }

    fn happens(&mut self, chance: f64) -> bool {
        chance > 0.0 && self.random.random::<f64>() < chance
    }

    /// The delay, loss or disconnection that happens before the device is asked at all.
    fn before(&mut self, deadline: Instant) -> Result<(), Fault> {
        if self.disconnected == 0 && self.happens(self.faults.disconnect) {
            self.disconnected = self.faults.calls;
        }
        if self.disconnected > 0 {
            self.disconnected -= 1;
            return Err(Fault::NotConnected);
        }
        if !self.faults.delay.is_zero() {
            let share = if self.faults.jitter {
                self.random.random::<f64>()
            } else {
                1.0
            };
            let left = deadline.saturating_duration_since(Instant::now());
            let delay = self.faults.delay.mul_f64(share);
            std::thread::sleep(delay.min(left));
            if delay >= left {
                return Err(Fault::TimedOut);
            }
        }
        if self.happens(self.faults.drop) {
            return Err(Fault::TimedOut);
        }
        Ok(())
    }

    /// Whether the last answer comes again.
    fn is_frozen(&mut self) -> bool {
        if self.frozen == 0 && self.happens(self.faults.freeze) {
            self.frozen = self.faults.calls;
        }
        let frozen = self.frozen > 0;
        self.frozen = self.frozen.saturating_sub(1);
        frozen
    }

    fn broken_number(&mut self, number: f64) -> f64 {
        match self.random.random_range(0..4) {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => -number - 1.0,
            _ => number + self.random.random_range(-1e4..1e4),
        }
    }
}

impl<C: Controller> Controller for Faulty<C> {
    fn description(&self) -> &Description {
        self.device.description()
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        self.before(deadline)?;
        if self.is_frozen()
            && let Some(last) = self.last_snapshot
        {
            return Ok(last);
        }
        let mut snapshot = self.device.read(deadline)?;
        self.last_snapshot = Some(snapshot);
        if self.happens(self.faults.corrupt) {
            let axes = self.device.description().axes.len().max(1);
            let axis = self.random.random_range(0..axes);
            snapshot.positions[axis] = self.broken_number(snapshot.positions[axis]);
        }
        Ok(snapshot)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        self.before(deadline)?;
        self.device.post(frame, deadline)
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        self.before(deadline)?;
        self.device.apply(corrections, deadline)
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
        let frozen = self.is_frozen();
        let mut found = match self.last_levels {
            Some(last) if frozen => last,
            _ => self.device.read(deadline)?,
        };
        self.last_levels = Some(found);
        if self.happens(self.faults.corrupt) {
            found.levels ^= 1
                << self
                    .random
                    .random_range(0..self.device.inputs().clamp(1, 64));
        }
        Ok(found)
    }

    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault> {
        self.before(deadline)?;
        self.device.write(levels, deadline)
    }

    fn confirmed(&self) -> Option<u64> {
        self.device.confirmed()
    }
}

impl<T: Thermometer> Thermometer for Faulty<T> {
    fn device(&self) -> &str {
        self.device.device()
    }

    fn names(&self) -> &[String] {
        self.device.names()
    }

    fn latest(&mut self) -> &[Temperature] {
        if self.is_frozen() && !self.last_temperatures.is_empty() {
            return &self.last_temperatures;
        }
        self.last_temperatures.clear();
        let latest = self.device.latest();
        self.last_temperatures.extend_from_slice(latest);
        if self.happens(self.faults.corrupt) && !self.last_temperatures.is_empty() {
            let sensor = self.random.random_range(0..self.last_temperatures.len());
            let degc = self.last_temperatures[sensor].degc.unwrap_or(20.0);
            self.last_temperatures[sensor].degc = Some(self.broken_number(degc));
        }
        &self.last_temperatures
    }
}
