//! Sends conditions, complete states, audit-log records and acknowledgements to the centre.
//!
//! Each message is retried until the server has stored it. While the server is unreachable, a limited number of
//! messages is queued in memory and on disk. A disk that is full or hangs delays only this thread. Records are read
//! from the files of the audit log, so only records on disk are sent, in log order.

use std::{
    collections::VecDeque,
    fs::{self, File},
    io::{Read, Seek, SeekFrom},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    pin::Pin,
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use serde::{Deserialize, Serialize};
use tokio::{
    sync::{mpsc::UnboundedReceiver, watch},
    time::{Instant, sleep, sleep_until},
};
use volcomp_fleet::{
    Acknowledgement, AuditLine, Condition, Envelope, Kind, Lane, LinkError, MachineSender, Spool,
    SpoolLimits, Waiting,
};

use crate::{
    audit::{log_files, replace_file},
    documents::Status,
    fleet::{manifests::Store, shared::Shared},
    interop::quantities::length,
};

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

/// Maximum size of one read, bytes.
const PIECE: u64 = 256 * 1024;

/// Checksum of the last record sent; empty if none was sent.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Cursor {
    checksum: String,
}

#[derive(Clone, Copy)]
struct LogPosition {
    inode: u64,
    offset: u64,
}

/// Follows the log while another thread writes it, and stores the position up to which it was sent.
struct AuditTail {
    folder: PathBuf,
    cursor_file: PathBuf,
    sent: Cursor,
    written: Cursor,
    /// Next read position; `None` before the first read, which continues after the record of the cursor.
    place: Option<LogPosition>,
    lines: VecDeque<AuditLine>,
}

impl AuditTail {
    pub(super) fn new(folder: PathBuf, cursor_file: PathBuf) -> Self {
        let text = fs::read_to_string(&cursor_file).unwrap_or_default();
        let sent: Cursor = serde_json::from_str(&text).unwrap_or_default();
        Self {
            folder,
            cursor_file,
            written: sent.clone(),
            sent,
            place: None,
            lines: VecDeque::new(),
        }
    }

    /// The next record to send. It stays the same until [`done`](Self::done).
    pub(super) fn first(&mut self) -> Option<&AuditLine> {
        if self.lines.is_empty() {
            self.read();
        }
        self.lines.front()
    }

    /// Marks the record returned by [`first`](Self::first) as stored at the server, and removes it.
    pub(super) fn done(&mut self) {
        if let Some(line) = self.lines.pop_front() {
            self.sent.checksum = line.checksum;
        }
    }

    /// Saves the cursor. After a crash the last records may be sent again; their checksums identify them.
    pub(super) fn keep(&mut self) {
        if self.sent == self.written {
            return;
        }
        let text = serde_json::to_string(&self.sent).unwrap_or_default();
        // If this fails, some records are sent again after a restart.
        if replace_file(&self.cursor_file, &text).is_ok() {
            self.written = self.sent.clone();
        }
    }

    fn read(&mut self) {
        let files: Vec<(PathBuf, u64)> = log_files(&self.folder)
            .into_iter()
            .filter_map(|path| Some((path.clone(), fs::metadata(path).ok()?.ino())))
            .collect();
        let Some(mut place) = self.place.or_else(|| self.find_position(&files)) else {
            return;
        };
        // The file is no longer among the kept files, so its unread records are lost. The centre detects the gap by
        // their sequence numbers.
        let mut index =
            (files.iter()).position(|(_, inode)| *inode == place.inode).unwrap_or_else(|| {
                place.offset = 0;
                0
            });
        while self.lines.is_empty()
            && let Some((path, inode)) = files.get(index)
        {
            place.inode = *inode;
            let (lines, read) = lines_at(path, &mut place.offset);
            self.lines.extend(lines);
            place.offset += read;
            let is_last = index + 1 == files.len();
            if self.lines.is_empty() && read == 0 {
                if is_last {
                    break;
                }
                index += 1;
                place.offset = 0;
            }
        }
        self.place = Some(place);
    }

