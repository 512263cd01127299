//! New models: machine files that engineers send, their comparison with the model in force, and the way into force, which is
//! that of a reload.
//!
//! Nothing here touches the cycle. Requests come from the dashboard; machine files are compared on quiet threads; one thread, the
//! desk, keeps the models on disk and asks the service to take one. State: the folder of `store`, and the candidate, which does
//! not outlive the program.

use std::{
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize},
        mpsc::{Sender, channel},
    },
};

use tokio::sync::oneshot;
use volcomp_runtime::DisarmSwitch;

use crate::{
    config::Config,
    documents::{Candidate, ModelEntry, ModelSource, ModelState},
    error::GatewayError,
    locked,
    published::Published,
    request::{Asks, Reply, refused},
};

mod candidate;
mod desk;
mod diagonals;
mod quiet;
mod shared;
pub(crate) mod store;

pub(crate) use candidate::{LARGEST_FILE, Place};
use desk::Desk;
use shared::{Activate, BUILT_IN, GIVEN_UP, Job, Patience, Shared};
use store::Store;

/// The models of a machine, as the dashboard has them.
#[derive(Clone)]
pub struct Models {
    shared: Arc<Shared>,
    jobs: Sender<Job>,
}

/// Where the service tells what became of a model. Without a desk nothing is told.
#[derive(Clone, Default)]
pub struct ModelNotes(Option<Sender<Job>>);

impl ModelNotes {
    /// Tells what became of a model; with its machine file where it is in force.
    pub(crate) fn tell(&self, entry: ModelEntry, text: Option<String>) {
        if let Some(jobs) = &self.0 {
            // The desk has ended only where the gateway ends.
            let _ = jobs.send(Job::Noted(Box::new(entry), text));
        }
    }

    /// Tells that the configuration names another machine file.
    pub(crate) fn configured(&self, machine: PathBuf) {
        if let Some(jobs) = &self.0 {
            let _ = jobs.send(Job::Configured(machine));
        }
    }
}

impl Models {
    /// Begins to keep the models of a machine. `is_built_in`: the built-in simulation runs, whose machine file cannot change.
    ///
    /// # Errors
    /// The operating system gives no thread.
    pub fn start(
        config: &Config,
        is_built_in: bool,
        published: &Published,
        asks: &Asks,
        switch: &DisarmSwitch,
    ) -> Result<Self, GatewayError> {
        let shared = Arc::new(Shared {
            store: Store::new(config.audit_dir()),
            is_built_in,
            cycle_cpu: config.realtime.cpu,
            published: published.clone(),
            asks: asks.clone(),
            switch: switch.clone(),
            told: Mutex::default(),
            candidate: Mutex::default(),
            uploading: AtomicUsize::new(0),
            is_comparing: AtomicBool::new(false),
        });
        let (jobs, work) = channel();
        let desk = Desk::new(Arc::clone(&shared), config.configured_machine.clone());
        quiet::spawn("volcomp-models", config.realtime.cpu, move || {
            desk.run(&work);
        })
        .map_err(|e| GatewayError::system("models", e))?;
        Ok(Self { shared, jobs })
    }

    /// Where the service tells what became of a model.
    pub fn notes(&self) -> ModelNotes {
        ModelNotes(Some(self.jobs.clone()))
    }

    /// How it stands.
    pub(crate) fn state(&self) -> ModelState {
        let shared = &self.shared;
        let model = shared.published.model();
        let candidate = locked(&shared.candidate);
        let told = locked(&shared.told);
        let mut configured = told.configured.clone();
        // The built-in simulation has no file that could differ.
        configured.differs = !shared.is_built_in && configured.hash.as_ref() != Some(&model.hash);
        ModelState {
            hash: model.hash.clone(),
            name: model.name.clone(),
            from: told.from,
            put_in_force: told
                .kept
                .in_force
                .clone()
                .filter(|known| known.hash == model.hash && told.from != ModelSource::Centre),
            configured,
            candidate: candidate.as_ref().map(|held| held.document.brief.clone()),
            history: told.kept.history.iter().rev().cloned().collect(),
            kept: told.there.clone(),
            largest_file_bytes: LARGEST_FILE as u64,
            no_files: shared.is_built_in.then(|| BUILT_IN.to_owned()),
            trouble: told.trouble.clone(),
        }
    }

    /// A place for a file that is received.
    pub(crate) fn place(&self) -> Result<Place, Reply> {
        candidate::place(&self.shared)
    }

    /// Takes a machine file of `who`, and begins to compare it.
    pub(crate) fn take(&self, who: &str, name: &str, bytes: Vec<u8>) -> Result<Candidate, Reply> {
        candidate::take(&self.shared, who, name, bytes)
    }

    /// The candidate, where there is one.
    pub(crate) fn candidate(&self) -> Option<Candidate> {
        let candidate = locked(&self.shared.candidate);
        candidate.as_ref().map(|held| held.document.clone())
    }

    /// Gives the candidate up.
    pub(crate) fn discard(&self, id: &str) -> Result<ModelState, Reply> {
        self.shared.discard(id)?;
        Ok(self.state())
    }

    /// Asks the desk to put the candidate in force. `hash`: that of the result which `who` has seen.
    pub(crate) fn activate(
        &self,
        who: &str,
        id: &str,
        hash: &str,
        confirm: Option<String>,
    ) -> Result<Answering, Reply> {
        let what = self.shared.ready(id, hash)?;
        Ok(self.ask(who, what, confirm))
    }

    /// Asks the desk to put a model that is kept in force, or the configured machine file.
    pub(crate) fn back(
        &self,
        who: &str,
        hash: Option<String>,
        confirm: Option<String>,
    ) -> Result<Answering, Reply> {
        if self.shared.is_built_in {
            return Err(refused(422, BUILT_IN));
        }
        let what = hash.map_or(Activate::Configured, Activate::Kept);
        Ok(self.ask(who, what, confirm))
    }

    fn ask(&self, who: &str, what: Activate, confirm: Option<String>) -> Answering {
        let (answer, answered) = oneshot::channel();
        let patience = Patience::begin();
        // Where the desk has ended the receiver tells so.
        let _ = self.jobs.send(Job::Activate {
            who: who.to_owned(),
            what,
            confirm,
            answer,
            patience: patience.clone(),
        });
        Answering { answered, patience }
    }
}

/// The answer to a request that the desk has, waited for.
pub(crate) struct Answering {
    answered: oneshot::Receiver<Reply>,
    patience: Patience,
}

impl Answering {
    /// The answer. A disk that hangs is waited for only so long, and the request is given up then.
    pub(crate) async fn answer(self) -> Reply {
        let Self {
            mut answered,
            patience,
        } = self;
        let ended = match tokio::time::timeout(patience.left(), &mut answered).await {
            Err(_) if patience.gives_up() => {
                tracing::warn!("models: {GIVEN_UP}");
                return refused(503, GIVEN_UP);
            }
            // The service has it, which answers in its time.
            Err(_) => answered.await,
            Ok(ended) => ended,
        };
        ended.unwrap_or_else(|_| refused(503, "the gateway is stopping"))
    }
}
