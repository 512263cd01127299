//! The running centre: collects messages of the machines, sends their desired state, advances roll-outs and raises alarms.
//!
//! The store holds all state that must outlive the program. The command line and the web interface write their requests to the store, and the
//! engine reads them once a second. Only the latest received state is held in memory.

mod alarms;
mod pass;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    time::{Duration, Instant},
};

use tokio::sync::oneshot;
use volcomp_fleet::{Hub, LinkSettings, MachineId, Received, SiteId, StreamRetention};

use crate::{
    Error,
    ingest::Ingest,
    keys::Key,
    records::AlarmKind,
    store::{Retention, Store},
};

const PASS_INTERVAL: Duration = Duration::from_secs(1);
const MAX_QUEUED_BATCHES: usize = 64;
const MAX_MESSAGES_PER_WRITE: usize = 8_000;
/// Retry interval if the database rejects a write. Until then the messages stay at the server.
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

pub struct Settings {
    pub link: LinkSettings,
    pub stream_retention: StreamRetention,
    pub keep: Retention,
    pub key: Key,
    /// All signing keys of this centre; a value signed by any of them counts as its own.
    pub own: Vec<Key>,
}

struct Failure {
    text: String,
    /// True once the failure has ended. The entry is kept until its alarm is stored, because a database that rejects
    /// writes cannot store an alarm either.
    over: bool,
}

pub struct Engine {
    store: Arc<Store>,
    hub: Hub,
    settings: Settings,
    ingest: Mutex<Ingest>,
    /// Last value that this centre wrote to the key-value store for each machine: version and
    /// bytes.
    put: Mutex<BTreeMap<MachineId, (u64, bytes::Bytes)>>,
    clobbered: Mutex<BTreeMap<MachineId, Instant>>,
    failures: Mutex<BTreeMap<AlarmKind, Failure>>,
    ending: AtomicBool,
}

pub struct Running {
    engine: Arc<Engine>,
    tasks: tokio::task::JoinHandle<()>,
    writer: oneshot::Receiver<()>,
}

impl Running {
    pub fn engine(&self) -> &Arc<Engine> {
        &self.engine
    }

    /// Waits until a part of the engine ends, which is always a failure, and returns the name of that part.
    pub async fn ended(&mut self) -> &'static str {
        tokio::select! {
            _ = &mut self.tasks => "the engine",
            _ = &mut self.writer => "the thread that writes",
        }
    }

    /// Stops the engine. The server redelivers unstored messages, because they were not acknowledged.
    pub async fn end(self) {
        self.engine.ending.store(true, Ordering::Relaxed);
        // The engine stops within one pass.
        let _ = self.tasks.await;
    }
}

impl Engine {
    /// Starts the engine on the runtime of the caller. The engine keeps retrying if it cannot reach the server.
    pub async fn start(store: Arc<Store>, settings: Settings) -> Result<Running, Error> {
        let hub = Hub::connect(&settings.link).await?;
        let store_clone = Arc::clone(&store);
        let ingest = blocking(move || Ingest::of(&store_clone)).await?;
        let engine = Arc::new(Self {
            store,
            hub,
            settings,
            ingest: Mutex::new(ingest),
            put: Mutex::default(),
            clobbered: Mutex::default(),
            failures: Mutex::default(),
            ending: AtomicBool::new(false),
        });
        let (send, jobs) = mpsc::sync_channel(MAX_QUEUED_BATCHES);
        let writer_engine = Arc::clone(&engine);
        let (alive, writer) = oneshot::channel::<()>();
        std::thread::Builder::new().name("writer".to_owned()).spawn(move || {
            // `ended()` detects the drop of this value when the thread ends for any reason.
            let _alive = alive;
            write(&writer_engine, &jobs);
        })?;
        let tasks = tokio::spawn(run(Arc::clone(&engine), send));
        Ok(Running { engine, tasks, writer })
    }

    pub fn store(&self) -> &Arc<Store> {
        &self.store
    }

    pub fn is_connected(&self) -> bool {
        self.hub.is_connected()
    }

    fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Relaxed)
    }

    /// Sets (`Some`) or clears (`None`) a failure of the centre itself.
    fn set_failure(&self, kind: AlarmKind, text: Option<String>) {
        let mut failures = lock(&self.failures);
        match text {
            Some(text) => {
                let reported = failures.get(&kind).filter(|known| !known.over);
                if reported.is_none_or(|known| known.text != text) {
                    tracing::error!("{}: {text}", kind.name());
                }
                failures.insert(kind, Failure { text, over: false });
            }
            None => {
                if let Some(known) = failures.get_mut(&kind).filter(|known| !known.over) {
                    known.over = true;
                    tracing::info!("{}: it works again", kind.name());
                }
            }
        }
    }
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done,
        // The work panicked, or the program is shutting down: propagate it to the caller.
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => std::future::pending().await,
        },
    }
}

/// Runs the pass once a second, the collections of the sites, and the watch on the keys.
async fn run(engine: Arc<Engine>, jobs: mpsc::SyncSender<WriteJob>) {
    let mut tasks = tokio::task::JoinSet::new();
    tasks.spawn(pass::watch(Arc::clone(&engine)));
    let mut sites = BTreeSet::new();
    let mut passes = tokio::time::interval(PASS_INTERVAL);
    passes.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut state = pass::State::new();
    while !engine.is_ending() {
        passes.tick().await;
        // These tasks never end by design. If a task has ended, a site or the keys are unattended, so the engine
        // restarts.
        if tasks.try_join_next().is_some() {
            tracing::error!("a part of the engine has ended");
            return;
        }
        for site in pass::sites(&engine).await {
            // The alarm reports a missing server once; do not log it for each site.
            let is_new = !sites.contains(&site) && engine.is_connected();
            if is_new && prepared(&engine, &site).await {
                for collection in engine.hub.collections(&site) {
                    tasks.spawn(collect(
                        Arc::clone(&engine),
                        site.clone(),
                        collection,
                        jobs.clone(),
                    ));
                }
                sites.insert(site);
            }
        }
        state = pass::run(&engine, state).await;
        let sent = pass::send(&engine).await;
        let failure = match sent {
            _ if !engine.is_connected() => Some(format!(
                "the NATS server cannot be reached: found none at {} that accepts the nkey of this centre, expected a nats-server with the configuration of `nats-config`",
                engine.settings.link.url
            )),
            sent => sent.err(),
        };
        engine.set_failure(AlarmKind::Server, failure);
    }
    tasks.shutdown().await;
}

async fn prepared(engine: &Engine, site: &SiteId) -> bool {
    let made =
        engine.hub.prepare(std::slice::from_ref(site), engine.settings.stream_retention).await;
    if let Err(error) = &made {
        tracing::warn!("the streams of {site}: {error}");
    }
    made.is_ok()
}

/// Receives the messages of a site's machines and acknowledges them when they are on disk. The next batches are received while one is written; the
/// server limits the number in flight.
async fn collect(
    engine: Arc<Engine>,
    site: SiteId,
    mut collection: volcomp_fleet::Collection,
    jobs: mpsc::SyncSender<WriteJob>,
) {
    let mut written = tokio::task::JoinSet::new();
    loop {
        while written.try_join_next().is_some() {}
        let mut batch = match collection.next().await {
            Ok(batch) => batch,
            Err(error) => {
                tracing::warn!("{}: {error}", collection.stream());
                // The server may have lost its disk: create the streams again, and check every value and model.
                if prepared(&engine, &site).await {
                    lock(&engine.put).clear();
                }
                continue;
            }
        };
        if batch.messages.is_empty() {
            continue;
        }
        let (stored, waits) = oneshot::channel();
        let mut job = WriteJob { messages: std::mem::take(&mut batch.messages), stored };
        // The queue of the writer thread: if it is full, retry; the server holds further messages.
        while let Err(error) = jobs.try_send(job) {
            match error {
                mpsc::TrySendError::Full(back) => {
                    job = back;
                    tokio::time::sleep(Duration::from_millis(5)).await;
                }
                mpsc::TrySendError::Disconnected(_) => return,
            }
        }
        let stream = collection.stream().to_owned();
        written.spawn(async move {
            // An error means that the centre is shutting down; the server redelivers the unacknowledged messages.
            if waits.await.is_ok()
                && let Err(error) = batch.acknowledge().await
            {
                tracing::warn!("{stream}: {error}");
            }
        });
    }
}

