//! The thread that writes the audit log and the small files in its folder. Only callers that wait for a receipt are
//! delayed by a disk that hangs.
//!
//! `Slots` is a file that can be updated on a full disk: it is allocated once and then overwritten in place. Two
//! slots of equal size are written alternately, each with a checksum and a counter. A power failure during a write
//! leaves the previous text in the other slot.

use std::{
    fs::{self, File, OpenOptions},
    io,
    os::unix::fs::FileExt,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, TryRecvError, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use sha2::{Digest, Sha256};
use volcomp_port::Clock;

use crate::audit::{AuditLog, Entry, is_at, replace_file, restore_folder};

const MAX_QUEUED: usize = 256;
/// Time after which the disk counts as not responding, for one record or one file.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

pub(crate) const RETRY_INTERVAL: Duration = Duration::from_millis(100);

enum Task {
    Record(Box<Entry>, SyncSender<bool>),
    Again(Box<Entry>),
    Keep(PathBuf, String, SyncSender<bool>),
    KeepStanding(String, SyncSender<bool>),
}

/// Handle of the writer thread. Only [`settle`](Self::settle) blocks on the disk.
pub struct AuditWriter {
    tasks: SyncSender<Task>,
    health: Arc<Health>,
    /// Time of the last retry, by the clock of `health`.
    retried: Duration,
}

struct Health {
    clock: Clock,
    fails: AtomicBool,
    lost: AtomicU64,
    open: AtomicU64,
    /// Start time of the current task, ns of the clock; 0 if idle.
    begun_ns: AtomicU64,
}

/// Receives the result of writing a record or file.
pub struct Receipt(Option<Receiver<bool>>);

impl Receipt {
    /// True if the record or file was written; `None` while the write is pending.
    pub fn written(&self) -> Option<bool> {
        let Some(receiver) = &self.0 else {
            return Some(false);
        };
        match receiver.try_recv() {
            Ok(written) => Some(written),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(false),
        }
    }
}

impl AuditWriter {
    /// Starts the thread.
    ///
    /// # Errors
    /// The operating system cannot create a thread.
    pub fn start(log: AuditLog, clock: Clock) -> io::Result<Self> {
        let (tasks, work) = sync_channel(MAX_QUEUED);
        let health = Arc::new(Health {
            clock,
            fails: AtomicBool::default(),
            lost: AtomicU64::default(),
            open: AtomicU64::default(),
            begun_ns: AtomicU64::default(),
        });
        let thread_state = WriterThread {
            standing: Slots::new(log.standing_file()),
            log,
            health: Arc::clone(&health),
        };
        thread::Builder::new().name("volcomp-audit".to_owned()).spawn({
            // The thread logs under the span of the machine that starts it.
            let span = tracing::Span::current();
            move || span.in_scope(|| thread_state.run(&work))
        })?;
        Ok(Self { tasks, health, retried: Duration::ZERO })
    }

    /// Queues a record. If the queue is full, the record is lost, and the next written record counts it.
    pub fn record(&self, entry: Entry) -> Receipt {
        let (tell, receipt) = sync_channel(1);
        let is_queued = self.queue_task(Task::Record(Box::new(entry), tell));
        if !is_queued {
            self.health.lost.fetch_add(1, Ordering::Relaxed);
        }
        Receipt(is_queued.then_some(receipt))
    }

    /// Queues a record that tests whether the log is writable again, if records were lost and no task is pending; at
    /// most once per `RETRY_INTERVAL`. The record states the number of lost records.
    pub fn retry(&mut self, entry: impl FnOnce() -> Entry) {
        let health = &self.health;
        let missing =
            health.fails.load(Ordering::Relaxed) || health.lost.load(Ordering::Relaxed) > 0;
        let now = health.clock.elapsed();
        let is_due = now.saturating_sub(self.retried) > RETRY_INTERVAL;
        if missing && is_due && health.open.load(Ordering::Relaxed) == 0 {
            self.retried = now;
            let _ = self.queue_task(Task::Again(Box::new(entry())));
        }
    }

    /// Queues a small file, which is replaced atomically.
    pub fn keep(&self, path: PathBuf, text: String) -> Receipt {
        let (tell, receipt) = sync_channel(1);
        let is_queued = self.queue_task(Task::Keep(path, text, tell));
        Receipt(is_queued.then_some(receipt))
    }

    /// Queues the text of `standing.slots`. The first write allocates the file, so that later writes succeed on a full
    /// disk.
    pub fn keep_standing(&self, text: String) -> Receipt {
        let (tell, receipt) = sync_channel(1);
        let is_queued = self.queue_task(Task::KeepStanding(text, tell));
        Receipt(is_queued.then_some(receipt))
    }

    fn queue_task(&self, task: Task) -> bool {
        self.health.open.fetch_add(1, Ordering::Relaxed);
        let is_queued = self.tasks.try_send(task).is_ok();
        if !is_queued {
            self.health.open.fetch_sub(1, Ordering::Relaxed);
        }
        is_queued
    }

    /// Why records may be missing; `None` if the writer works and no record is lost.
    pub fn trouble(&self) -> Option<&'static str> {
        let health = &self.health;
        if health.fails.load(Ordering::Relaxed) {
            Some("the audit log cannot be written")
        } else if health.lost.load(Ordering::Relaxed) > 0 {
            Some("records of the audit log were lost")
        } else if health.is_late() {
            Some("the disk of the audit log does not answer")
        } else {
            None
        }
    }

    /// Waits at most `patience` until all tasks are complete. Returns false if a task is still pending.
    pub fn settle(&self, patience: Duration) -> bool {
        let end = Instant::now() + patience;
        while self.health.open.load(Ordering::Relaxed) > 0 {
            if Instant::now() > end {
                return false;
            }
            thread::sleep(Duration::from_millis(1));
        }
        true
    }
}

