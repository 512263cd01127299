//! Real-time controller: one read and one write per cycle, in the forms that the control accepts.

use std::{
    thread,
    time::{Duration, Instant},
};

use volcomp_port::{Controller, Description, DeviceError, Fault, Snapshot, Supply, Words};
use volcomp_vocabulary::PerChannel;

use crate::{
    client::Client,
    config::{self, FocasConfig},
    error::FocasError,
    parameters::{self, ShiftSource, UNIT_NUMBERS},
    plan::{self, Abilities, Exchange, PlannedAxis, ReadItem, WriteItem},
    pmc::{BarrierArea, Width, put},
    reading::{self, Applied},
    session::Session,
};

/// Reads and corrects a control by one read and one write per cycle. A separate thread connects and reconnects.
pub struct FocasController {
    description: Description,
    supply: Supply<Link>,
}

impl FocasController {
    /// Starts to connect in the background. The connecting thread also logs connection errors as warnings (`tracing`).
    ///
    /// # Errors
    /// The axes of the configuration are invalid, or no thread can be started for the connection.
    pub fn new(config: FocasConfig) -> Result<Self, DeviceError> {
        let device = config.device();
        let backoff = config.backoff;
        let description = config.describe().map_err(|error| error.of(&*device))?;
        let of_device = device.clone();
        // Log the same error once only, not at every attempt.
        let mut logged = String::new();
        let open = move || {
            let opened = Link::open(&config).map_err(|error| error.of(&*of_device));
            let text = match &opened {
                Ok(link) if link.found().notes.is_empty() => String::new(),
                Ok(link) => format!("{of_device}: {}", link.found().notes.join("; ")),
                Err(error) => error.to_string(),
            };
            if !text.is_empty() && text != logged {
                tracing::warn!("{text}");
            }
            logged = text;
            opened
        };
        Ok(Self { description, supply: Supply::new(&device, backoff, open)? })
    }

    /// Waits until the first connection is open.
    ///
    /// # Errors
    /// There is no connection within `at_most`. The error is that of the last attempt. If the control rejected the
    /// attempt, it contains the return code and its meaning.
    pub fn wait(&mut self, at_most: Duration) -> Result<(), DeviceError> {
        self.supply.wait(at_most).map(|_| ())
    }

    /// Number of connections opened so far.
    pub fn connections(&self) -> u64 {
        self.supply.opened()
    }

    /// Error of the last connection attempt; `None` if the attempt succeeded. Takes a lock, so do not call this in a
    /// cycle.
    pub fn last_error(&self) -> Option<DeviceError> {
        self.supply.last_error()
    }

    /// Properties that the control reported when the present connection was opened; `None` without a connection.
    /// Allocates, so do not call this in a cycle.
    pub fn inspection(&mut self) -> Option<Inspection> {
        self.supply.current().ok().map(|link| link.found().clone())
    }

    /// Request forms that the control accepts; `None` without a connection.
    pub fn abilities(&mut self) -> Option<Abilities> {
        self.supply.current().ok().map(|link| link.abilities())
    }

    fn call<T>(&mut self, call: impl FnOnce(&mut Link) -> Result<T, Fault>) -> Result<T, Fault> {
        let link = self.supply.current()?;
        let result = call(link);
        if link.is_dead() || matches!(result, Err(Fault::Protocol(_))) {
            self.supply.lose();
        }
        result
    }
}

impl Controller for FocasController {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        self.call(|link| link.read(deadline))
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        self.call(|link| link.post(frame, deadline))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        self.call(|link| link.apply(corrections, deadline))
    }
}

/// Maximum time for which data sent in a cycle may stay unacknowledged. It is longer than the deadline of any cycle,
/// but too short for an outdated correction to do harm. The kernel enforces it even while the program is stopped.
const UNACKNOWLEDGED_TIMEOUT: Duration = Duration::from_millis(250);

