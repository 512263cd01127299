//! Sender of a map: selects the next frame from the control's last report, and so transfers a map and keeps it valid, one exchange at a time.

use volcomp_guard::protocol::{Refusal, ReportStatus, Session};

use crate::{
    control::{Body, DATA_WORDS, FRAME_WORDS, Frame, Report},
    map::{HEADER_WORDS, Map, OUTPUTS},
};

/// Next action of a sender so that the control uses its map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NextAction {
    /// Write a frame with this content to the mailbox.
    Write(Body),
    /// Read back the words of the loaded buffer, compare them with the map, and pass the result to the next call.
    ReadBack {
        /// Index of the loaded buffer, 0 or 1.
        buffer: u16,
    },
}

/// Result of reading back the loaded words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadBackResult {
    /// Not read back yet.
    Unknown,
    /// Equal to the map.
    Same,
    /// Different from the map.
    Other,
}

/// Selects the next action that makes `map` active or keeps it active. `report` is the control's last report. The function is stateless: after
/// any loss it continues from the state of the control.
#[must_use]
pub fn next_write(map: &Map, machine: u16, report: &Report, loaded: ReadBackResult) -> NextAction {
    let counter = map.header().counter;
    let words = u16::try_from(map.words().len()).unwrap_or(u16::MAX);
    let body = match report.loading {
        _ if report.valid && report.counter == counter => Body::Keep { counter },
        Some((loading, next)) if loading == counter && loaded != ReadBackResult::Other => {
            if next < words {
                words_from(map, next)
            } else if loaded == ReadBackResult::Same {
                let check = map.checksum(machine);
                Body::Swap { counter, check }
            } else {
                let buffer = 1 - report.buffer.min(1);
                return NextAction::ReadBack { buffer };
            }
        }
        _ => Body::Begin { counter, words },
    };
    NextAction::Write(body)
}

/// Contents of the frames of the complete transfer of a map: begin, words, swap.
pub fn writes(map: &Map, machine: u16) -> impl Iterator<Item = Body> + '_ {
    let counter = map.header().counter;
    let words = u16::try_from(map.words().len()).unwrap_or(u16::MAX);
    let check = map.checksum(machine);
    core::iter::once(Body::Begin { counter, words })
        .chain((0..words).step_by(DATA_WORDS).map(|place| words_from(map, place)))
        .chain(core::iter::once(Body::Swap { counter, check }))
}

fn words_from(map: &Map, place: u16) -> Body {
    let mut data = [0; DATA_WORDS];
    let rest = map.words().get(usize::from(place)..).unwrap_or_default();
    for (into, word) in data.iter_mut().zip(rest) {
        *into = *word;
    }
    Body::Words { place, data }
}

/// Transport of words to and from a control.
pub trait Exchange {
    /// Error of the transport.
    type Error;

    /// Reads the words of the report; additional words may follow.
    ///
    /// # Errors
    /// The words cannot be read.
    fn report(&mut self) -> Result<Vec<u16>, Self::Error>;

    /// Writes a frame to the mailbox, in one piece.
    ///
    /// # Errors
    /// The write was rejected, or it is unknown whether it arrived.
    fn write(&mut self, frame: &[u16; FRAME_WORDS]) -> Result<(), Self::Error>;

    /// Reads the first `count` words of a buffer, 0 or 1.
    ///
    /// # Errors
    /// The words cannot be read.
    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, Self::Error>;
}

/// Limits that the sender enforces on the map and on the settings of the control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SenderLimits {
    /// Maximum correction, mm.
    pub limit_mm: f64,
    /// Maximum rate of change of a correction, mm/s.
    pub slew_mm_per_s: f64,
    /// Maximum timeout of the control, s, after which its corrections ramp to zero. The duration of the ramp follows from their
    /// limit and rate, see [`Settings::zero_within_scans`](crate::control::Settings::zero_within_scans).
    pub zero_after_s: f64,
    /// Scan time of the control's program, s.
    pub scan_s: f64,
    /// Size of each buffer of the control, words.
    pub capacity: usize,
}

