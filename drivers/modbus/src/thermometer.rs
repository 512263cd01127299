//! Polls modules in the background and publishes their temperatures as reported. Their plausibility is not checked in
//! this crate.

use std::time::{Duration, Instant};

use tokio_modbus::prelude::{Request, Response};
use volcomp_port::{Backoff, DeviceError, Published, Publisher, Reason, Temperature, published};

use crate::{
    bus::{ANSWER_WITHIN, Bus, Line, RequestError, thread_error},
    profile::{Channels, Profile, Status, read_channel},
};

/// Maximum number of consecutive polling rounds in which a module that does not answer is skipped.
const MAX_SKIPPED_ROUNDS: u32 = 16;

/// A temperature module on the line.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermometerUnit {
    /// Address of the module on the line.
    pub unit: u8,
    pub profile: Profile,
    /// Names of the module's channels, starting with the first channel. Channels beyond the last name are not read.
    pub names: Vec<String>,
}

/// Temperature modules on one TCP connection or serial line.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermometerConfig {
    pub bus: Bus,
    /// The modules. They are polled one after the other.
    pub units: Vec<ThermometerUnit>,
    /// Polling interval.
    pub interval: Duration,
    /// Response timeout of each module.
    pub answer_within: Duration,
    /// Delay between two connection attempts.
    pub backoff: Backoff,
}

impl ThermometerConfig {
    /// Creates a configuration with one module that is polled every second.
    pub fn new(bus: Bus, unit: ThermometerUnit) -> Self {
        Self {
            bus,
            units: vec![unit],
            interval: Duration::from_secs(1),
            answer_within: ANSWER_WITHIN,
            backoff: Backoff::default(),
        }
    }

    /// Names of all sensors, in the order of the temperatures. Does not connect.
    ///
    /// # Errors
    /// An invalid configuration.
    pub fn names(&self) -> Result<Vec<String>, DeviceError> {
        let device = self.bus.device();
        let refused =
            |what: String| DeviceError::option(&*device, what, "correct the configuration");
        let mut names: Vec<String> = Vec::new();
        for unit in &self.units {
            let channels = unit.profile.channels.as_ref().ok_or_else(|| {
                refused(format!("profile {} has no temperatures", unit.profile.name))
            })?;
            if unit.names.len() > usize::from(channels.count) {
                return Err(refused(format!(
                    "{} names for the {} channels of {}",
                    unit.names.len(),
                    channels.count,
                    unit.profile.name
                )));
            }
            names.extend(unit.names.iter().cloned());
        }
        if names.is_empty() {
            return Err(refused("no sensor is named".to_owned()));
        }
        for (index, name) in names.iter().enumerate() {
            if names[..index].contains(name) {
                return Err(refused(format!("the sensor {name} is listed twice")));
            }
        }
        Ok(names)
    }
}

/// Starts polling the modules of one line in a separate thread, which ends when the returned thermometer is dropped. If
/// the line cannot be opened, all sensors are bad and opening is retried.
///
/// # Errors
/// An invalid configuration, or the thread cannot be started.
pub fn poll_temperatures(config: ThermometerConfig) -> Result<Published, DeviceError> {
    let device = config.bus.device();
    let names = config.names()?;
    let count = names.len();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|e| thread_error(&device, e))?;
    let (publisher, published) = published(&*device, names);
    let poller = Poller {
        temperatures: vec![Temperature::NOT_READ; count],
        outages: vec![Outage::default(); config.units.len()],
        config,
        publisher,
    };
    std::thread::Builder::new()
        .name("modbus".to_owned())
        .spawn(move || runtime.block_on(poller.run()))
        .map_err(|e| thread_error(&device, e))?;
    Ok(published)
}

/// Number of consecutive failed requests to a module, and number of the next rounds in which the module is skipped.
#[derive(Clone, Copy, Default)]
struct Outage {
    rounds: u32,
    skip: u32,
}

struct Poller {
    config: ThermometerConfig,
    temperatures: Vec<Temperature>,
    outages: Vec<Outage>,
    publisher: Publisher,
}

impl Poller {
    async fn run(mut self) {
        let mut pause = Duration::ZERO;
        while !self.stopped() {
            let mut lived = Duration::ZERO;
            match self.config.bus.connect(self.config.answer_within * 4).await {
                Ok(mut line) => {
                    let born = Instant::now();
                    self.rounds(&mut line).await;
                    lived = born.elapsed();
                }
                Err(_) => self.all_bad(),
            }
            pause = self.config.backoff.next(pause, lived);
            self.sleep(pause).await;
        }
    }

