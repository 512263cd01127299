//! New models: uploaded machine files, their comparison with the active model, and their activation, which works like a
//! reload.
//!
//! The code of this module does not run in the cycle. Requests come from the dashboard, machine files are compared on
//! low-priority threads, and one worker thread stores models on disk and requests their activation.
//!
//! State: the folder of `store`, and the candidate, which does not survive a restart.

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
    request::{Reply, RequestSender, refused},
};

mod candidate;
pub(crate) mod store;
mod worker;

pub(crate) use candidate::{MAX_FILE_BYTES, UploadSlot};
use store::Store;
use worker::{Activate, BUILT_IN, GIVEN_UP, Job, ModelWorker, RequestDeadline, Shared};

/// The models of a machine, as used by the dashboard.
#[derive(Clone)]
pub struct Models {
    shared: Arc<Shared>,
    jobs: Sender<Job>,
}

/// Channel on which the service reports the outcomes of models. Without a worker the reports are dropped.
#[derive(Clone, Default)]
pub struct ModelReports(Option<Sender<Job>>);

impl ModelReports {
    /// Reports the outcome of a model; `text` is its machine file if it was activated.
    pub(crate) fn report(&self, entry: ModelEntry, text: Option<String>) {
        if let Some(jobs) = &self.0 {
            // The worker ends only with the gateway.
            let _ = jobs.send(Job::Record(Box::new(entry), text));
        }
    }

    pub(crate) fn configured(&self, machine: PathBuf) {
        if let Some(jobs) = &self.0 {
            let _ = jobs.send(Job::Configured(machine));
        }
    }
}

impl Models {
    /// Starts managing the models of a machine. `is_built_in` is true for the built-in simulation, whose machine file
    /// cannot change.
    ///
    /// # Errors
    /// The operating system cannot create a thread.
    pub fn start(
        config: &Config,
        is_built_in: bool,
        published: &Published,
        requests: &RequestSender,
        switch: &DisarmSwitch,
    ) -> Result<Self, GatewayError> {
        let shared = Arc::new(Shared {
            store: Store::new(config.audit_dir()),
            is_built_in,
            cycle_cpu: config.realtime.cpu,
            published: published.clone(),
            requests: requests.clone(),
            switch: switch.clone(),
            shown: Mutex::default(),
            candidate: Mutex::default(),
            uploading: AtomicUsize::new(0),
            is_comparing: AtomicBool::new(false),
        });
        let (jobs, work) = channel();
        let worker = ModelWorker::new(Arc::clone(&shared), config.configured_machine.clone());
        candidate::spawn("volcomp-models", config.realtime.cpu, move || {
            worker.run(&work);
        })
        .map_err(|e| GatewayError::system("models", e))?;
        Ok(Self { shared, jobs })
    }

    /// Channel on which the service reports the outcomes of models.
    pub fn notes(&self) -> ModelReports {
        ModelReports(Some(self.jobs.clone()))
    }

    pub(crate) fn state(&self) -> ModelState {
        let shared = &self.shared;
        let model = shared.published.model();
        let candidate = locked(&shared.candidate);
        let shown = locked(&shared.shown);
        let mut configured = shown.configured.clone();
        // The built-in simulation has no configured file.
        configured.differs = !shared.is_built_in && configured.hash.as_ref() != Some(&model.hash);
        ModelState {
            hash: model.hash.clone(),
            name: model.name.clone(),
            from: shown.from,
            put_in_force: shown
                .kept
                .in_force
                .clone()
                .filter(|known| known.hash == model.hash && shown.from != ModelSource::Centre),
            configured,
            candidate: candidate.as_ref().map(|held| held.document.brief.clone()),
            history: shown.kept.history.iter().rev().cloned().collect(),
            kept: shown.stored.clone(),
            largest_file_bytes: MAX_FILE_BYTES as u64,
            no_files: shared.is_built_in.then(|| BUILT_IN.to_owned()),
            trouble: shown.trouble.clone(),
        }
    }

    pub(crate) fn place(&self) -> Result<UploadSlot, Reply> {
        candidate::place(&self.shared)
    }

    pub(crate) fn take(&self, who: &str, name: &str, bytes: Vec<u8>) -> Result<Candidate, Reply> {
        candidate::take(&self.shared, who, name, bytes)
    }

    pub(crate) fn candidate(&self) -> Option<Candidate> {
        let candidate = locked(&self.shared.candidate);
        candidate.as_ref().map(|held| held.document.clone())
    }

    pub(crate) fn discard(&self, id: &str) -> Result<ModelState, Reply> {
        self.shared.discard(id)?;
        Ok(self.state())
    }

    pub(crate) fn activate(
        &self,
        who: &str,
        id: &str,
        hash: &str,
        confirm: Option<String>,
    ) -> Result<PendingReply, Reply> {
        let what = self.shared.ready(id, hash)?;
        Ok(self.request_activation(who, what, confirm))
    }

    pub(crate) fn back(
        &self,
        who: &str,
        hash: Option<String>,
        confirm: Option<String>,
    ) -> Result<PendingReply, Reply> {
        if self.shared.is_built_in {
            return Err(refused(422, BUILT_IN));
        }
        let what = hash.map_or(Activate::Configured, Activate::Kept);
        Ok(self.request_activation(who, what, confirm))
    }

    fn request_activation(
        &self,
        who: &str,
        what: Activate,
        confirm: Option<String>,
    ) -> PendingReply {
        let (answer, answered) = oneshot::channel();
        let deadline = RequestDeadline::start();
        // If the worker has ended, the receiver of the response returns an error.
        let _ = self.jobs.send(Job::Activate {
            who: who.to_owned(),
            what,
            confirm,
            answer,
            deadline: deadline.clone(),
        });
        PendingReply { answered, deadline }
    }
}

pub(crate) struct PendingReply {
    answered: oneshot::Receiver<Reply>,
    deadline: RequestDeadline,
}

impl PendingReply {
    /// Waits for the response. If the disk hangs, the request is withdrawn after a timeout.
    pub(crate) async fn answer(self) -> Reply {
        let Self { mut answered, deadline } = self;
        let ended = match tokio::time::timeout(deadline.left(), &mut answered).await {
            Err(_) if deadline.withdraw() => {
                tracing::warn!("models: {GIVEN_UP}");
                return refused(503, GIVEN_UP);
            }
            // The service already has the request and responds within its own timeout.
            Err(_) => answered.await,
            Ok(ended) => ended,
        };
        ended.unwrap_or_else(|_| refused(503, "the gateway is stopping"))
    }
}
