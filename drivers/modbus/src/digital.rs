//! Modules with digital lines, polled in the background and combined into one port.

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
    bus::{Bus, Unanswered, no_thread},
    exchange::{Exchanger, Image, Wanted},
    profile::{Digital, Profile},
};

/// A module with digital lines.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DigitalModule {
    /// Its address on the line.
    pub unit: u8,
    /// The profile of the module: its register addresses.
    pub profile: Profile,
}

/// The lines of several modules, those of the first module lowest. Reading and writing never wait for the bus: inputs are those of the last
/// exchange, with their time of arrival, whatever their age; outputs are sent with the next exchange, once per write. A write that cannot begin
/// before its deadline is not sent. The next call reports a write as failed if it was not sent, or not acknowledged by every module before its
/// deadline. Writes requested before a connection was made are not sent over it.
pub struct ModbusDigital {
    device: String,
    inputs: u32,
    outputs: u32,
    exchange: Duration,
    images: Output<Image>,
    wanted: Input<Wanted>,
    /// Number of the last requested write.
    number: u64,
    /// Number of the last write known to have succeeded or failed.
    answered: u64,
    /// Deadline of the oldest unanswered write.
    unanswered: Option<Instant>,
    /// Number of the last write whose failure was reported.
    told: u64,
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

    /// Starts the exchanges. `answer_within` is the response timeout of a module.
    ///
    /// # Errors
    /// An invalid configuration.
    pub fn new(
        bus: Bus,
        modules: &[DigitalModule],
        answer_within: Duration,
        backoff: Backoff,
    ) -> Result<Self, DeviceError> {
        let UnopenedLines {
            device,
            inputs,
            outputs,
            shortest_cycle: exchange,
        } = Self::describe(&bus, modules)?;
        let lines = lines(&bus, modules)?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| no_thread(&device, e))?;
        let (wanted, taken) = triple_buffer(&Wanted {
            levels: 0,
            number: 0,
            until: Instant::now(),
        });
        let (into, images) = triple_buffer(&Image::default());
        let stop = Arc::new(AtomicBool::new(false));
        let exchanger = Exchanger {
            bus,
            lines,
            answer_within,
            backoff,
            wanted: taken,
            images: into,
            stop: Arc::clone(&stop),
            image: Image {
                cannot_tell: outputs == 0,
                ..Image::default()
            },
            tries: 0,
            skips: false,
        };
        std::thread::Builder::new()
            .name("modbus-io".to_owned())
            .spawn(move || runtime.block_on(exchanger.run()))
            .map_err(|e| no_thread(&device, e))?;
        Ok(Self {
            device,
            inputs,
            outputs,
            exchange,
            images,
            wanted,
            number: 0,
            answered: 0,
            unanswered: None,
            told: 0,
            stop,
        })
    }
}

fn refused(bus: &Bus, what: String) -> DeviceError {
    DeviceError::option(bus.device(), what, "correct the configuration")
}

/// The address and digital lines of each module.
fn lines(bus: &Bus, modules: &[DigitalModule]) -> Result<Vec<(u8, Digital)>, DeviceError> {
    let line = |module: &DigitalModule| {
        let profile = &module.profile;
        let none = || {
            refused(
                bus,
                format!("profile {} has no digital lines", profile.name),
            )
        };
        Ok((module.unit, profile.digital.ok_or_else(none)?))
    };
    modules.iter().map(line).collect()
}

/// Duration of one exchange with all modules on the line: characters of 11 bits, gaps, and a turnaround of 2 ms.
fn exchange_time(bus: &Bus, lines: &[(u8, Digital)]) -> Duration {
    let Bus::Rtu { baud, .. } = bus else {
        return Duration::from_millis(2 * lines.len() as u64);
    };
    let mut characters = 0.0;
    let mut questions = 0.0;
    for (_, digital) in lines {
        if digital.inputs > 0 {
            characters += 8.0 + 5.0 + f64::from(digital.inputs.div_ceil(8));
            questions += 1.0;
        }
        if digital.outputs > 0 {
            characters += 9.0 + f64::from(digital.outputs.div_ceil(8)) + 8.0;
            questions += 1.0;
        }
    }
    let on_the_line = characters * 11.0 / f64::from((*baud).max(1));
    Duration::from_secs_f64(on_the_line + questions * 2e-3)
        + bus.frame_gap().mul_f64(2.0 * questions)
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

    /// The inputs of the last exchange with their time of arrival; they age while modules do not answer.
    fn read(&mut self, _deadline: Instant) -> Result<InputLevels, Fault> {
        let image = *self.images.read();
        let inputs = image.inputs.filter(|_| image.connected);
        inputs.ok_or_else(|| match image.refused {
            Some(code) => Unanswered::Refused(code).fault(),
            None => Fault::NotConnected,
        })
    }

    /// Queues the outputs for the next exchange. A fault reports that an earlier write failed; these outputs are queued nevertheless, except
    /// without a connection or after the deadline.
    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault> {
        let (now, image) = (Instant::now(), *self.images.read());
        if !image.connected {
            self.told = self.number;
            self.unanswered = None;
            return Err(Fault::NotConnected);
        }
        if now >= deadline {
            return Err(Fault::TimedOut);
        }
        let failed = image.failed.filter(|(number, _)| *number > self.told);
        let answered = image
            .taken
            .max(image.failed.map_or(0, |(number, _)| number));
        if answered > self.answered {
            self.answered = answered;
            self.unanswered = None;
        }
        let silent = self.unanswered.is_some_and(|until| now >= until);
        self.number += 1;
        self.unanswered.get_or_insert(deadline);
        self.wanted.write(Wanted {
            levels,
            number: self.number,
            until: deadline,
        });
        match failed {
            Some((number, fault)) => {
                self.told = number;
                Err(fault)
            }
            None if silent => Err(Fault::TimedOut),
            None => Ok(()),
        }
    }

    fn confirmed(&self) -> Option<u64> {
        self.images.output_buffer().outputs
    }

    fn tells_outputs(&self) -> bool {
        !self.images.output_buffer().cannot_tell
    }
}