    /// The position after the last record sent. If that record is not found: the start of the oldest file. If no record
    /// was ever sent: the start of the current file.
    fn find_position(&self, files: &[(PathBuf, u64)]) -> Option<LogPosition> {
        let (_, current) = files.last()?;
        if self.sent.checksum.is_empty() {
            return Some(LogPosition { inode: *current, offset: 0 });
        }
        for (path, inode) in files.iter().rev() {
            let mut at = 0;
            loop {
                let (lines, read) = lines_at(path, &mut at);
                let mut end = at;
                for line in &lines {
                    // Length of a line: the checksum, a space, the record and a line feed.
                    end += (line.checksum.len() + line.record.len() + 2) as u64;
                    if line.checksum == self.sent.checksum {
                        return Some(LogPosition { inode: *inode, offset: end });
                    }
                }
                if read == 0 {
                    break;
                }
                at += read;
            }
        }
        let (_, oldest) = files.first()?;
        Some(LogPosition { inode: *oldest, offset: 0 })
    }
}

/// The complete lines of a file from an offset, up to [`PIECE`] bytes, and their length in bytes. An offset beyond the
/// end, which remains after a torn record was cut off, is set to the end.
fn lines_at(path: &Path, offset: &mut u64) -> (Vec<AuditLine>, u64) {
    let mut piece = || -> std::io::Result<Vec<u8>> {
        let mut file = File::open(path)?;
        *offset = file.metadata()?.len().min(*offset);
        file.seek(SeekFrom::Start(*offset))?;
        let mut bytes = Vec::new();
        file.take(PIECE).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    let bytes = piece().unwrap_or_default();
    let is_full = bytes.len() as u64 == PIECE;
    let end = match bytes.iter().rposition(|byte| *byte == b'\n') {
        Some(last) => last + 1,
        // No record is this long: skip these bytes.
        None if is_full => bytes.len(),
        None => 0,
    };
    let lines = String::from_utf8_lossy(&bytes[..end]);
    let lines = lines.lines().filter_map(|line| {
        let (checksum, record) = line.split_once(' ')?;
        Some(AuditLine { checksum: checksum.to_owned(), record: record.to_owned() })
    });
    (lines.collect(), end as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        audit::AuditLog,
        documents::{ByAxis, Details, Event},
    };

    fn details() -> Details {
        Details {
            model: String::new(),
            output_um: ByAxis::new(),
            output_urad: ByAxis::new(),
            what: Event::Nothing,
        }
    }

    fn sent(tail: &mut AuditTail) -> Vec<String> {
        let mut whats = Vec::new();
        while let Some(line) = tail.first() {
            let record: serde_json::Value = serde_json::from_str(&line.record).expect("JSON");
            whats.push(record["what"].as_str().expect("text").to_owned());
            tail.done();
        }
        tail.keep();
        whats
    }

    /// Across rotations and restarts each record is returned once and in order, so that the receiver can verify the
    /// hash chain.
    #[test]
    fn every_record_once_over_rotations_and_restarts() {
        let dir = tempfile::tempdir().expect("writable");
        let (log, _) = AuditLog::open(dir.path()).expect("writable");
        let mut log = log.rotating_at(2000);
        let cursor = dir.path().join("cursor.json");
        let open = || AuditTail::new(dir.path().to_owned(), cursor.clone());
        let mut tail = open();
        let mut expected = Vec::new();
        let mut found = Vec::new();
        for number in 0..60 {
            let what = format!("event {number}");
            log.append("test", &what, details()).expect("writable");
            expected.push(what);
            if number % 7 == 3 {
                found.extend(sent(&mut tail));
            }
            if number % 13 == 5 {
                tail = open();
            }
        }
        found.extend(sent(&mut tail));
        assert_eq!(found, expected);
        assert_eq!(sent(&mut open()), [""; 0], "nothing twice");
    }

    /// A partly written line is returned only when it is complete.
    #[test]
    fn a_torn_end_waits() {
        let dir = tempfile::tempdir().expect("writable");
        let mut tail = AuditTail::new(dir.path().to_owned(), dir.path().join("cursor.json"));
        let log = crate::audit::log_file(dir.path());
        fs::write(&log, "aa {\"what\":\"one\"}\nbb {\"wh").expect("writable");
        assert_eq!(sent(&mut tail), ["one"]);
        fs::write(&log, "aa {\"what\":\"one\"}\nbb {\"what\":\"two\"}\n").expect("writable");
        assert_eq!(sent(&mut tail), ["two"]);
    }
}
