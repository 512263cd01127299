//! The exchanges with modules with lines, on a thread of their own: inputs are read over and over, outputs are written
//! once for each time that they are asked for.

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
    bus::{Bus, Line, Unanswered},
    profile::Digital,
};

/// So many equal answers tell what the outputs of a module are: one wrong answer is not believed.
const EQUAL_ANSWERS: u32 = 3;

/// Connections in a row that may break while the modules are asked for the levels of their outputs.
pub(crate) const OUTPUT_TRIES: u8 = 3;

/// Outputs that are to be written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted {
    pub(crate) levels: u64,
    /// Counts the writes from 1 on; 0: none was asked for.
    pub(crate) number: u64,
    /// A write that has not begun by then is not made.
    pub(crate) until: Instant,
}

/// What the exchanges have brought so far.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Image {
    /// Whether there is a connection.
    pub(crate) connected: bool,
    /// The inputs, and when the oldest part of them came.
    pub(crate) inputs: Option<InputLevels>,
    /// The levels that the modules confirmed last: those of the last write that all of them took, before it those that
    /// they told of themselves.
    pub(crate) outputs: Option<u64>,
    /// The last write that all modules took.
    pub(crate) taken: u64,
    /// The last write that failed, and why.
    pub(crate) failed: Option<(u64, Fault)>,
}

/// The side of the exchanges.
pub(crate) struct Exchanger {
    pub(crate) bus: Bus,
    pub(crate) lines: Vec<(u8, Digital)>,
    pub(crate) answer_within: Duration,
    pub(crate) backoff: Backoff,
    pub(crate) wanted: Output<Wanted>,
    pub(crate) images: Input<Image>,
    pub(crate) stop: Arc<AtomicBool>,
    pub(crate) image: Image,
    /// At so many connections in a row that broke meanwhile the modules are still asked for the levels of their outputs.
    pub(crate) tries_left: u8,
}

impl Exchanger {
    pub(crate) async fn run(mut self) {
        let mut pause = Duration::ZERO;
        while !self.stopped() {
            if let Ok(mut line) = self.bus.connect(self.answer_within * 4).await {
                let born = Instant::now();
                if self.begin(&mut line).await.is_ok() {
                    while !self.stopped()
                        && self.exchange(&mut line).await != Err(Unanswered::Broken)
                    {
                    }
                }
                if born.elapsed() > self.backoff.most {
                    pause = Duration::ZERO;
                }
            }
            self.image.connected = false;
            self.image.inputs = None;
            self.images.write(self.image);
            pause = (pause * 2).clamp(self.backoff.first, self.backoff.most);
            let end = Instant::now() + pause;
            while !self.stopped() && Instant::now() < end {
                tokio::time::sleep(pause.min(Duration::from_millis(20))).await;
            }
        }
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Begins a connection: what was asked for before it is not written any more, and the modules tell the levels that
    /// their outputs have.
    async fn begin(&mut self, line: &mut Line) -> Result<(), Unanswered> {
        let number = self.wanted.read().number;
        if number > self.image.taken {
            self.image.failed = Some((number, Fault::Disconnected));
        }
        if self.tries_left > 0 {
            // Asking may break the connection: after some that broke they do without.
            self.tries_left -= 1;
            self.image.outputs = self.found_outputs(line).await?;
            self.tries_left = OUTPUT_TRIES;
        } else {
            self.image.outputs = None;
        }
        self.image.connected = true;
        self.images.write(self.image);
        Ok(())
    }

    /// The levels of the outputs as the modules tell them three times in a row; `None` where one does not tell, or tells
    /// one thing and another.
    async fn found_outputs(&self, line: &mut Line) -> Result<Option<u64>, Unanswered> {
        let first = self.outputs(line).await?;
        for _ in 1..EQUAL_ANSWERS {
            if first.is_none() || self.outputs(line).await? != first {
                return Ok(None);
            }
        }
        Ok(first)
    }

    /// The levels of the outputs by the modules; `None` where one does not tell.
    async fn outputs(&self, line: &mut Line) -> Result<Option<u64>, Unanswered> {
        let (mut levels, mut first) = (0, 0_u32);
        for (unit, digital) in self.lines.iter().filter(|(_, d)| d.outputs > 0) {
            let request = Request::ReadCoils(digital.output_address, digital.outputs);
            match line.ask(*unit, request, self.answer_within).await {
                Ok(Response::ReadCoils(bits)) => levels |= gathered(&bits, digital.outputs, first),
                Err(Unanswered::Broken) => return Err(Unanswered::Broken),
                Ok(_) | Err(Unanswered::Silent | Unanswered::Refused(_)) => return Ok(None),
            }
            first += u32::from(digital.outputs);
        }
        Ok(Some(levels))
    }

    /// Reads all inputs, and writes all outputs where that was asked for since.
    async fn exchange(&mut self, line: &mut Line) -> Result<(), Unanswered> {
        let read = self.inputs(line).await;
        let written = match read {
            Err(Unanswered::Broken) => Ok(()),
            _ => self.write(line).await,
        };
        self.images.write(self.image);
        // A connection that broke while it was written must not hide behind a refused reading.
        written.and(read)
    }

    async fn inputs(&mut self, line: &mut Line) -> Result<(), Unanswered> {
        let (mut levels, mut first, mut oldest) = (0, 0_u32, None);
        for (unit, digital) in self.lines.iter().filter(|(_, d)| d.inputs > 0) {
            let request = Request::ReadDiscreteInputs(digital.input_address, digital.inputs);
            let Response::ReadDiscreteInputs(bits) =
                line.ask(*unit, request, self.answer_within).await?
            else {
                return Err(Unanswered::Refused(0));
            };
            oldest = oldest.or(Some(Instant::now()));
            levels |= gathered(&bits, digital.inputs, first);
            first += u32::from(digital.inputs);
        }
        let taken = oldest.unwrap_or_else(Instant::now);
        self.image.inputs = Some(InputLevels { levels, taken });
        Ok(())
    }

    async fn write(&mut self, line: &mut Line) -> Result<(), Unanswered> {
        let wanted = *self.wanted.read();
        let failed = self.image.failed.map_or(0, |(number, _)| number);
        if wanted.number <= self.image.taken.max(failed) {
            return Ok(());
        }
        let written = self.send(line, &wanted).await;
        match written {
            Ok(()) => {
                self.image.taken = wanted.number;
                self.image.outputs = Some(wanted.levels);
            }
            Err(unanswered) => self.image.failed = Some((wanted.number, unanswered.fault())),
        }
        written
    }

    async fn send(&self, line: &mut Line, wanted: &Wanted) -> Result<(), Unanswered> {
        let mut first = 0_u32;
        for (unit, digital) in self.lines.iter().filter(|(_, d)| d.outputs > 0) {
            if Instant::now() >= wanted.until {
                return Err(Unanswered::Silent);
            }
            let bits: Vec<bool> = (0..u32::from(digital.outputs))
                .map(|bit| wanted.levels >> (first + bit) & 1 == 1)
                .collect();
            let request = Request::WriteMultipleCoils(digital.output_address, bits.into());
            line.ask(*unit, request, self.answer_within).await?;
            first += u32::from(digital.outputs);
        }
        Ok(())
    }
}

/// The first `count` bits of an answer as levels from the line `first` on.
fn gathered(bits: &[bool], count: u16, first: u32) -> u64 {
    let lines = bits.iter().take(usize::from(count)).zip(first..64);
    lines.fold(0, |levels, (level, line)| {
        levels | u64::from(*level) << line
    })
}
