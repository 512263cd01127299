//! Sends conditions, complete states, audit-log records and acknowledgements to the centre, and retries each until the
//! server has stored it. While the server is unreachable, a limited number of messages is queued in memory and on disk.
//! A disk that is full or hangs delays only this thread.

use std::{
    path::PathBuf,
    pin::Pin,
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use serde::Serialize;
use tokio::{
    sync::{mpsc::UnboundedReceiver, watch},
    time::{Instant, sleep, sleep_until},
};
use volcomp_fleet::{
    Acknowledgement, Condition, Envelope, Kind, Lane, LinkError, MachineSender, Spool, SpoolLimits,
    Waiting,
};

use super::{audit_tail::AuditTail, shared::Shared, store::Store};
use crate::{documents::Status, interop::quantities::length};

const POLL_INTERVAL: Duration = Duration::from_millis(200);
const PAUSE: Duration = Duration::from_secs(1);
/// Interval at which the cursor of the log is saved, and at which opening the folder is retried after a failure.
const SAVE_INTERVAL: Duration = Duration::from_secs(5);
const MAX_WITHOUT_FOLDER: usize = 64;
const END_TIMEOUT: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, PartialEq, Eq)]
enum Source {
    Spool(Lane),
    Log,
}

impl Source {
    fn lane(self) -> Lane {
        match self {
            Self::Spool(lane) => lane,
            Self::Log => Lane::Kept,
        }
    }
}

/// Pause and error after the last message of a lane. Each lane has its own, because the server may refuse audit records
/// and acknowledgements (their stream is full) while it accepts states.
struct Attempts {
    pause_until: Instant,
    trouble: Option<String>,
}

type Sending = Pin<Box<dyn Future<Output = (Source, Result<(), LinkError>)> + Send>>;

pub(super) struct Reporter {
    store: Store,
    shared: Arc<Shared>,
    link: watch::Receiver<Option<MachineSender>>,
    log: AuditTail,
    spool: Option<Spool>,
    /// Messages queued while the folder cannot be opened.
    without_folder: Vec<Waiting>,
    dropped: u64,
    /// The record being sent, in its envelope. A retry sends the same message.
    record: Option<Waiting>,
    instance: String,
    /// Secret prefix of the message ids. The server drops a message whose id it has already received in this site, so
    /// others must not be able to predict ids. The instance is no secret, because pages show it.
    ids: String,
    number: u64,
    begun: Instant,
    next: [Instant; 2],
    kept_at: Instant,
    kept: Attempts,
    passing: Attempts,
}

impl Reporter {
    pub(super) fn new(
        store: Store,
        audit_dir: PathBuf,
        shared: Arc<Shared>,
        link: watch::Receiver<Option<MachineSender>>,
    ) -> Self {
        let now = Instant::now();
        let untried = || Attempts { pause_until: now, trouble: None };
        Self {
            log: AuditTail::new(audit_dir, store.audit_cursor()),
            store,
            shared,
            link,
            spool: None,
            without_folder: Vec::new(),
            dropped: 0,
            record: None,
            instance: random_name(),
            ids: random_name(),
            number: 0,
            begun: now,
            next: [now; 2],
            kept_at: now,
            kept: untried(),
            passing: untried(),
        }
    }

    fn attempts(&mut self, lane: Lane) -> &mut Attempts {
        match lane {
            Lane::Kept => &mut self.kept,
            Lane::Passing => &mut self.passing,
        }
    }

    pub(super) async fn run(
        mut self,
        mut acknowledged: UnboundedReceiver<Acknowledgement>,
        mut stopped: watch::Receiver<bool>,
    ) {
        let mut sending: Option<Sending> = None;
        self.open();
        while !*stopped.borrow_and_update() {
            if sending.is_none() {
                sending = self.begin_sending();
            }
            let due = self.next[0].min(self.next[1]);
            tokio::select! {
                changed = stopped.changed() => if changed.is_err() { break },
                Some(told) = acknowledged.recv() => self.acknowledge(&told),
                () = sleep_until(due) => self.send_due_states(),
                (source, sent) = pending_send(&mut sending) => {
                    sending = None;
                    self.sent(source, sent);
                }
                () = sleep(POLL_INTERVAL) => {}
            }
            self.keep();
        }
        self.end(sending, acknowledged).await;
    }

