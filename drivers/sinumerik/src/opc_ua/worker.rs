//! The thread of a control. It owns the session, the last write and the last reading.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use opcua::types::{StatusCode, Variant};
use triple_buffer::{Input, Output};
use volcomp_port::{DeviceError, Snapshot};
use volcomp_vocabulary::PerChannel;

use super::{
    failure_log::FailureLog,
    inspection::{self, Inspection},
    link::Link,
};
use crate::{config::SinumerikConfig, error::SinumerikError, reading::Reading};

/// Polling interval for queued writes. The lock-free queue cannot wake this thread.
const POLL_INTERVAL: Duration = Duration::from_millis(2);

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WriteRequest {
    /// Increasing sequence number; 0 if no write was requested yet.
    pub(super) number: u64,
    pub(super) corrections: PerChannel<f64>,
    pub(super) deadline: Option<Instant>,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Latest {
    pub(super) connected: bool,
    /// Last reading; `None` before the first reading of a session. While later readings fail, it is kept and its age
    /// grows.
    pub(super) snapshot: Option<Snapshot>,
}

#[derive(Default)]
pub(super) struct Shared {
    pub(super) ends: AtomicBool,
    /// Status by which the last write was rejected; 0 if it was accepted.
    pub(super) refused: AtomicU32,
    pub(super) opened: AtomicU64,
    pub(super) written: AtomicU64,
    pub(super) missed: AtomicU64,
    diagnosis: Mutex<Diagnosis>,
}

#[derive(Default)]
struct Diagnosis {
    error: Option<DeviceError>,
    found: Option<Inspection>,
}

impl Shared {
    /// Reason why no session is open; `None` if one is open. Takes a lock, so do not call this in a cycle.
    pub(super) fn last_error(&self) -> Option<DeviceError> {
        self.diagnosis.lock().unwrap_or_else(PoisonError::into_inner).error.clone()
    }

    /// Properties of the control when the session was opened; `None` without a session. Takes a lock, so do not call
    /// this in a cycle.
    pub(super) fn found(&self) -> Option<Inspection> {
        self.diagnosis.lock().unwrap_or_else(PoisonError::into_inner).found.clone()
    }

    fn note(&self, error: Option<DeviceError>, found: Option<Inspection>) {
        let mut diagnosis = self.diagnosis.lock().unwrap_or_else(PoisonError::into_inner);
        *diagnosis = Diagnosis { error, found };
    }
}

pub(super) struct Worker {
    pub(super) config: SinumerikConfig,
    pub(super) reading: Reading,
    pub(super) requests: Output<WriteRequest>,
    pub(super) latest: Input<Latest>,
    pub(super) shared: Arc<Shared>,
    pub(super) opened: Option<Instant>,
    /// Remarks of the previous session, so that unchanged remarks are not logged again.
    pub(super) noted: Vec<String>,
}

impl Worker {
    pub(super) async fn run(mut self) {
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