/// Properties that a control reports when a session is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Inspection {
    /// Protocol version of the control's responses: 2, 3 or 4, depending on the generation of the control.
    pub version: u16,
    pub axes: Vec<char>,
    /// The PMC words from which the control takes the shifts of its axes.
    pub shift_source: ShiftSource,
    pub abilities: Abilities,
    pub notes: Vec<String>,
    /// Two reports of the control's barrier, about one second apart, each with the time at which it was read. The scan
    /// time follows from their ticks. Empty if the configuration has no barrier, or if the control sent no report.
    pub reports: Vec<(Instant, Words)>,
}

struct Link {
    session: Session,
    found: Inspection,
    axes: Vec<PlannedAxis>,
    /// Number of corrected axes. Corrected axes come first in `axes`.
    corrected: usize,
    width: Width,
    applied: Applied,
    has_barrier: bool,
    reads: Vec<Exchange<ReadItem>>,
    writes: Vec<Exchange<WriteItem>>,
    /// Value of the heartbeat at the control: last written or, before the first write, last read; `None` if unknown.
    heartbeat: Option<u8>,
    /// Sequence number: last written or, before the first write, last read.
    sequence: u8,
}

impl Link {
    /// Opens a session, finds the axes and the accepted request forms, and checks the control's parameters against the
    /// configuration.
    fn open(config: &FocasConfig) -> Result<Self, FocasError> {
        let client = Client::open(&config.host, config.port, config.at_most)?;
        let mut client = client.with_path(config.path);
        let names = client.axis_names()?;
        let axes = find_axes(config, &names)?;
        let source = client.shift_source()?;
        let mut notes =
            if config.axes.is_empty() { Vec::new() } else { source.check(config, names.len())? };
        let [inch_machine, in_unit_of_program, program] = UNIT_NUMBERS;
        notes.extend(parameters::check_units(&[
            client.integer_parameter(inch_machine)?,
            client.integer_parameter(in_unit_of_program)?,
            client.integer_parameter(program)?,
        ])?);
        let sequence = match config.sequence.filter(|_| config.barrier.is_none()) {
            // Continue from the present value, so that the first correction changes the byte and the ladder detects it.
            Some(address) => client.read_pmc(address.area, address.at, 1)?,
            None => Vec::new(),
        };
        let version = client.version();
        let mut session = client.into_session();
        let abilities = reading::find_abilities(&mut session, config, &axes)?;
        session.limit_unacknowledged(UNACKNOWLEDGED_TIMEOUT);
        Ok(Self {
            reads: plan::reads(config, &axes, abilities)?,
            writes: plan::writes(config, &axes, abilities)?,
            session,
            found: Inspection {
                version,
                axes: names,
                shift_source: source,
                abilities,
                notes,
                reports: Vec::new(),
            },
            axes,
            corrected: config.axes.len(),
            width: config.shift.width,
            applied: Applied::of(config),
            has_barrier: config.barrier.is_some(),
            heartbeat: None,
            sequence: sequence.first().copied().unwrap_or(0),
        })
    }

    fn found(&self) -> &Inspection {
        &self.found
    }

    fn abilities(&self) -> Abilities {
        self.found.abilities
    }