    async fn end(
        mut self,
        mut sending: Option<Sending>,
        mut acknowledged: UnboundedReceiver<Acknowledgement>,
    ) {
        while let Ok(told) = acknowledged.try_recv() {
            self.acknowledge(&told);
        }
        let until = Instant::now() + END_TIMEOUT;
        for attempts in [&mut self.kept, &mut self.passing] {
            attempts.pause_until = Instant::now();
        }
        while Instant::now() < until {
            if sending.is_none() {
                sending = self.begin_sending();
            }
            if sending.is_none() {
                break;
            }
            tokio::select! {
                (source, sent) = pending_send(&mut sending) => {
                    sending = None;
                    if sent.is_err() {
                        break;
                    }
                    self.sent(source, sent);
                }
                () = sleep_until(until) => break,
            }
        }
        self.log.keep();
        if let Some(spool) = &mut self.spool {
            spool.flush();
        }
    }

    fn open(&mut self) {
        match Spool::open(&self.store.spool(), SpoolLimits::default()) {
            Ok(spool) => {
                self.spool = Some(spool);
                for waiting in std::mem::take(&mut self.without_folder) {
                    self.push(waiting);
                }
            }
            Err(e) => {
                self.passing.trouble = Some(format!("{}: {e}", self.store.spool().display()));
            }
        }
    }

    fn push(&mut self, message: Waiting) {
        let is_kept = Lane::of(message.kind) == Lane::Kept;
        match &mut self.spool {
            Some(spool) => {
                let _waits = self.shared.reporting.wait();
                spool.push(message);
            }
            None if is_kept && self.without_folder.len() < MAX_WITHOUT_FOLDER => {
                self.without_folder.push(message);
            }
            None => self.dropped += 1,
        }
    }

    fn message<T: Serialize>(&mut self, kind: Kind, body: T) -> Option<Waiting> {
        let model = self.shared.published.model().hash.clone();
        self.number += 1;
        let wall = SystemTime::now().duration_since(UNIX_EPOCH);
        let envelope = Envelope {
            instance: self.instance.clone(),
            number: self.number,
            uptime_s: self.begun.elapsed().as_secs_f64(),
            wall_s: wall.unwrap_or_default().as_secs_f64(),
            version: self.shared.version(),
            model,
            body,
        };
        Some(Waiting {
            kind,
            id: format!("{}-{}", self.ids, self.number),
            bytes: serde_json::to_vec(&envelope).ok()?,
        })
    }

    fn acknowledge(&mut self, told: &Acknowledgement) {
        if let Some(message) = self.message(Kind::Ack, told) {
            self.push(message);
        }
    }

    fn send_due_states(&mut self) {
        let now = Instant::now();
        let pace = self.shared.pace();
        let is_due = self.next.map(|next| next <= now);
        let status = self.shared.published.latest();
        if is_due[0]
            && let Some(message) = self.message(Kind::Condition, condition(&status))
        {
            self.push(message);
        }
        if is_due[1]
            && let Some(message) = self.message(Kind::Telemetry, &status)
        {
            self.push(message);
        }
        for ((next, pace), is_due) in self.next.iter_mut().zip(pace).zip(is_due) {
            if is_due {
                // Missed reports are skipped.
                *next = (*next + pace).max(now);
            }
            // The manifest may have shortened the interval.
            *next = (*next).min(now + pace);
        }
    }

    /// Starts sending the next message if there is one and a connection.
    fn begin_sending(&mut self) -> Option<Sending> {
        let link = self.link.borrow().clone()?;
        if !link.is_connected() {
            return None;
        }
        let (source, message) = self.next_message()?;
        Some(Box::pin(async move {
            let Waiting { kind, id, bytes } = message;
            let sent = link.publish(kind, &id, bytes.into()).await;
            (source, sent)
        }))
    }

