//! The machine as a member of a fleet: it applies manifests of its centre, and reports to the centre.
//!
//! Manifests are signed by trusted keys. One thread receives and activates manifests, the other sends reports. Neither
//! affects the cycle: like the dashboard, they send requests to the service and read its published state. A disk that
//! hangs delays neither the order to disarm nor the service.
//!
//! State: the folder of accepted manifests, and the queue of messages to the server.

use std::{
    io,
    sync::Arc,
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use tokio::sync::{mpsc, watch};
use volcomp_fleet::{Acknowledgement, LinkSettings, MachineLink, MachineSender};
use volcomp_guard::Reasons;
use volcomp_runtime::DisarmSwitch;

use crate::{
    config::{Config, FleetConfig},
    documents::FleetState,
    error::GatewayError,
    lock,
    published::Published,
    request::RequestSender,
};

mod manifests;
mod reporter;
mod shared;

use manifests::{ManifestActivator, ManifestReceiver, Store, StoredFleet};
use reporter::Reporter;
use shared::Shared;

const RETRY_INTERVAL: Duration = Duration::from_secs(10);
const END_TIMEOUT: Duration = Duration::from_secs(2);

/// Path of the machine file activated by the centre; `None`: missing or damaged.
pub(crate) fn machine_in_force(config: &FleetConfig) -> Option<std::path::PathBuf> {
    let active = stored(config).active?;
    Some(Store::new(config).machine(&active.manifest))
}

pub(crate) fn stored(config: &FleetConfig) -> StoredFleet {
    Store::new(config).read(config)
}

pub(crate) fn forbids(config: &Config) -> Reasons {
    let disabled = |fleet| stored(fleet).standing.disabled;
    Reasons::DISABLED_BY_CENTRE.when(config.fleet.as_ref().is_some_and(disabled))
}

/// The threads that receive manifests and send messages. Dropping this value ends them.
pub struct Fleet {
    stop: watch::Sender<bool>,
    threads: Vec<JoinHandle<()>>,
    _lock: std::os::unix::net::UnixListener,
}

/// Joins the fleet. Returns `None` if the configuration has no `[fleet]`.
///
/// # Errors
/// The folder cannot be created or is used by another gateway, or the operating system cannot create a thread.
pub fn start(
    config: &Config,
    published: &Published,
    requests: &RequestSender,
    switch: &DisarmSwitch,
) -> Result<Option<Fleet>, GatewayError> {
    let Some(fleet) = &config.fleet else {
        return Ok(None);
    };
    let shown = fleet.dir.display().to_string();
    let failed = |e| GatewayError::system(shown.clone(), e);
    let store = Store::new(fleet);
    store.make().map_err(failed)?;
    let lock = lock::lock_fleet(&fleet.dir)?;
    let kept = store.read(fleet);
    let version = kept.standing.active.unwrap_or(0);
    let shared = Arc::new(Shared::new(published.clone(), version));
    published.set_fleet(FleetState {
        site: fleet.site.clone(),
        machine: fleet.machine.clone(),
        connected: false,
        version,
        accepted: kept.standing.highest,
        enabled: !kept.standing.disabled,
        outcome: kept.standing.outcome.as_ref().map(manifests::in_words),
        trouble: kept.damage.clone(),
        refused: None,
        waiting: None,
        dropped: 0,
    });
    let identity = fleet.identity().map_err(|error| {
        let what = error.to_string();
        GatewayError::Place(config.source.error(&config.file, "fleet", what))
    })?;
    let settings = settings(fleet)?;
    let (stop, stopped) = watch::channel(false);
    let (acknowledge, acknowledged) = mpsc::unbounded_channel::<Acknowledgement>();
    let (link_told, link) = watch::channel(None);
    let model = published.model();
    let service = manifests::Service { requests: requests.clone(), switch: switch.clone() };
    let activator = ManifestActivator::new(
        store.clone(),
        kept.clone(),
        service.clone(),
        Arc::clone(&shared),
        acknowledge,
    );
    let receiver = ManifestReceiver::new(
        manifests::trust(fleet, identity.machine.clone()),
        model.axes.clone(),
        &kept,
        service,
        Arc::clone(&shared),
    );
    let until = stopped.clone();
    let known = Arc::clone(&shared);
    let (watched, of) = (Arc::clone(&shared), shown.clone());
    let receiving = spawn("volcomp-fleet", async move {
        let work = async {
            let link = connected(&settings, &identity, &link_told, &known).await;
            manifests::receive(link, receiver, activator).await;
        };
        let work = async {
            tokio::select! {
                () = work => {}
                () = shared::watch(&watched, &of) => {}
            }
        };
        until_stopped(until, Box::pin(work)).await;
    })
    .map_err(failed)?;
    let reporter = Reporter::new(store, config.audit_dir().to_owned(), Arc::clone(&shared), link);
    let reporting = spawn("volcomp-report", reporter.run(acknowledged, stopped)).map_err(failed)?;
    Ok(Some(Fleet { stop, threads: vec![receiving, reporting], _lock: lock }))
}

/// Connection settings, with the seed from its file. Errors: the file is readable by other users, or does not contain a seed.
pub(crate) fn settings(config: &FleetConfig) -> Result<LinkSettings, GatewayError> {
    let file = &config.nkey_file;
    let seed = volcomp_document::private::read(file)?;
    let settings = LinkSettings {
        url: config.url.clone(),
        seed: seed.trim().to_owned(),
        roots: config.ca.clone(),
    };
    if settings.public_key().is_err() {
        let expected =
            "expected the seed of an nkey of a user: SU and 56 capital letters and digits";
        return Err(GatewayError::invalid_in(file.display(), expected));
    }
    Ok(settings)
}

async fn connected(
    settings: &LinkSettings,
    identity: &volcomp_fleet::Identity,
    told: &watch::Sender<Option<MachineSender>>,
    shared: &Shared,
) -> MachineLink {
    let mut last = None;
    loop {
        match MachineLink::connect(settings, identity).await {
            Ok(link) => {
                // Clear only an error that this function set.
                shared.published.update_fleet(|state| {
                    if last.is_some() && state.trouble == last {
                        state.trouble = None;
                    }
                });
                // The receiver may have been dropped.
                let _ = told.send(Some(link.sender()));
                return link;
            }
            Err(error) => {
                tracing::error!("fleet: {error}");
                last = Some(error.to_string());
                let trouble = last.clone();
                shared.published.update_fleet(|state| state.trouble = trouble);
            }
        }
        tokio::time::sleep(RETRY_INTERVAL).await;
    }
}

fn spawn(
    name: &str,
    work: impl Future<Output = ()> + Send + 'static,
) -> io::Result<JoinHandle<()>> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .max_blocking_threads(2)
        .build()?;
    thread::Builder::new().name(name.to_owned()).spawn(move || {
        runtime.block_on(work);
        // Do not wait for blocking tasks that hang on a disk.
        runtime.shutdown_background();
    })
}

async fn until_stopped(mut stopped: watch::Receiver<bool>, work: impl Future<Output = ()>) {
    tokio::select! {
        // A dropped sender also ends the task.
        _ = stopped.wait_for(|stop| *stop) => {}
        () = work => {}
    }
}

impl Fleet {
    /// Stops both threads. Waits at most [`END_TIMEOUT`] for them to send pending messages and write the rest to disk.
    fn stop_all(&mut self) {
        let _ = self.stop.send(true);
        let end = Instant::now() + END_TIMEOUT;
        for thread in self.threads.drain(..) {
            while !thread.is_finished() && Instant::now() < end {
                thread::sleep(Duration::from_millis(2));
            }
            if thread.is_finished() {
                // The panic was printed when it occurred.
                let _ = thread.join();
            }
        }
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.stop_all();
    }
}