/// Reasons why a map is not sent to a control.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LimitError {
    #[error("the map has {found} words, expected at most {capacity}, the size of a buffer")]
    Words { found: usize, capacity: usize },
    #[error("the map corrects by up to {found_um:.1} µm, expected at most {limit_um:.1} µm")]
    Value { found_um: f64, limit_um: f64 },
    #[error(
        "the control accepts corrections up to {found_um:.1} µm, expected at most {limit_um:.1} µm"
    )]
    Limit { found_um: f64, limit_um: f64 },
    #[error(
        "the control moves a correction at {found_um_per_s:.1} µm/s, expected at most {slew_um_per_s:.1} µm/s"
    )]
    Rate { found_um_per_s: f64, slew_um_per_s: f64 },
    #[error(
        "the control begins to go to zero {found_s:.3} s after the last frame, expected at most {zero_after_s:.3} s"
    )]
    TimeOut { found_s: f64, zero_after_s: f64 },
}

impl SenderLimits {
    /// Checks a map against the limits.
    ///
    /// # Errors
    /// The map is too large, or a correction exceeds the limit.
    pub fn check_map(&self, map: &Map) -> Result<(), LimitError> {
        let (found, capacity) = (map.words().len(), self.capacity);
        if found > capacity {
            return Err(LimitError::Words { found, capacity });
        }
        let header = map.header();
        let outputs = header.outputs.count().min(OUTPUTS);
        for output in 0..outputs {
            let values = map.words()[HEADER_WORDS..].iter().skip(output);
            let largest =
                values.step_by(outputs).map(|word| i32::from(word.cast_signed()).abs()).max();
            let reversal_rows = header.reversal.iter();
            let reversals: i32 = reversal_rows.map(|row| i32::from(row[output]).abs()).sum();
            let parts = f64::from(largest.unwrap_or(0) + reversals);
            let found_mm = parts * step_mm(map, output) / f64::from(header.scale);
            if found_mm > self.limit_mm {
                return Err(LimitError::Value {
                    found_um: found_mm * 1e3,
                    limit_um: self.limit_mm * 1e3,
                });
            }
        }
        Ok(())
    }

    /// Checks the settings that a control reports against the limits.
    ///
    /// # Errors
    /// The first limit that the control exceeds.
    pub fn check_control(&self, map: &Map, report: &Report) -> Result<(), LimitError> {
        // Tolerates the rounding of the conversion to steps.
        let beyond = |found: f64, most: f64| found.is_nan() || found > most * (1.0 + 1e-9);
        let report = &report.of.settings;
        for output in 0..map.header().outputs.count().min(OUTPUTS) {
            let step = step_mm(map, output);
            let limit = f64::from(report.limit[output]) * step;
            if beyond(limit, self.limit_mm) {
                return Err(LimitError::Limit {
                    found_um: limit * 1e3,
                    limit_um: self.limit_mm * 1e3,
                });
            }
            let every_s = f64::from(report.step_scans) * self.scan_s;
            let rate = f64::from(report.rate[output]) * step / every_s;
            if beyond(rate, self.slew_mm_per_s) {
                return Err(LimitError::Rate {
                    found_um_per_s: rate * 1e3,
                    slew_um_per_s: self.slew_mm_per_s * 1e3,
                });
            }
        }
        let found_s = f64::from(report.time_out_scans) * self.scan_s;
        if beyond(found_s, self.zero_after_s) {
            return Err(LimitError::TimeOut { found_s, zero_after_s: self.zero_after_s });
        }
        Ok(())
    }
}

fn step_mm(map: &Map, output: usize) -> f64 {
    f64::from(map.header().output_step_nm[output]) * 1e-6
}

/// Result of a step of the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The report was torn or belongs to another machine; nothing was sent.
    Unreadable,
    /// The control has not scanned since the last report; nothing was sent.
    NotScanned,
    /// A part of the map was sent, or the loaded words were read back.
    Loading,
    /// The map is active, and a keep-alive frame was sent.
    Kept,
}

/// Reasons why a step of the sender fails.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SendError<E> {
    /// Transport error. The next step continues from the state of the control.
    #[error(transparent)]
    Exchange(E),
    /// Another sender controls the link; nothing was sent.
    #[error("another sender, number {by}, holds the control")]
    Held {
        /// Number of the other sender.
        by: u16,
        /// Sequence number of the other sender's last frame; it stays constant if that sender has stopped.
        sequence: u16,
    },
    /// The control or the map exceeds the limits.
    #[error(transparent)]
    Limit(#[from] LimitError),
    /// The control rejects the map.
    #[error("the control rejects the map: {0}")]
    Refused(Refusal),
}

/// Maximum number of times that the transfer of a rejected map is restarted.
const MAX_RESTARTS: u32 = 8;

