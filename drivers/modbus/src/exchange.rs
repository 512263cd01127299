//! Exchanges inputs and outputs with the modules on a separate thread. Inputs are read continuously; outputs are
//! written once per request.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use tokio_modbus::prelude::{Request, Response};
use triple_buffer::{Input, Output};
use volcomp_port::{Backoff, Fault, InputLevels};

use crate::{
    bus::{Bus, Line, RequestError},
    profile::Digital,
};

/// Number of consecutive equal answers after which output levels that were read back are accepted. A single answer may
/// be wrong.
const REQUIRED_EQUAL_ANSWERS: u32 = 3;

/// Maximum number of consecutive read-backs of the outputs that time out or break the connection before one has
/// succeeded. Further read-backs are skipped over this connection or, if it broke, over the next one.
const MAX_READ_BACKS: u8 = 3;

/// Exception codes of a module that cannot read back any outputs, or not these outputs.
const UNSUPPORTED_CODES: [u8; 2] = [1, 2];

#[derive(Clone, Copy, Debug)]
pub(crate) struct OutputRequest {
    pub(crate) levels: u64,
    /// Sequence number of the write, from 1; 0 if no write was requested.
    pub(crate) number: u64,
    /// Deadline of the write. The write is not sent later, and fails if it is not acknowledged by then.
    pub(crate) until: Instant,
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Image {
    pub(crate) connected: bool,
    /// Input levels, with the arrival time of the oldest of them; `None` before the first reading over this connection.
    pub(crate) inputs: Option<InputLevels>,
    /// Exception code with which a module rejected the last reading of the inputs; `None` if no module rejected it.
    pub(crate) refused: Option<u8>,
    /// Last output levels that all modules accepted or, before the first write, output levels that were read back;
    /// `None` if unknown.
    pub(crate) outputs: Option<u64>,
    /// Whether a module has reported that it cannot read back its outputs.
    pub(crate) lacks_read_back: bool,
    /// Sequence number of the last write that all modules accepted.
    pub(crate) taken: u64,
    /// Sequence number and fault of the last write that failed.
    pub(crate) failed: Option<(u64, Fault)>,
}

pub(crate) struct Exchanger {
    pub(crate) bus: Bus,
    pub(crate) lines: Vec<(u8, Digital)>,
    pub(crate) answer_within: Duration,
    pub(crate) backoff: Backoff,
    pub(crate) requested: Output<OutputRequest>,
    pub(crate) images: Input<Image>,
    pub(crate) stop: Arc<AtomicBool>,
    pub(crate) image: Image,
    pub(crate) failed_read_backs: u8,
    /// Whether read-backs of the outputs are skipped over this connection.
    pub(crate) skips_read_back: bool,
    /// Whether a read-back has succeeded, which proves that the modules support it.
    pub(crate) has_read_back: bool,
}

impl Exchanger {
    pub(crate) async fn run(mut self) {
        let mut pause = Duration::ZERO;
        while !self.stopped() {
            let mut lived = Duration::ZERO;
            if let Ok(mut line) = self.bus.connect(self.answer_within * 4).await
                && self.begin(&mut line).await.is_ok()
            {
                let born = Instant::now();
                while !self.stopped() {
                    match self.exchange(&mut line).await {
                        Ok(()) => lived = born.elapsed(),
                        Err(RequestError::Disconnected) => break,
                        Err(
                            RequestError::NoAnswer
                            | RequestError::EchoOnly
                            | RequestError::Refused(_),
                        ) => {}
                    }
                }
            }
            self.image.connected = false;
            self.image.inputs = None;
            self.images.write(self.image);
            pause = self.backoff.next(pause, lived);
            let end = Instant::now() + pause;
            while !self.stopped() && Instant::now() < end {
                tokio::time::sleep(pause.min(Duration::from_millis(20))).await;
            }
        }
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Begins a connection: discards earlier write requests, and reads first the inputs and then the output levels.
    async fn begin(&mut self, line: &mut Line) -> Result<(), RequestError> {
        let number = self.requested.read().number;
        if number > self.image.taken {
            self.image.failed = Some((number, Fault::Disconnected));
        }
        self.image.outputs = None;
        // While a module does not answer, its ability to read back outputs is unknown. The read-back must not be
        // skipped when the module answers again.
        let read = self.inputs(line).await;
        if read == Err(RequestError::Disconnected) {
            return read;
        }
        self.skips_read_back = !self.has_read_back && self.failed_read_backs >= MAX_READ_BACKS;
        if self.skips_read_back {
            self.failed_read_backs = 0;
        }
        if read.is_ok() {
            self.read_back_outputs(line).await?;
        }
        self.image.connected = true;
        self.images.write(self.image);
        Ok(())
    }

    /// Reads back the output levels if they are unknown and the modules can report them. They are accepted after three
    /// consecutive equal answers.
    async fn read_back_outputs(&mut self, line: &mut Line) -> Result<(), RequestError> {
        let is_known = self.image.outputs.is_some() || self.image.lacks_read_back;
        let is_given_up = !self.has_read_back && self.failed_read_backs >= MAX_READ_BACKS;
        if is_known || self.skips_read_back || is_given_up {
            return Ok(());
        }
        self.failed_read_backs = self.failed_read_backs.saturating_add(1);
        let mut before = None;
        for _ in 0..REQUIRED_EQUAL_ANSWERS {
            let found = match self.outputs(line).await {
                Ok(found) => found,
                Err(RequestError::Disconnected) => return Err(RequestError::Disconnected),
                Err(RequestError::NoAnswer | RequestError::EchoOnly) => return Ok(()),
                Err(RequestError::Refused(code)) => {
                    self.image.lacks_read_back = UNSUPPORTED_CODES.contains(&code);
                    before = None;
                    break;
                }
            };
            if before.replace(found).is_some_and(|before| before != found) {
                before = None;
                break;
            }
        }
        self.failed_read_backs = 0;
        self.image.outputs = before;
        self.has_read_back |= before.is_some();
        Ok(())
    }

    async fn outputs(&self, line: &mut Line) -> Result<u64, RequestError> {
        let (mut levels, mut first) = (0, 0_u32);
        for (unit, digital) in self.lines.iter().filter(|(_, d)| d.outputs > 0) {
            let request = Request::ReadCoils(digital.output_address, digital.outputs);
            let Response::ReadCoils(bits) =
                line.request(*unit, request, self.answer_within).await?
            else {
                return Err(RequestError::Refused(0));
            };
            levels |= gathered(&bits, digital.outputs, first);
            first += u32::from(digital.outputs);
        }
        Ok(levels)
    }

    async fn exchange(&mut self, line: &mut Line) -> Result<(), RequestError> {
        let read = self.inputs(line).await;
        self.image.refused = match read {
            Err(RequestError::Refused(code)) => Some(code),
            _ => None,
        };
        let read_back = match read {
            Ok(()) => self.read_back_outputs(line).await,
            Err(_) => Ok(()),
        };
        let written = if [read, read_back].contains(&Err(RequestError::Disconnected)) {
            Ok(())
        } else {
            self.write(line).await
        };
        let is_silent = |found: &Result<(), RequestError>| {
            matches!(found, Err(RequestError::NoAnswer | RequestError::EchoOnly))
        };
        let is_refused =
            matches!(written, Err(RequestError::Refused(_))) && !self.image.lacks_read_back;
        if is_refused || [read, written].iter().any(is_silent) {
            // A module that did not answer may have lost power, and a module that rejected a write may have switched
            // some of its outputs. So the output levels are read back again.
            self.image.outputs = None;
            self.failed_read_backs = 0;
        }
        self.images.write(self.image);
        // Return the error of the write first, so that an earlier rejected reading does not hide a broken connection.
        written.and(read_back).and(read)
    }

    async fn inputs(&mut self, line: &mut Line) -> Result<(), RequestError> {
        let (mut levels, mut first, mut oldest) = (0, 0_u32, None);
        for (unit, digital) in self.lines.iter().filter(|(_, d)| d.inputs > 0) {
            let request = Request::ReadDiscreteInputs(digital.input_address, digital.inputs);
            let Response::ReadDiscreteInputs(bits) =
                line.request(*unit, request, self.answer_within).await?
            else {
                return Err(RequestError::Refused(0));
            };
            oldest = oldest.or(Some(Instant::now()));
            levels |= gathered(&bits, digital.inputs, first);
            first += u32::from(digital.inputs);
        }
        let taken = oldest.unwrap_or_else(Instant::now);
        self.image.inputs = Some(InputLevels { levels, taken });
        Ok(())
    }

    async fn write(&mut self, line: &mut Line) -> Result<(), RequestError> {
        let requested = *self.requested.read();
        let failed = self.image.failed.map_or(0, |(number, _)| number);
        if requested.number <= self.image.taken.max(failed) {
            return Ok(());
        }
        let written = self.send(line, &requested).await;
        match written {
            Ok(()) => {
                self.image.taken = requested.number;
                self.image.outputs = Some(requested.levels);
            }
            Err(error) => self.image.failed = Some((requested.number, error.fault())),
        }
        written
    }

    async fn send(&self, line: &mut Line, requested: &OutputRequest) -> Result<(), RequestError> {
        let mut first = 0_u32;
        for (unit, digital) in self.lines.iter().filter(|(_, d)| d.outputs > 0) {
            if Instant::now() >= requested.until {
                return Err(RequestError::NoAnswer);
            }
            let bits: Vec<bool> = (0..u32::from(digital.outputs))
                .map(|bit| requested.levels >> (first + bit) & 1 == 1)
                .collect();
            let request = Request::WriteMultipleCoils(digital.output_address, bits.into());
            let write_timeout = line.write_timeout(self.answer_within, requested.until);
            line.request(*unit, request, write_timeout).await?;
            first += u32::from(digital.outputs);
        }
        Ok(())
    }
}

/// Levels from the first `count` bits of an answer. The first bit becomes line `first`.
fn gathered(bits: &[bool], count: u16, first: u32) -> u64 {
    let lines = bits.iter().take(usize::from(count)).zip(first..64);
    lines.fold(0, |levels, (level, line)| levels | u64::from(*level) << line)
}
