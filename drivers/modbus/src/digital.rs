//! Combines the digital lines of several modules into one port. A background thread polls the modules.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use triple_buffer::{Input, Output, triple_buffer};
use volcomp_port::{Backoff, DeviceError, DigitalIo, Fault, InputLevels, UnopenedLines};

use crate::{
    bus::{Bus, RequestError, thread_error},
    exchange::{Exchanger, Image, OutputRequest},
    profile::{Digital, Profile},
};

/// A Modbus module with digital inputs or outputs.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DigitalModule {
    /// Address of the module on the line.
    pub unit: u8,
    /// Profile with the register addresses of the module.
    pub profile: Profile,
}

/// The digital lines of several modules. The first module has the lowest bits. Reading and writing never wait for the
/// bus.
///
/// Inputs are those of the last exchange over the present connection, with their arrival time, regardless of their age.
///
/// Outputs are sent with the next exchange, once per write. A write is dropped if it cannot begin before its deadline,
/// or if it was requested before the connection was made. If a write was dropped, or not acknowledged by every module
/// before its deadline, the next write returns the fault.
pub struct ModbusDigital {
    device: String,
    inputs: u32,
    outputs: u32,
    exchange: Duration,
    images: Output<Image>,
    requested: Input<OutputRequest>,
    number: u64,
    /// Sequence number of the last write that is known to have succeeded or failed.
    settled: u64,
    oldest_deadline: Option<Instant>,
    reported: u64,
    stop: Arc<AtomicBool>,
}

impl ModbusDigital {
    /// Describes the lines of these modules, without connecting.
    ///
    /// # Errors
    /// An invalid configuration.
    pub fn describe(bus: &Bus, modules: &[DigitalModule]) -> Result<UnopenedLines, DeviceError> {
        let lines = lines(bus, modules)?;
        let count =
            |of: fn(&Digital) -> u16| lines.iter().map(|(_, d)| u32::from(of(d))).sum::<u32>();
        let (inputs, outputs) = (count(|d| d.inputs), count(|d| d.outputs));
        if inputs > 64 || outputs > 64 || inputs + outputs == 0 {
            let what = format!("found {inputs} inputs and {outputs} outputs, expected 1 to 64");
            return Err(refused(bus, what));
        }
        Ok(UnopenedLines {
            device: bus.device(),
            inputs,
            outputs,
            shortest_cycle: exchange_time(bus, &lines),
        })
    }

    /// Starts a thread that exchanges inputs and outputs with the modules. `answer_within` is the response timeout of
    /// each module.
    ///
    /// # Errors
    /// An invalid configuration, or the thread cannot be started.
    pub fn new(
        bus: Bus,
        modules: &[DigitalModule],
        answer_within: Duration,
        backoff: Backoff,
    ) -> Result<Self, DeviceError> {
        let UnopenedLines { device, inputs, outputs, shortest_cycle: exchange } =
            Self::describe(&bus, modules)?;
        let lines = lines(&bus, modules)?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| thread_error(&device, e))?;
        let (requested, taken) =
            triple_buffer(&OutputRequest { levels: 0, number: 0, until: Instant::now() });
        let (into, images) = triple_buffer(&Image::default());
        let stop = Arc::new(AtomicBool::new(false));
        let exchanger = Exchanger {
            bus,
            lines,
            answer_within,
            backoff,
            requested: taken,
            images: into,
            stop: Arc::clone(&stop),
            image: Image { lacks_read_back: outputs == 0, ..Image::default() },
            failed_read_backs: 0,
            skips_read_back: false,
            has_read_back: false,
        };
        std::thread::Builder::new()
            .name("modbus-io".to_owned())
            .spawn(move || runtime.block_on(exchanger.run()))
            .map_err(|e| thread_error(&device, e))?;
        Ok(Self {
            device,
            inputs,
            outputs,
            exchange,
            images,
            requested,
            number: 0,
            settled: 0,
            oldest_deadline: None,
            reported: 0,
            stop,
        })
    }
}

fn refused(bus: &Bus, what: String) -> DeviceError {
    DeviceError::option(bus.device(), what, "correct the configuration")
}

fn lines(bus: &Bus, modules: &[DigitalModule]) -> Result<Vec<(u8, Digital)>, DeviceError> {
    let line = |module: &DigitalModule| {
        let profile = &module.profile;
        let none = || refused(bus, format!("profile {} has no digital lines", profile.name));
        Ok((module.unit, profile.digital.ok_or_else(none)?))
    };
    modules.iter().map(line).collect()
}

/// Duration of one exchange with all modules. On a serial line: the time of the characters (11 bits each), the gaps,
/// and a turnaround of 2 ms per request. Over TCP: 2 ms per module.
fn exchange_time(bus: &Bus, lines: &[(u8, Digital)]) -> Duration {
    let Bus::Rtu { baud, .. } = bus else {
        return Duration::from_millis(2 * lines.len() as u64);
    };
    let mut characters = 0.0;
    let mut requests = 0.0;
    for (_, digital) in lines {
        if digital.inputs > 0 {
            characters += 8.0 + 5.0 + f64::from(digital.inputs.div_ceil(8));
            requests += 1.0;
        }
        if digital.outputs > 0 {
            characters += 9.0 + f64::from(digital.outputs.div_ceil(8)) + 8.0;
            requests += 1.0;
        }
    }
    let on_the_line = characters * 11.0 / f64::from((*baud).max(1));
    Duration::from_secs_f64(on_the_line + requests * 2e-3) + bus.frame_gap().mul_f64(2.0 * requests)
}

impl Drop for ModbusDigital {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

impl DigitalIo for ModbusDigital {
    fn device(&self) -> &str {
        &self.device
    }

    fn inputs(&self) -> u32 {
        self.inputs
    }

    fn outputs(&self) -> u32 {
        self.outputs
    }

    fn shortest_cycle(&self) -> Duration {
        self.exchange
    }

    /// Returns the inputs of the last exchange, with their arrival time. Fails if no inputs were read over the present
    /// connection.
    fn read(&mut self, _deadline: Instant) -> Result<InputLevels, Fault> {
        let image = *self.images.read();
        let inputs = image.inputs.filter(|_| image.connected);
        inputs.ok_or_else(|| match image.refused {
            Some(code) => RequestError::Refused(code).fault(),
            None => Fault::NotConnected,
        })
    }

    /// Queues the outputs for the next exchange. A fault can mean that an earlier write failed. The outputs are queued
    /// nevertheless, unless there is no connection or the deadline has passed.
    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault> {
        let (now, image) = (Instant::now(), *self.images.read());
        if !image.connected {
            self.reported = self.number;
            self.oldest_deadline = None;
            return Err(Fault::NotConnected);
        }
        if now >= deadline {
            return Err(Fault::TimedOut);
        }
        let failed = image.failed.filter(|(number, _)| *number > self.reported);
        let settled = image.taken.max(image.failed.map_or(0, |(number, _)| number));
        if settled > self.settled {
            self.settled = settled;
            self.oldest_deadline = None;
        }
        let silent = self.oldest_deadline.is_some_and(|until| now >= until);
        self.number += 1;
        self.oldest_deadline.get_or_insert(deadline);
        self.requested.write(OutputRequest { levels, number: self.number, until: deadline });
        match failed {
            Some((number, fault)) => {
                self.reported = number;
                Err(fault)
            }
            None if silent => Err(Fault::TimedOut),
            None => Ok(()),
        }
    }

    fn confirmed(&self) -> Option<u64> {
        self.images.output_buffer().outputs
    }

    fn reports_outputs(&self) -> bool {
        !self.images.output_buffer().lacks_read_back
    }
}