/// Sender of one map. State: whether the loaded words were read back, the last tick of the control, and the map active
/// in the control.
#[derive(Clone, Debug)]
pub struct Sender {
    map: Map,
    machine: u16,
    session: Session,
    allowed: SenderLimits,
    loaded: ReadBackResult,
    restarts: u32,
    tick: Option<u16>,
    in_use: Option<u16>,
}

impl Sender {
    /// Creates a sender of this map for the control of this machine. `owner` is a random number that identifies the sender, not 0.
    ///
    /// # Errors
    /// The map exceeds the limits.
    pub fn new(
        map: Map,
        machine: u16,
        owner: u16,
        allowed: SenderLimits,
    ) -> Result<Self, LimitError> {
        allowed.check_map(&map)?;
        Ok(Self {
            map,
            machine,
            session: Session::new(owner),
            allowed,
            loaded: ReadBackResult::Unknown,
            restarts: 0,
            tick: None,
            in_use: None,
        })
    }

    /// Replaces the map and returns the previous one, which stays active in the control until the new one is loaded completely.
    ///
    /// # Errors
    /// The map exceeds the limits; the previous one then stays.
    pub fn replace(&mut self, map: Map) -> Result<Map, LimitError> {
        self.allowed.check_map(&map)?;
        (self.loaded, self.restarts) = (ReadBackResult::Unknown, 0);
        Ok(std::mem::replace(&mut self.map, map))
    }

    /// Number of the map that was active in the control at the last report, whichever sender
    /// transferred it. `None`: no map was active, and the corrections were zero or ramping to zero.
    #[must_use]
    pub fn in_use(&self) -> Option<u16> {
        self.in_use
    }

    /// Decodes the words of a report; `None` if they are torn or belong to another machine.
    #[must_use]
    pub fn decode_report(&self, words: &[u16]) -> Option<Report> {
        Report::decode(self.machine, self.map.header().outputs, words)
    }

    /// Reads the control's report and sends the next frame.
    ///
    /// # Errors
    /// See [`SendError`]; after [`SendError::Exchange`] the step can be retried.
    pub fn step<C: Exchange>(&mut self, control: &mut C) -> Result<Step, SendError<C::Error>> {
        let words = control.report().map_err(|error| {
            // The tick may wrap around before the next report.
            self.session.forget();
            SendError::Exchange(error)
        })?;
        let Some(report) = self.decode_report(&words) else {
            return Ok(Step::Unreadable);
        };
        self.in_use = report.valid.then_some(report.counter);
        // A frame with an unchanged tick would be wrong: a stopped program would get its own old tick indefinitely.
        if self.tick.replace(report.of.tick) == Some(report.of.tick) {
            return Ok(Step::NotScanned);
        }
        self.allowed.check_control(&self.map, &report)?;
        match self.session.read(report.of.head()) {
            ReportStatus::Held { owner: by } => {
                let sequence = report.of.sequence;
                return Err(SendError::Held { by, sequence });
            }
            ReportStatus::Old => return Ok(Step::NotScanned),
            ReportStatus::Confirmed { .. } => {}
        }
        let body = match next_write(&self.map, self.machine, &report, self.loaded) {
            NextAction::ReadBack { buffer } => {
                let expected = self.map.words();
                let found = control.buffer(buffer, expected.len()).map_err(SendError::Exchange)?;
                self.loaded =
                    if found == expected { ReadBackResult::Same } else { ReadBackResult::Other };
                return Ok(Step::Loading);
            }
            NextAction::Write(body) => body,
        };
        let step = match body {
            Body::Keep { .. } => {
                self.restarts = 0;
                Step::Kept
            }
            Body::Begin { .. } => {
                self.loaded = ReadBackResult::Unknown;
                if matches!(report.of.refusal, Refusal::Value | Refusal::Fit | Refusal::Map) {
                    self.restarts += 1;
                    if self.restarts > MAX_RESTARTS {
                        return Err(SendError::Refused(report.of.refusal));
                    }
                }
                Step::Loading
            }
            Body::Words { .. } | Body::Swap { .. } => Step::Loading,
        };
        if let Some(head) = self.session.answer() {
            let frame = Frame { head, body };
            let words = frame.encode(self.machine, self.map.header().outputs);
            control.write(&words).map_err(SendError::Exchange)?;
        }
        Ok(step)
    }
}