    fn stopped(&self) -> bool {
        !self.publisher.has_reader()
    }

    /// Sleeps for `pause`, or until the thread is stopped.
    async fn sleep(&self, pause: Duration) {
        let end = Instant::now() + pause;
        while !self.stopped() && Instant::now() < end {
            let left = end.saturating_duration_since(Instant::now());
            tokio::time::sleep(left.min(Duration::from_millis(50))).await;
        }
    }

    async fn rounds(&mut self, line: &mut Line) {
        while !self.stopped() {
            let begun = Instant::now();
            for index in 0..self.config.units.len() {
                let outage = &mut self.outages[index];
                if outage.skip > 0 {
                    outage.skip -= 1;
                    continue;
                }
                let answered = self.request(line, index).await;
                self.publisher.publish(&self.temperatures);
                let outage = &mut self.outages[index];
                match answered {
                    Ok(()) => *outage = Outage::default(),
                    Err(RequestError::Disconnected) => {
                        self.all_bad();
                        return;
                    }
                    Err(
                        RequestError::NoAnswer | RequestError::EchoOnly | RequestError::Refused(_),
                    ) => {
                        outage.rounds += 1;
                        let skip = 1_u32.checked_shl(outage.rounds - 1).unwrap_or(u32::MAX) - 1;
                        // A single module is never skipped, because its timeout delays no other module.
                        let others = self.config.units.len() > 1;
                        outage.skip = if others { skip.min(MAX_SKIPPED_ROUNDS) } else { 0 };
                    }
                }
            }
            self.sleep(self.config.interval.saturating_sub(begun.elapsed())).await;
        }
    }

    /// Index among all sensors of the first sensor of the module with this index.
    fn first_sensor(&self, index: usize) -> usize {
        self.config.units[..index].iter().map(|unit| unit.names.len()).sum()
    }

    async fn request(&mut self, line: &mut Line, index: usize) -> Result<(), RequestError> {
        let (first, within) = (self.first_sensor(index), self.config.answer_within);
        let unit = &self.config.units[index];
        // The constructor has checked that the profile has channels.
        let Some(channels) = &unit.profile.channels else {
            return Ok(());
        };
        let read = read_module(line, unit.unit, channels, within).await;
        let taken = Instant::now();
        for sensor in 0..unit.names.len() {
            self.temperatures[first + sensor] = match &read {
                Err(unanswered) => Temperature::bad(unanswered.reason(), taken),
                Ok((registers, status)) => {
                    let bits = status.as_ref().and_then(|bits| bits.get(sensor).copied());
                    read_channel(channels, registers, sensor, bits, taken)
                }
            };
        }
        read.map(|_| ())
    }

    fn all_bad(&mut self) {
        let now = Instant::now();
        self.temperatures.fill(Temperature::bad(Reason::NoAnswer, now));
        self.publisher.publish(&self.temperatures);
    }
}

async fn read_module(
    line: &mut Line,
    unit: u8,
    channels: &Channels,
    within: Duration,
) -> Result<(Vec<u16>, Option<Vec<u16>>), RequestError> {
    let count = channels.count * channels.number.registers();
    let request = match channels.function {
        4 => Request::ReadInputRegisters(channels.address, count),
        _ => Request::ReadHoldingRegisters(channels.address, count),
    };
    let answer = line.request(unit, request, within).await?;
    let (Response::ReadInputRegisters(registers) | Response::ReadHoldingRegisters(registers)) =
        answer
    else {
        return Err(RequestError::Refused(0));
    };
    let Some(status) = channels.status else {
        return Ok((registers, None));
    };
    Ok((registers, Some(read_status(line, unit, &status, channels.count, within).await?)))
}

async fn read_status(
    line: &mut Line,
    unit: u8,
    status: &Status,
    count: u16,
    within: Duration,
) -> Result<Vec<u16>, RequestError> {
    let request = match status.function {
        1 => Request::ReadCoils(status.address, count),
        2 => Request::ReadDiscreteInputs(status.address, count),
        4 => Request::ReadInputRegisters(status.address, count),
        _ => Request::ReadHoldingRegisters(status.address, count),
    };
    Ok(match line.request(unit, request, within).await? {
        Response::ReadCoils(bits) | Response::ReadDiscreteInputs(bits) => {
            bits.into_iter().map(u16::from).collect()
        }
        Response::ReadInputRegisters(words) | Response::ReadHoldingRegisters(words) => {
            words.into_iter().map(|word| word & status.mask).collect()
        }
        _ => return Err(RequestError::Refused(0)),
    })
}
