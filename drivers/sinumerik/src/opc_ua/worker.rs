//! The controller, and its thread that owns the session.
//!
//! The controller returns the latest reading and queues writes, without waiting for the control. The thread owns the
//! session, the last write and the last reading.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use opcua::types::{StatusCode, Variant};
use triple_buffer::{Input, Output, triple_buffer};
use volcomp_port::{Controller, Description, DeviceError, Fault, Snapshot};
use volcomp_vocabulary::PerChannel;

use crate::{
    config::SinumerikConfig,
    error::SinumerikError,
    opc_ua::{
        inspection::{self, Inspection},
        link::{DECODING_STACK_BYTES, Link},
    },
    reading::Reading,
};

/// Polling interval for queued writes. The lock-free queue cannot wake this thread.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

#[derive(Clone, Copy, Debug, Default)]
struct WriteRequest {
    /// Increasing sequence number; 0 if no write was requested yet.
    number: u64,
    corrections: PerChannel<f64>,
    deadline: Option<Instant>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Latest {
    connected: bool,
    /// Last reading; `None` before the first reading of a session. While later readings fail, it is kept and its age
    /// grows.
    snapshot: Option<Snapshot>,
}

#[derive(Default)]
struct Shared {
    ends: AtomicBool,
    /// Status by which the last write was rejected; 0 if it was accepted.
    refused: AtomicU32,
    opened: AtomicU64,
    written: AtomicU64,
    missed: AtomicU64,
    diagnosis: Mutex<Diagnosis>,
}

#[derive(Default)]
struct Diagnosis {
    error: Option<DeviceError>,
    found: Option<Inspection>,
}

impl Shared {
    /// Reason why no session is open; `None` if one is open. Takes a lock, so do not call this in a cycle.
    fn last_error(&self) -> Option<DeviceError> {
        self.diagnosis.lock().unwrap_or_else(PoisonError::into_inner).error.clone()
    }

    /// Properties of the control when the session was opened; `None` without a session. Takes a lock, so do not call
    /// this in a cycle.
    fn found(&self) -> Option<Inspection> {
        self.diagnosis.lock().unwrap_or_else(PoisonError::into_inner).found.clone()
    }

    fn note(&self, error: Option<DeviceError>, found: Option<Inspection>) {
        let mut diagnosis = self.diagnosis.lock().unwrap_or_else(PoisonError::into_inner);
        *diagnosis = Diagnosis { error, found };
    }
}

struct Worker {
    config: SinumerikConfig,
    reading: Reading,
    requests: Output<WriteRequest>,
    latest: Input<Latest>,
    shared: Arc<Shared>,
    opened: Option<Instant>,
    /// Remarks of the previous session, so that unchanged remarks are not logged again.
    noted: Vec<String>,
}

impl Worker {
    async fn run(mut self) {
        let mut pause = Duration::ZERO;
        let mut failures = FailureLog::default();
        while !self.ends() {
            let error = match self.session().await {
                Ok(()) => return,
                Err(error) => error.of(self.config.device()),
            };
            self.latest.write(Latest::default());
            let lived = self.opened.take().map_or(Duration::ZERO, |at| at.elapsed());
            let text = error.to_string();
            if failures.is_new(&text, lived) {
                tracing::warn!("{text}");
            }
            self.shared.note(Some(error), None);
            pause = self.config.server.backoff.next(pause, lived);
            self.sleep(pause).await;
        }
    }

    fn ends(&self) -> bool {
        self.shared.ends.load(Ordering::Acquire)
    }

    async fn sleep(&self, pause: Duration) {
        let end = Instant::now() + pause;
        while !self.ends() && Instant::now() < end {
            tokio::time::sleep(POLL_INTERVAL * 5).await;
        }
    }

