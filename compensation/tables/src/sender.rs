//! The sender: selects the next frame from the control's last report, and so transfers a map and keeps it valid, one exchange after the
//! other.

use volcomp_guard::protocol::{Refusal, ReportStatus, Session};

use crate::{
    control::{Body, DATA, FRAME_WORDS, Frame, Report},
    map::{HEADER_WORDS, Map, OUTPUTS},
};

/// Next action of a sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Write a frame with this content.
    Write(Body),
    /// Read back the words of this buffer, 0 or 1, compare them with the map, and call again with the result.
    ReadBack {
        /// The loaded buffer.
        buffer: u16,
    },
}

/// Result of reading back the loaded words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loaded {
    /// Not read back yet.
    Unknown,
    /// Equal to the map.
    Same,
    /// Different from the map.
    Other,
}

/// Next action to make `map` active and keep it so. `seen` is the control's last report. The function is stateless: after any loss it
/// continues from the state of the control.
#[must_use]
pub fn next_write(map: &Map, machine: u16, seen: &Report, loaded: Loaded) -> Next {
    let counter = map.header().counter;
    let words = u16::try_from(map.words().len()).unwrap_or(u16::MAX);
    let body = match seen.loading {
        _ if seen.valid && seen.counter == counter => Body::Keep { counter },
        Some((loading, next)) if loading == counter && loaded != Loaded::Other => {
            if next < words {
                words_from(map, next)
            } else if loaded == Loaded::Same {
                let check = map.checksum(machine);
                Body::Swap { counter, check }
            } else {
                let buffer = 1 - seen.buffer.min(1);
                return Next::ReadBack { buffer };
            }
        }
        _ => Body::Begin { counter, words },
    };
    Next::Write(body)
}

/// The complete transfer of a map in order: begin, words, swap.
pub fn writes(map: &Map, machine: u16) -> impl Iterator<Item = Body> + '_ {
    let counter = map.header().counter;
    // At most 32767 words.
    let words = u16::try_from(map.words().len()).unwrap_or(u16::MAX);
    let check = map.checksum(machine);
    core::iter::once(Body::Begin { counter, words })
        .chain((0..words).step_by(DATA).map(|place| words_from(map, place)))
        .chain(core::iter::once(Body::Swap { counter, check }))
}

fn words_from(map: &Map, place: u16) -> Body {
    let mut data = [0; DATA];
    let rest = map.words().get(usize::from(place)..).unwrap_or_default();
    for (into, word) in data.iter_mut().zip(rest) {
        *into = *word;
    }
    Body::Words { place, data }
}

/// Transport of words to and from a control.
pub trait Exchange {
    /// Transport error.
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

/// Limits that the sender sets on the map and the control.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed {
    /// Maximum correction, mm.
    pub limit_mm: f64,
    /// Maximum rate of change of a correction, mm/s.
    pub slew_mm_per_s: f64,
    /// Maximum timeout of the control, s, after which its corrections start to go to zero. How long that takes follows from their limit and
    /// rate, see [`Settings::zero_within_scans`](crate::control::Settings::zero_within_scans).
    pub zero_after_s: f64,
    /// Scan time of the control's program, s.
    pub scan_s: f64,
    /// Size of each buffer of the control, words.
    pub capacity: usize,
}

/// Reason why a map is not sent to this control.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Unfit {
    /// The map is larger than a buffer.
    #[error("the map has {found} words, expected {capacity} at the most, the words of a buffer")]
    Words {
        /// Words of the map.
        found: usize,
        /// Words of a buffer.
        capacity: usize,
    },
    /// A value of the map exceeds the limit.
    #[error("the map corrects by up to {found_um:.1} µm, expected {limit_um:.1} µm at the most")]
    Value {
        /// The largest value including all reversals, µm.
        found_um: f64,
        /// The limit, µm.
        limit_um: f64,
    },
    /// The control's own limit is wider.
    #[error(
        "the control takes corrections up to {found_um:.1} µm, expected {limit_um:.1} µm at the most"
    )]
    Limit {
        /// Limit of the control, µm.
        found_um: f64,
        /// Limit of the sender, µm.
        limit_um: f64,
    },
    /// The control changes corrections faster.
    #[error(
        "the control moves a correction at {found_um_per_s:.1} µm/s, expected {slew_um_per_s:.1} µm/s at the most"
    )]
    Rate {
        /// Rate of the control, µm/s.
        found_um_per_s: f64,
        /// Rate limit of the sender, µm/s.
        slew_um_per_s: f64,
    },
    /// The timeout of the control is longer.
    #[error(
        "the control begins to go to zero {found_s:.3} s after the last frame, expected {zero_after_s:.3} s at the most"
    )]
    TimeOut {
        /// Timeout of the control, s.
        found_s: f64,
        /// Maximum timeout, s.
        zero_after_s: f64,
    },
}