struct WriterThread {
    log: AuditLog,
    standing: Slots,
    health: Arc<Health>,
}

impl WriterThread {
    fn run(mut self, work: &Receiver<Task>) {
        while let Ok(task) = work.recv() {
            self.health.begin();
            self.execute(task);
            self.health.end();
            self.health.open.fetch_sub(1, Ordering::Relaxed);
        }
    }

    fn execute(&mut self, task: Task) {
        // The receipt may have been dropped.
        match task {
            Task::Record(entry, tell) => {
                let _ = tell.try_send(self.write(&entry, 1));
            }
            // A retry record that fails is not counted as lost.
            Task::Again(entry) => {
                self.write(&entry, 0);
            }
            Task::Keep(path, text, tell) => {
                let written = replace_file(&path, &text);
                let _ = tell.try_send(written.is_ok());
                if let Err(e) = written {
                    tracing::error!("{}: {e}", path.display());
                }
            }
            Task::KeepStanding(text, tell) => {
                let written = self.standing.keep(&text);
                let _ = tell.try_send(written.is_ok());
                if let Err(e) = written {
                    tracing::error!("{}: {e}", self.log.standing_file().display());
                }
            }
        }
    }

    /// Writes an entry and returns whether it was written. A failure adds `loss` to the number of lost records.
    fn write(&mut self, entry: &Entry, loss: u64) -> bool {
        let lost = self.health.lost.swap(0, Ordering::Relaxed);
        let written = self.log.write(entry, lost);
        let failed = self.health.fails.swap(written.is_err(), Ordering::Relaxed);
        if let Err(e) = &written {
            self.health.lost.fetch_add(lost + loss, Ordering::Relaxed);
            if !failed {
                tracing::error!("audit log: {e}: no arming until it can be written");
            }
        }
        written.is_ok()
    }
}

impl Health {
    fn is_late(&self) -> bool {
        let begun = self.begun_ns.load(Ordering::Relaxed);
        begun > 0
            && self.now_ns().saturating_sub(begun)
                > u64::try_from(WRITE_TIMEOUT.as_nanos()).unwrap_or(u64::MAX)
    }

    fn begin(&self) {
        self.begun_ns.store(self.now_ns().max(1), Ordering::Relaxed);
    }

    fn end(&self) {
        self.begun_ns.store(0, Ordering::Relaxed);
    }

    fn now_ns(&self) -> u64 {
        u64::try_from(self.clock.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }
}

/// Size of a slot, bytes; larger than the longest text.
const SLOT: usize = 16 * 1024;
const SLOTS: u64 = 2;

/// A file with two slots. The file is created by the first [`keep`](Self::keep).
pub(crate) struct Slots {
    path: PathBuf,
    open: Option<Open>,
}

struct Open {
    file: File,
    count: u64,
}

impl Slots {
    pub(crate) fn new(path: PathBuf) -> Self {
        Self { path, open: None }
    }

    /// Writes a text and syncs it to disk. The first call allocates the file. Errors: the text is too long, the disk
    /// fails, or the disk is full before the file is allocated.
    pub(crate) fn keep(&mut self, text: &str) -> io::Result<()> {
        let mut open = match self.open.take() {
            // The file may have been removed or replaced.
            Some(open) if self.is_in_place(&open.file) => open,
            before => {
                if let (Some(dir), Some(before)) = (self.path.parent(), before) {
                    restore_folder(dir, &before.file)?;
                }
                self.take_room(text)?
            }
        };
        let count = open.count + 1;
        let slot = slot(count, text)?;
        let written = (open.file)
            .write_all_at(slot.as_bytes(), (count % SLOTS) * SLOT as u64)
            .and_then(|()| open.file.sync_data());
        // After a failed write the next call writes the same slot again, because the other slot holds the last intact
        // text.
        if written.is_ok() {
            open.count = count;
        }
        self.open = Some(open);
        written
    }

    fn is_in_place(&self, file: &File) -> bool {
        let length = file.metadata().map(|of| of.len());
        is_at(file, &self.path) && length.is_ok_and(|length| length == SLOTS * SLOT as u64)
    }