    fn is_dead(&self) -> bool {
        self.session.is_dead()
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        let (session, applied) = (&mut self.session, self.applied);
        let reading = reading::read(session, &self.reads, &self.axes, applied, deadline)?;
        // A changed heartbeat means that another gateway writes it.
        let before = self.heartbeat;
        self.heartbeat = reading.heartbeat.or(before);
        match (before, reading.heartbeat) {
            (Some(before), Some(found)) if before != found => Err(Fault::OtherGateway),
            _ => Ok(reading.snapshot),
        }
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        let words = frame.as_slice();
        if !self.has_barrier {
            return Err(Fault::Unsupported("frames, where there is no barrier"));
        }
        if words.len() != BarrierArea::frame_words(self.corrected) {
            return Err(Fault::Unsupported("a frame of another number of axes"));
        }
        for exchange in &mut self.writes {
            for (command, part) in exchange.parts.iter().enumerate() {
                if let WriteItem::Frame(run) = part {
                    let into = exchange.request.data_mut(command).chunks_exact_mut(2);
                    for (into, word) in into.zip(words.iter().skip(run.first)) {
                        into.copy_from_slice(&word.to_be_bytes());
                    }
                }
            }
        }
        for index in 0..self.writes.len() {
            self.send(index, deadline)?;
        }
        Ok(())
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        if self.has_barrier {
            return Err(Fault::Unsupported("plain corrections, where there is a barrier"));
        }
        if self.corrected == 0 {
            return Err(Fault::Unsupported("corrections, where positions are only read"));
        }
        let beat = self.heartbeat.unwrap_or(0).wrapping_add(1);
        self.sequence = self.sequence.wrapping_add(1);
        for exchange in &mut self.writes {
            for (command, part) in exchange.parts.iter().enumerate() {
                let into = exchange.request.data_mut(command);
                let byte = match *part {
                    WriteItem::Heartbeat(_) => beat,
                    WriteItem::Sequence(_) => self.sequence,
                    WriteItem::Shifts(run) => {
                        for (axis, correction) in self.axes.iter().zip(corrections) {
                            let bytes = run.bytes_of(axis.slot, self.width);
                            if let Some(into) = bytes.and_then(|bytes| into.get_mut(bytes)) {
                                put(into, self.width, correction / axis.count);
                            }
                        }
                        continue;
                    }
                    WriteItem::Frame(_) => continue,
                };
                if let Some(into) = into.first_mut() {
                    *into = byte;
                }
            }
        }
        for index in 0..self.writes.len() {
            let has_heartbeat = (self.writes[index].parts.iter())
                .any(|part| matches!(part, WriteItem::Heartbeat(_)));
            if has_heartbeat {
                // The heartbeat is unknown until the exchange succeeds. If the exchange fails, the value at the control
                // must not be attributed to another gateway.
                self.heartbeat = None;
            }
            self.send(index, deadline)?;
            if has_heartbeat {
                self.heartbeat = Some(beat);
            }
        }
        Ok(())
    }

    /// Sends one exchange of a write. If the deadline has passed after an earlier exchange of the same write, aborts
    /// the session, because the control must not continue with half a write.
    fn send(&mut self, index: usize, deadline: Instant) -> Result<(), Fault> {
        match self.session.exchange(&self.writes[index].request, deadline) {
            Ok(blocks) => {
                for block in blocks {
                    reading::data(block)?;
                }
                Ok(())
            }
            Err(fault) => {
                if fault == Fault::TimedOut && index > 0 {
                    self.session.abort();
                }
                Err(fault)
            }
        }
    }
}

const READ_TIMEOUT: Duration = Duration::from_secs(2);

const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// Connects, makes all checks that precede the first correction, reads once, and disconnects. Writes nothing to the
/// control.
///
/// # Errors
/// The first failed check: no connection, a missing axis, a parameter that contradicts the configuration, a rejected
/// request.
pub fn inspect(config: &FocasConfig) -> Result<Inspection, FocasError> {
    config.describe()?;
    let mut link = Link::open(config)?;
    let mut found = link.found().clone();
    let mut read = || {
        let snapshot = link.read(Instant::now() + READ_TIMEOUT).ok()?;
        Some((snapshot.taken, snapshot.report?))
    };
    found.reports.extend(read());
    if !found.reports.is_empty() {
        thread::sleep(REPORT_INTERVAL);
        found.reports.extend(read());
    }
    Ok(found)
}

fn find_axes(config: &FocasConfig, names: &[char]) -> Result<Vec<PlannedAxis>, FocasError> {
    let planned = |name: &volcomp_vocabulary::AxisName| {
        let mut slots = (0..names.len()).filter(|slot| names[*slot] == name.letter());
        let slot = slots.next();
        if slots.next().is_some() {
            return Err(FocasError::SameLetter { name: *name, found: names.iter().collect() });
        }
        Ok(PlannedAxis {
            slot: slot
                .ok_or_else(|| FocasError::NoAxis { name: *name, found: names.iter().collect() })?,
            kind: name.kind(),
            count: config.shift.count(name.kind()).mm_or_rad(),
        })
    };
    let axes: Vec<PlannedAxis> =
        config.axes.iter().chain(&config.reads).map(planned).collect::<Result<_, FocasError>>()?;
    // The control has a shift word for each of its axes, so the words can extend beyond those of the corrected axes.
    config::check(config, names.len())?;
    Ok(axes)
}