struct WriteJob {
    messages: Vec<Received>,
    stored: oneshot::Sender<()>,
}

/// Stores messages on the writer thread until the queue is closed. All queued jobs go into one transaction, so that many sites cost one commit.
fn write(engine: &Arc<Engine>, jobs: &mpsc::Receiver<WriteJob>) {
    while let Ok(first) = jobs.recv() {
        let mut waiting = vec![first];
        let mut count = waiting[0].messages.len();
        while count < MAX_MESSAGES_PER_WRITE
            && let Ok(next) = jobs.try_recv()
        {
            count += next.messages.len();
            waiting.push(next);
        }
        let mut all = Vec::with_capacity(count);
        let mut waiting_tasks = Vec::with_capacity(waiting.len());
        for job in waiting {
            all.extend(job.messages);
            waiting_tasks.push(job.stored);
        }
        if store(engine, &all) {
            for stored in waiting_tasks {
                // An error means that the waiting task has ended. The server redelivers the messages, and they are
                // recognized as duplicates.
                let _ = stored.send(());
            }
        }
    }
}

/// Returns true when all messages are on disk. Returns false if the centre shuts down first: then no message may be
/// acknowledged.
fn store(engine: &Engine, messages: &[Received]) -> bool {
    loop {
        let result = lock(&engine.ingest).take(&engine.store, messages);
        match result {
            Ok(_) => {
                engine.set_failure(AlarmKind::Store, None);
                return true;
            }
            Err(error) => {
                engine.set_failure(AlarmKind::Store, Some(error.to_string()));
                if engine.is_ending() {
                    return false;
                }
                std::thread::sleep(RETRY_INTERVAL);
            }
        }
    }
}

/// Locks a mutex and ignores poisoning: a value is changed only after its transaction, so a panic leaves it consistent.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {

    use super::*;

    fn settings(folder: &std::path::Path) -> Settings {
        let key = Key::create(folder, "main").expect("writable");
        Settings {
            link: LinkSettings {
                // No server listens there; the engine keeps trying.
                url: "nats://127.0.0.1:1".to_owned(),
                seed: nkeys::KeyPair::new_user().seed().expect("a seed"),
                roots: None,
            },
            stream_retention: StreamRetention::default(),
            keep: Retention::default(),
            own: vec![],
            key,
        }
    }

    /// A panic in a pass and an ended writer thread are reported by name; the program ends with status 1.
    #[tokio::test(flavor = "multi_thread")]
    async fn an_ended_part_is_named() {
        let folder = tempfile::tempdir().expect("writable");
        let at = folder.path().join("centre.db");
        let store = Arc::new(Store::open(&at).expect("writable"));
        let started = Engine::start(store.clone(), settings(folder.path())).await;
        let mut running = started.expect("started");
        let within = Duration::from_millis(1500);
        let early = tokio::time::timeout(within, running.ended()).await;
        assert!(early.is_err(), "it runs");
        store.inject_fault();
        let ended = tokio::time::timeout(Duration::from_secs(60), running.ended()).await;
        // Both tasks use the store, and either may meet the fault first.
        let ended = ended.expect("it ends");
        assert!(["the engine", "the thread that writes"].contains(&ended), "{ended}");
        assert_eq!(Error::Ended("the engine").status(), 1);

        let (alive, writer) = oneshot::channel();
        drop(alive);
        let mut running = Running {
            engine: Arc::clone(running.engine()),
            tasks: tokio::spawn(std::future::pending()),
            writer,
        };
        assert_eq!(running.ended().await, "the thread that writes");
        let (_alive, writer) = oneshot::channel();
        let mut running =
            Running { engine: Arc::clone(running.engine()), tasks: tokio::spawn(async {}), writer };
        assert_eq!(running.ended().await, "the engine");
    }
}