    /// Opens the file. If the file is missing or has another size, it is created completely under a temporary name and
    /// then renamed.
    fn take_room(&self, text: &str) -> io::Result<Open> {
        let kept = fs::read(&self.path).unwrap_or_default();
        let count = latest(&kept).map(|(count, _)| count);
        if count.is_none() {
            let [none, first] = [slot(0, text)?, slot(1, text)?];
            replace_file(&self.path, &(none + &first))?;
        }
        Ok(Open {
            file: OpenOptions::new().write(true).open(&self.path)?,
            count: count.unwrap_or(1),
        })
    }
}

fn slot(count: u64, text: &str) -> io::Result<String> {
    let content = format!("{count} {text}");
    let line = format!("{} {content}", checksum(&content));
    if line.len() >= SLOT || text.contains('\n') {
        return Err(io::ErrorKind::FileTooLarge.into());
    }
    Ok(format!("{line:<0$}\n", SLOT - 1 - (line.len() - line.chars().count())))
}

fn checksum(content: &str) -> String {
    volcomp_model::hexadecimal(&Sha256::digest(content.as_bytes()))
}

/// The intact text with the largest counter, and its counter; `None` if no slot is intact, or if the file has another
/// size: the slot that is missing may be the newer one.
pub(crate) fn latest(file: &[u8]) -> Option<(u64, String)> {
    if file.len() as u64 != SLOTS * SLOT as u64 {
        return None;
    }
    let file = String::from_utf8_lossy(file);
    let whole = file.lines().filter_map(|line| {
        let (sum, content) = line.trim_end().split_once(' ')?;
        let (count, text) = content.split_once(' ')?;
        (checksum(content) == sum).then_some((count.parse().ok()?, text.to_owned()))
    });
    whole.max_by_key(|(count, _)| *count)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::{SLOT, Slots, latest};

    fn read(path: &std::path::Path) -> Option<String> {
        let bytes = fs::read(path).expect("there");
        latest(&bytes).map(|(_, text)| text)
    }

    #[test]
    fn the_last_text_is_read_after_a_restart() {
        let dir = tempfile::tempdir().expect("writable");
        let path = dir.path().join("standing.slots");
        for start in 0..3 {
            let mut slots = Slots::new(path.clone());
            for n in 0..5 {
                let text = format!("{{\"who\":\"Jürgen {start} {n}\"}}");
                slots.keep(&text).expect("writable");
                assert_eq!(read(&path).as_deref(), Some(text.as_str()));
                assert_eq!(fs::metadata(&path).expect("there").len(), 2 * SLOT as u64);
            }
        }
    }

    /// After a power failure during a write, either the new or the previous text is read, whichever part of the new slot
    /// reached the disk.
    #[test]
    fn a_torn_slot_leaves_the_text_before() {
        let dir = tempfile::tempdir().expect("writable");
        let path = dir.path().join("standing.slots");
        let mut slots = Slots::new(path.clone());
        for (before, after) in [("[1]", "[22]"), ("[22]", "[333]")] {
            slots.keep(before).expect("writable");
            let old = fs::read(&path).expect("there");
            slots.keep(after).expect("writable");
            let new = fs::read(&path).expect("there");
            let mut news = 0;
            for torn in (0..200).chain([SLOT, SLOT + 90, 2 * SLOT]) {
                for from_behind in [false, true] {
                    let mut mixed = old.clone();
                    let at = if from_behind { torn..new.len() } else { 0..torn };
                    mixed[at.clone()].copy_from_slice(&new[at]);
                    let other = dir.path().join("torn");
                    fs::write(&other, &mixed).expect("writable");
                    let found = read(&other);
                    assert!(
                        [Some(before), Some(after)].contains(&found.as_deref()),
                        "{torn}: {found:?}"
                    );
                    news += usize::from(found.as_deref() == Some(after));
                }
            }
            assert!(news > 0);
        }
    }

    /// One of the two slots may be the older text, such as the one before an operator disarmed.
    #[test]
    fn a_file_with_one_slot_is_not_believed() {
        let dir = tempfile::tempdir().expect("writable");
        let path = dir.path().join("standing.slots");
        let mut slots = Slots::new(path.clone());
        for text in ["[1]", "[2]", "[3]"] {
            slots.keep(text).expect("writable");
            let whole = fs::read(&path).expect("there");
            for kept in [&whole[..SLOT], &whole[SLOT..]] {
                fs::write(&path, kept).expect("writable");
                assert_eq!(read(&path), None, "{text}");
            }
            fs::write(&path, whole).expect("writable");
        }
    }

    #[test]
    fn a_file_that_is_removed_cut_or_foreign_is_made_anew() {
        let dir = tempfile::tempdir().expect("writable");
        let path = dir.path().join("standing.slots");
        let mut slots = Slots::new(path.clone());
        slots.keep("[1]").expect("writable");
        fs::remove_file(&path).expect("there");
        slots.keep("[2]").expect("writable");
        assert_eq!(read(&path).as_deref(), Some("[2]"));
        fs::write(&path, "{}").expect("writable");
        slots.keep("[3]").expect("writable");
        assert_eq!(read(&path).as_deref(), Some("[3]"));
        assert!(slots.keep(&"x".repeat(SLOT)).is_err());
        assert_eq!(read(&path).as_deref(), Some("[3]"));
    }
}