impl Allowed {
    /// Checks a map against the limits.
    ///
    /// # Errors
    /// The map is too large, or a correction exceeds the limit.
    pub fn admits(&self, map: &Map) -> Result<(), Unfit> {
        let (found, capacity) = (map.words().len(), self.capacity);
        if found > capacity {
            return Err(Unfit::Words { found, capacity });
        }
        let header = map.header();
        let outputs = header.outputs.count().min(OUTPUTS);
        for output in 0..outputs {
            let values = map.words()[HEADER_WORDS..].iter().skip(output);
            let largest = values
                .step_by(outputs)
                .map(|word| i32::from(word.cast_signed()).abs())
                .max();
            let turned = header.reversal.iter();
            let reversals: i32 = turned.map(|row| i32::from(row[output]).abs()).sum();
            let parts = f64::from(largest.unwrap_or(0) + reversals);
            let found_mm = parts * step_mm(map, output) / f64::from(header.scale);
            if found_mm > self.limit_mm {
                return Err(Unfit::Value {
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
    pub fn is_kept_by(&self, map: &Map, seen: &Report) -> Result<(), Unfit> {
        // Tolerates the rounding of numbers that were converted to steps.
        let beyond = |found: f64, most: f64| found.is_nan() || found > most * (1.0 + 1e-9);
        let seen = &seen.of.settings;
        for output in 0..map.header().outputs.count().min(OUTPUTS) {
            let step = step_mm(map, output);
            let limit = f64::from(seen.limit[output]) * step;
            if beyond(limit, self.limit_mm) {
                return Err(Unfit::Limit {
                    found_um: limit * 1e3,
                    limit_um: self.limit_mm * 1e3,
                });
            }
            let every_s = f64::from(seen.step_scans) * self.scan_s;
            let rate = f64::from(seen.rate[output]) * step / every_s;
            if beyond(rate, self.slew_mm_per_s) {
                return Err(Unfit::Rate {
                    found_um_per_s: rate * 1e3,
                    slew_um_per_s: self.slew_mm_per_s * 1e3,
                });
            }
        }
        let found_s = f64::from(seen.time_out_scans) * self.scan_s;
        if beyond(found_s, self.zero_after_s) {
            return Err(Unfit::TimeOut {
                found_s,
                zero_after_s: self.zero_after_s,
            });
        }
        Ok(())
    }
}

fn step_mm(map: &Map, output: usize) -> f64 {
    f64::from(map.header().output_step_nm[output]) * 1e-6
}

/// Result of one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The report was torn or belongs to another machine: nothing was sent.
    Unreadable,
    /// The control has not scanned since the last report: nothing was sent.
    Stands,
    /// A part of the map was sent, or the loaded words were read back.
    Loading,
    /// The map is active, and a keep-alive frame was sent.
    Kept,
}

/// Reason why a sender stops.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SendError<E> {
    /// Transport error. The next step continues from the state of the control.
    #[error(transparent)]
    Exchange(E),
    /// Another sender controls the link: nothing was sent.
    #[error("another sender, number {by}, holds the control")]
    Held {
        /// Number of the other sender.
        by: u16,
        /// Sequence number of its last frame: it stays constant if that sender has stopped.
        sequence: u16,
    },
    /// The control or the map exceeds the limits.
    #[error(transparent)]
    Unfit(#[from] Unfit),
    /// The control rejects the map.
    #[error("the control does not take the map: {0}")]
    Refused(Refusal),
}

/// Maximum number of times that the transfer of a rejected map is restarted.
const BEGINNINGS: u32 = 8;

/// A sender of one map. State: of the control it only keeps whether the words there were read back.
#[derive(Clone, Debug)]
pub struct Sender {
    map: Map,
    machine: u16,
    session: Session,
    allowed: Allowed,
    loaded: Loaded,
    begun: u32,
    tick: Option<u16>,
    in_use: Option<u16>,
}

impl Sender {
    /// A sender of this map for the control of this machine. `owner` is a random number for this sender, not 0.
    ///
    /// # Errors
    /// The map exceeds the limits.
    pub fn new(map: Map, machine: u16, owner: u16, allowed: Allowed) -> Result<Self, Unfit> {
        allowed.admits(&map)?;
        Ok(Self {
            map,
            machine,
            session: Session::new(owner),
            allowed,
            loaded: Loaded::Unknown,
            begun: 0,
            tick: None,
            in_use: None,
        })
    }

    /// Replaces the map and returns the previous one. The control keeps that active until it has received all of the new one.
    ///
    /// # Errors
    /// The map exceeds the limits: the previous one stays.
    pub fn replace(&mut self, map: Map) -> Result<Map, Unfit> {
        self.allowed.admits(&map)?;
        (self.loaded, self.begun) = (Loaded::Unknown, 0);
        Ok(std::mem::replace(&mut self.map, map))
    }

    /// Number of the map that was active in the control at the last read, whoever sent it; `None`: none was, and the corrections were zero
    /// or on the way there.
    #[must_use]
    pub fn in_use(&self) -> Option<u16> {
        self.in_use
    }

    /// Decodes the words of a report; `None` if they are torn or belong to another machine.
    #[must_use]
    pub fn seen(&self, words: &[u16]) -> Option<Report> {
        Report::decode(self.machine, self.map.header().outputs, words)
    }

    /// Reads the control's report, and sends the next frame.
    ///
    /// # Errors
    /// See [`SendError`]; after [`SendError::Exchange`] the step can be retried.
    pub fn step<C: Exchange>(&mut self, control: &mut C) -> Result<Step, SendError<C::Error>> {
        let words = control.report().map_err(|error| {
            // The tick may have wrapped around by the next report.
            self.session.forget();
            SendError::Exchange(error)
        })?;
        let Some(seen) = self.seen(&words) else {
            return Ok(Step::Unreadable);
        };
        self.in_use = seen.valid.then_some(seen.counter);
        // A stopped program would be answered with its own old tick forever.
        if self.tick.replace(seen.of.tick) == Some(seen.of.tick) {
            return Ok(Step::Stands);
        }
        self.allowed.is_kept_by(&self.map, &seen)?;
        match self.session.read(seen.of.head()) {
            ReportStatus::Held { owner: by } => {
                let sequence = seen.of.sequence;
                return Err(SendError::Held { by, sequence });
            }
            ReportStatus::Old => return Ok(Step::Stands),
            ReportStatus::Confirmed { .. } => {}
        }
        let body = match next_write(&self.map, self.machine, &seen, self.loaded) {
            Next::ReadBack { buffer } => {
                let wanted = self.map.words();
                let found = control
                    .buffer(buffer, wanted.len())
                    .map_err(SendError::Exchange)?;
                self.loaded = if found == wanted {
                    Loaded::Same
                } else {
                    Loaded::Other
                };
                return Ok(Step::Loading);
            }
            Next::Write(body) => body,
        };
        let step = match body {
            Body::Keep { .. } => {
                self.begun = 0;
                Step::Kept
            }
            Body::Begin { .. } => {
                self.loaded = Loaded::Unknown;
                if matches!(
                    seen.of.refusal,
                    Refusal::Value | Refusal::Fit | Refusal::Map
                ) {
                    self.begun += 1;
                    if self.begun > BEGINNINGS {
                        return Err(SendError::Refused(seen.of.refusal));
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