    async fn session(&mut self) -> Result<(), SinumerikError> {
        let link = Link::open(&self.config.server).await?;
        let opened = inspection::opened(&link, &self.config).await?;
        self.opened = Some(Instant::now());
        if self.noted != opened.notes {
            for note in &opened.notes {
                tracing::warn!("{}: {note}", self.config.device());
            }
            self.noted.clone_from(&opened.notes);
        }
        self.shared.note(None, Some(opened));
        self.shared.opened.fetch_add(1, Ordering::Relaxed);
        // A write requested before this session is obsolete.
        let mut last_number = self.requests.read().number;
        let mut acknowledged = None;
        let mut snapshot = None;
        let mut due = Instant::now();
        while !self.ends() {
            let request = *self.requests.read();
            if request.number != last_number {
                last_number = request.number;
                self.carry_out(&link, &request, snapshot.as_ref(), &mut acknowledged).await?;
            }
            if Instant::now() >= due {
                due = Instant::now() + self.config.server.period;
                snapshot = self.read(&link).await?.or(snapshot);
                self.latest.write(Latest { connected: true, snapshot });
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
        link.close().await;
        Ok(())
    }

    /// Reads the control. Returns `None` if a node has no good number. Such a failure shows only in the growing age of
    /// the last reading.
    async fn read(&self, link: &Link) -> Result<Option<Snapshot>, SinumerikError> {
        let answer = link.read(self.reading.nodes()).await?;
        match self.reading.snapshot(&answer.numbers(), answer.begun, answer.ended) {
            Ok(snapshot) => Ok(Some(snapshot)),
            Err(SinumerikError::Node { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Writes the requested corrections. Does nothing if they are already applied or the deadline has passed.
    async fn carry_out(
        &self,
        link: &Link,
        request: &WriteRequest,
        snapshot: Option<&Snapshot>,
        acknowledged: &mut Option<PerChannel<f64>>,
    ) -> Result<(), SinumerikError> {
        let reading = &self.reading;
        let values = reading.values(&self.config, &request.corrections);
        let read_back = snapshot.and_then(|snapshot| snapshot.applied);
        let stands = read_back.map(|applied| reading.values(&self.config, &applied));
        if *acknowledged == Some(values) && stands == Some(values) {
            return Ok(());
        }
        if request.deadline.is_none_or(|deadline| Instant::now() >= deadline) {
            self.shared.missed.fetch_add(1, Ordering::Relaxed);
            return Ok(());
        }
        let settings = reading.settings().iter().zip(&values);
        let settings = settings.map(|(node, value)| (node, Variant::Double(*value)));
        let statuses = link.write(settings).await?;
        let refused = statuses.iter().find(|status| !status.is_good());
        let bad = match (refused, statuses.len() == reading.settings().len()) {
            (Some(status), _) => status.bits(),
            (None, false) => StatusCode::BadUnexpectedError.bits(),
            (None, true) => 0,
        };
        if bad != 0 && self.shared.refused.load(Ordering::Relaxed) != bad {
            let status = StatusCode::from(bad);
            tracing::warn!("{}: SD43900 cannot be written: {status}", self.config.device());
        }
        self.shared.refused.store(bad, Ordering::Release);
        self.shared.written.fetch_add(1, Ordering::Relaxed);
        *acknowledged = (bad == 0).then_some(values);
        Ok(())
    }
}

/// A control that is corrected through its temperature compensation. A separate thread reads and writes. The calls of a
/// cycle only return the latest reading and queue a write, so that no cycle waits for the control.
///
/// [`Controller::apply`] returns before the correction is sent; later readings show whether the correction was applied.
/// While the control rejects writes, `apply` returns [`Fault::Refused`].
pub struct SinumerikController {
    description: Description,
    requests: Input<WriteRequest>,
    latest: Output<Latest>,
    number: u64,
    shared: Arc<Shared>,
}

impl SinumerikController {
    /// Starts a thread that connects to the control. Connection failures are logged as warnings (`tracing`).
    ///
    /// # Errors
    /// An invalid configuration, or the thread cannot be started.
    pub fn new(config: SinumerikConfig) -> Result<Self, DeviceError> {
        let device = config.server.url.clone();
        let description = config.describe().map_err(|error| error.of(&*device))?;
        let (requests, ordered) = triple_buffer(&WriteRequest::default());
        let (read, latest) = triple_buffer(&Latest::default());
        let shared = Arc::new(Shared::default());
        let worker = Worker {
            reading: Reading::new(&config),
            config,
            requests: ordered,
            latest: read,
            shared: Arc::clone(&shared),
            opened: None,
            noted: Vec::new(),
        };
        start(&device, worker.run())?;
        Ok(Self { description, requests, latest, number: 0, shared })
    }

    /// Waits until a session is open and has tried its first reading. Do not call this on a real-time thread.
    ///
    /// # Errors
    /// No session was opened within `at_most`. The error is the last failure.
    pub fn wait(&mut self, at_most: Duration) -> Result<(), DeviceError> {
        let end = Instant::now() + at_most;
        while !self.latest.read().connected {
            if Instant::now() >= end {
                return Err(self.last_error().unwrap_or_else(|| {
                    let found = format!("no reading within {} ms", at_most.as_millis());
                    let expected = "check the address and the cable";
                    DeviceError::no_answer(&*self.description.device, found, expected)
                }));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        Ok(())
    }

    /// Reason why no session is open; `None` if one is open. Takes a lock, so do not call this in a cycle.
    pub fn last_error(&self) -> Option<DeviceError> {
        self.shared.last_error()
    }

    /// Properties that the control reported when the present session was opened; `None` without a session. Takes a
    /// lock, so do not call this in a cycle.
    pub fn inspection(&self) -> Option<Inspection> {
        self.shared.found()
    }

    pub fn sessions(&self) -> u64 {
        self.shared.opened.load(Ordering::Relaxed)
    }

    /// Two counts: writes that the control accepted or rejected, and writes that were dropped because their deadline
    /// had passed.
    pub fn writes(&self) -> [u64; 2] {
        [&self.shared.written, &self.shared.missed].map(|count| count.load(Ordering::Relaxed))
    }
}

impl Controller for SinumerikController {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _deadline: Instant) -> Result<Snapshot, Fault> {
        let latest = self.latest.read();
        if !latest.connected {
            return Err(Fault::NotConnected);
        }
        latest.snapshot.ok_or(Fault::Protocol("a node without a valid number"))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        if self.description.axes.is_empty() {
            return Err(Fault::Unsupported("corrections, where positions are only read"));
        }
        if !self.latest.read().connected {
            return Err(Fault::NotConnected);
        }
        self.number += 1;
        self.requests.write(WriteRequest {
            number: self.number,
            corrections: *corrections,
            deadline: Some(deadline),
        });
        match self.shared.refused.load(Ordering::Acquire) {
            0 => Ok(()),
            // The bits of the OPC UA status code.
            code => Err(Fault::Refused {
                code: code.cast_signed(),
                what: "SD43900 cannot be written: see the user's rights at the control",
            }),
        }
    }
}

impl Drop for SinumerikController {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Release);
    }
}

pub(super) fn start(
    device: &str,
    work: impl Future<Output = ()> + Send + 'static,
) -> Result<(), DeviceError> {
    let no_thread = |error: std::io::Error| {
        let found = format!("no thread for its connection: {error}");
        let remedy = "check the limits on threads and memory of this process";
        DeviceError::open(device, found, remedy).caused_by(error)
    };
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(no_thread)?;
    std::thread::Builder::new()
        .name("sinumerik".to_owned())
        .stack_size(DECODING_STACK_BYTES)
        .spawn(move || runtime.block_on(work))
        .map_err(no_thread)?;
    Ok(())
}

/// Minimum duration of a session that counts as a recovery. After a recovery, the next failure is logged again even if
/// its reason is the same.
const RECOVERED: Duration = Duration::from_secs(10);

#[derive(Debug, Default)]
pub(super) struct FailureLog(Option<String>);

impl FailureLog {
    /// Whether to log this failure. `lived` is the duration of the session that ended, zero if none was opened.
    pub(super) fn is_new(&mut self, failure: &str, lived: Duration) -> bool {
        if lived < RECOVERED && self.0.as_deref() == Some(failure) {
            return false;
        }
        self.0 = Some(failure.to_owned());
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// After a recovery, the loss of the session is logged again even if its reason is the same.
    #[test]
    fn a_failure_is_logged_once_and_again_after_a_recovery() {
        let mut failures = FailureLog::default();
        let [short, long] = [1, 3600].map(Duration::from_secs);
        assert!(failures.is_new("it does not answer", short));
        assert!(!failures.is_new("it does not answer", short));
        assert!(failures.is_new("it refuses", short));
        assert!(!failures.is_new("it refuses", short));
        assert!(failures.is_new("it refuses", long));
        assert!(!failures.is_new("it refuses", short));
    }
}
