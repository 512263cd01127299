//! The thread that writes the audit log and the small files in its folder. Only callers that wait
//! for a receipt are delayed by a disk that hangs.

use std::{
    io,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, TryRecvError, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use volcomp_port::Clock;

use super::{AuditLog, Entry, replace_file, slots::Slots};

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