    /// The next message of the lanes that are not paused: acknowledgements first, then audit records, then states.
    fn next_message(&mut self) -> Option<(Source, Waiting)> {
        let now = Instant::now();
        for lane in [Lane::Kept, Lane::Passing] {
            if now < self.attempts(lane).pause_until {
                continue;
            }
            let waiting = {
                let _waits = self.shared.reporting.wait();
                self.spool.as_mut().and_then(|spool| spool.first(lane).cloned())
            };
            if let Some(message) = waiting {
                return Some((Source::Spool(lane), message));
            }
            if lane == Lane::Kept
                && let Some(record) = self.next_record()
            {
                return Some((Source::Log, record));
            }
        }
        None
    }

    /// The next audit record. A record sent again after a crash has a new number and therefore a new id: the server
    /// stores it again, so that no number is missing, and the centre recognizes it by its checksum.
    fn next_record(&mut self) -> Option<Waiting> {
        if self.record.is_none() {
            let line = self.log.first()?.clone();
            self.record = self.message(Kind::Audit, line);
        }
        self.record.clone()
    }

    fn sent(&mut self, source: Source, sent: Result<(), LinkError>) {
        let error = sent.err().map(|error| error.to_string());
        match source {
            _ if error.is_some() => {}
            Source::Spool(lane) => {
                if let Some(spool) = &mut self.spool {
                    spool.done(lane);
                }
            }
            Source::Log => {
                self.record = None;
                self.log.done();
            }
        }
        let attempts = self.attempts(source.lane());
        if let Some(error) = &error {
            if attempts.trouble.as_ref() != Some(error) {
                tracing::warn!("fleet: {error}");
            }
            attempts.pause_until = Instant::now() + PAUSE;
        }
        attempts.trouble = error;
    }

    /// Periodic work: the folder, the cursor of the log, and the published state.
    fn keep(&mut self) {
        if self.kept_at.elapsed() > SAVE_INTERVAL {
            self.kept_at = Instant::now();
            let _waits = self.shared.reporting.wait();
            self.log.keep();
            if self.spool.is_none() {
                self.open();
            }
        }
        let connected = (self.link.borrow().as_ref()).is_some_and(MachineSender::is_connected);
        let of_disk = self.spool.as_ref().and_then(Spool::trouble);
        let waiting = match of_disk {
            Some(trouble) => Some(trouble.to_owned()),
            None if !connected => Some("the server is not connected".to_owned()),
            None => self.kept.trouble.clone().or(self.passing.trouble.clone()),
        };
        let dropped = self.dropped + self.spool.as_ref().map_or(0, Spool::dropped);
        self.shared.published.update_fleet(|state| {
            state.connected = connected;
            state.waiting = waiting;
            state.dropped = dropped;
        });
    }
}

/// Waits for the message being sent; never returns if no message is being sent.
async fn pending_send(sending: &mut Option<Sending>) -> (Source, Result<(), LinkError>) {
    match sending {
        Some(sending) => sending.await,
        None => std::future::pending().await,
    }
}

fn random_name() -> String {
    let mut bytes = [0; 8];
    match rustix::rand::getrandom(&mut bytes, rustix::rand::GetRandomFlags::empty()) {
        Ok(_) => volcomp_model::hexadecimal(&bytes),
        // The kernel has no entropy yet: use the process ID and the time since boot.
        Err(_) => format!(
            "{:08x}{:08x}",
            std::process::id(),
            volcomp_runtime::monotonic().as_nanos() & 0xffff_ffff
        ),
    }
}

fn condition(status: &Status) -> Condition {
    let temperatures = status.temperatures.iter();
    Condition {
        state: status.state.name().to_owned(),
        reasons: status.reasons.clone(),
        armed: status.armed,
        correction_um: status.correction_um.clone(),
        correction_urad: status.correction_urad.clone(),
        residual_um: status.residual_um.map(length),
        temperatures_degc: temperatures.map(|sensor| (sensor.name.clone(), sensor.degc)).collect(),
        cycle_p99_us: status.cycle.p99_us,
        overruns: status.cycle.overruns,
        faults: status.faults,
    }
}
