//! Modules with digital lines, asked in the background; together they are one port.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use tokio_modbus::prelude::{Request, Response};
use volcomp_port::{Backoff, Clock, DeviceError, DigitalIo, Fault, UnopenedLines};

use crate::{
    bus::{Bus, Line, Unanswered, no_thread},
    profile::{Digital, Profile},
};

/// Inputs older than so many exchanges are not told any more.
const STALE_EXCHANGES: u32 = 5;

/// A module with lines.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DigitalModule {
    /// Its address on the line.
    pub unit: u8,
    /// The profile of the module: where its registers stand.
    pub profile: Profile,
}

/// The lines of some modules, the first module's lowest. Reading and writing never wait for the bus: inputs
/// are those of the last exchange, outputs go out with the next.
pub struct ModbusDigital {
    device: String,
    inputs: u32,
    outputs: u32,
    exchange: Duration,
    shared: Arc<Shared>,
}

struct Shared {
    clock: Clock,
    levels: AtomicU64,
    /// Nanoseconds of the clock at the last exchange, and 0 before it and after a loss.
    taken: AtomicU64,
    wanted: AtomicU64,
    has_wanted: AtomicBool,
    stop: AtomicBool,
}

impl ModbusDigital {
    /// The lines of some modules, without connecting.
    ///
    /// # Errors
    /// A configuration that makes no sense.
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

    /// Begins to exchange. `answer_within`: what a module takes at the most.
    ///
    /// # Errors
    /// A configuration that makes no sense.
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
        let shared = Arc::new(Shared {
            clock: Clock::system(),
            levels: AtomicU64::new(0),
            taken: AtomicU64::new(0),
            wanted: AtomicU64::new(0),
            has_wanted: AtomicBool::new(false),
            stop: AtomicBool::new(false),
        });
        let exchanger = Exchanger {
            bus,
            lines,
            answer_within,
            backoff,
            shared: Arc::clone(&shared),
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
            shared,
        })
    }
}

fn refused(bus: &Bus, what: String) -> DeviceError {
    DeviceError::option(bus.device(), what, "correct the configuration")
}

/// The address and the lines of each module.
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

/// The time that one exchange with all modules takes on the line: characters of 11 bits, gaps, and a turn of 2 ms.
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
        self.shared.stop.store(true, Ordering::Relaxed);
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

    /// The inputs of the last exchange.
    fn read(&mut self, _deadline: Instant) -> Result<u64, Fault> {
        let taken = Duration::from_nanos(self.shared.taken.load(Ordering::Acquire));
        if taken.is_zero() {
            return Err(Fault::NotConnected);
        }
        let age = self.shared.clock.elapsed().saturating_sub(taken);
        if age > (self.exchange * STALE_EXCHANGES).max(Duration::from_millis(50)) {
            return Err(Fault::TimedOut);
        }
        Ok(self.shared.levels.load(Ordering::Acquire))
    }

    /// The outputs of the next exchange.
    fn write(&mut self, levels: u64, _deadline: Instant) -> Result<(), Fault> {
        self.shared.wanted.store(levels, Ordering::Release);
        self.shared.has_wanted.store(true, Ordering::Release);
        if self.shared.taken.load(Ordering::Acquire) == 0 {
            return Err(Fault::NotConnected);
        }
        Ok(())
    }
}

struct Exchanger {
    bus: Bus,
    lines: Vec<(u8, Digital)>,
    answer_within: Duration,
    backoff: Backoff,
    shared: Arc<Shared>,
}

impl Exchanger {
    async fn run(self) {
        let mut pause = Duration::ZERO;
        while !self.stopped() {
            if let Ok(mut line) = self.bus.connect(self.answer_within * 4).await {
                let born = Instant::now();
                while !self.stopped() && self.exchange(&mut line).await != Err(Unanswered::Broken) {
                }
                if born.elapsed() > self.backoff.most {
                    pause = Duration::ZERO;
                }
            }
            self.shared.taken.store(0, Ordering::Release);
            pause = (pause * 2).clamp(self.backoff.first, self.backoff.most);
            let end = Instant::now() + pause;
            while !self.stopped() && Instant::now() < end {
                tokio::time::sleep(pause.min(Duration::from_millis(20))).await;
            }
        }
    }

    fn stopped(&self) -> bool {
        self.shared.stop.load(Ordering::Relaxed)
    }

    /// Reads all inputs and writes all outputs.
    async fn exchange(&self, line: &mut Line) -> Result<(), Unanswered> {
        let (mut levels, mut input, mut output) = (0, 0_u32, 0_u32);
        for (unit, digital) in &self.lines {
            if digital.inputs > 0 {
                let request = Request::ReadDiscreteInputs(digital.input_address, digital.inputs);
                let answer = line.ask(*unit, request, self.answer_within).await?;
                let Response::ReadDiscreteInputs(bits) = answer else {
                    return Err(Unanswered::Refused);
                };
                for (bit, level) in bits.iter().take(usize::from(digital.inputs)).enumerate() {
                    levels |= u64::from(*level) << (input as usize + bit);
                }
                input += u32::from(digital.inputs);
            }
            if digital.outputs > 0 && self.shared.has_wanted.load(Ordering::Acquire) {
                let wanted = self.shared.wanted.load(Ordering::Acquire) >> output;
                let bits: Vec<bool> = (0..digital.outputs)
                    .map(|bit| wanted >> bit & 1 == 1)
                    .collect();
                let request = Request::WriteMultipleCoils(digital.output_address, bits.into());
                line.ask(*unit, request, self.answer_within).await?;
            }
            output += u32::from(digital.outputs);
        }
        self.shared.levels.store(levels, Ordering::Release);
        let now = u64::try_from(self.shared.clock.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.shared.taken.store(now.max(1), Ordering::Release);
        Ok(())
    }
}
