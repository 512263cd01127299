//! The thread that stores models on disk and requests their activation.
//!
//! An activation has three steps. The worker stores the machine file under its hash. The service compares it, asks for
//! confirmation, writes an audit record and ramps, as for a reload. Then the worker stores the activation. Failed
//! writes are retried and reported. After a restart between two steps the previous model is active.

use std::{
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc::{Receiver, RecvTimeoutError},
    },
    time::{Duration, Instant},
};

use tokio::sync::oneshot;
use volcomp_model::Machine;
use volcomp_runtime::DisarmSwitch;

use crate::{
    audit::utc_now,
    documents::{
        Answer, Candidate, ConfiguredModel, ModelEntry, ModelInForce, ModelOutcome, ModelSource,
        ModelsKept,
    },
    identity::{ACTIVE, Differences, differences},
    locked,
    models::store::{self, Store},
    published::Published,
    request::{ModelActivation, Operation, Reply, RequestSender, ServiceRequest, refused},
};

/// Interval at which the configured machine file is checked and failed writes are retried.
const POLL_INTERVAL: Duration = Duration::from_secs(2);

/// An active machine file that could not be stored. It cannot be activated again later.
struct UnsavedModel {
    hash: String,
    text: String,
    error: String,
}

pub(crate) struct ModelWorker {
    shared: Arc<Shared>,
    configured: PathBuf,
    kept: ModelsKept,
    /// Why the model activated by an operator was not loaded; cleared by the next activation.
    damage: Option<String>,
    unsaved: Option<UnsavedModel>,
    unwritten: Option<String>,
}

impl ModelWorker {
    pub(crate) fn new(shared: Arc<Shared>, configured: PathBuf) -> Self {
        Self {
            shared,
            configured,
            kept: ModelsKept::default(),
            damage: None,
            unsaved: None,
            unwritten: None,
        }
    }

    pub(crate) fn run(mut self, work: &Receiver<Job>) {
        let (kept, damage) = self.shared.store.read();
        self.kept = kept;
        if !self.shared.is_built_in {
            self.damage = self.shared.store.in_force().err().map(|what| {
                format!("{what}: the model that an operator activated was not loaded, another one corrects")
            });
        }
        if damage.is_some()
            && let Err(e) = self.shared.store.set_aside()
        {
            tracing::error!("models: {e}");
        }
        self.publish();
        loop {
            match work.recv_timeout(POLL_INTERVAL) {
                Ok(Job::Record(entry, text)) => self.note(*entry, text),
                Ok(Job::Configured(machine)) => self.configured = machine,
                Ok(Job::Activate { who, what, confirm, answer, deadline }) => {
                    let reply = self.activate(&who, what, confirm, &deadline, work);
                    // Publish first, so that a state read after the response is consistent with it.
                    self.publish();
                    // The receiver may have been dropped.
                    let _ = answer.send(reply);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if let Some(UnsavedModel { hash, text, .. }) = self.unsaved.take() {
                self.keep(hash, text);
            }
            if self.unwritten.is_some() {
                self.write();
            }
            self.publish();
        }
    }

    fn publish(&self) {
        let path = &self.configured;
        let mut configured =
            ConfiguredModel { file: path.display().to_string(), ..ConfiguredModel::default() };
        if !self.shared.is_built_in {
            match Machine::read(path) {
                Ok(machine) => configured.hash = Some(machine.checksum()),
                Err(e) => configured.error = Some(e.to_string()),
            }
        }
        let stored = self.shared.store.stored_hashes(&self.kept);
        let mut shown = locked(&self.shared.shown);
        shown.kept.clone_from(&self.kept);
        shown.stored = stored;
        shown.configured = configured;
        let unsaved = self.unsaved.as_ref().map(|unsaved| {
            let error = &unsaved.error;
            format!("the active model cannot be kept on disk ({error}) and cannot be reactivated later. It is retried")
        });
        let trouble = [&self.damage, &unsaved, &self.unwritten];
        let trouble: Vec<&str> = trouble.into_iter().flatten().map(String::as_str).collect();
        shown.trouble = (!trouble.is_empty()).then(|| trouble.join("; "));
    }

    fn keep(&mut self, hash: String, text: String) {
        self.unsaved = match self.shared.store.keep(&hash, &text) {
            Ok(()) => None,
            Err(e) => Some(UnsavedModel { hash, text, error: e.to_string() }),
        };
    }

    fn note(&mut self, entry: ModelEntry, text: Option<String>) {
        if entry.outcome == ModelOutcome::InForce {
            locked(&self.shared.shown).from = entry.from;
            if let Some(text) = text {
                self.keep(entry.hash.clone(), text);
            }
        }
        let mut newest = self.kept.history.iter().rev();
        let is_again = match entry.outcome {
            // After a restart the gateway reports the same model again.
            ModelOutcome::InForce if entry.who == GATEWAY => {
                let last = newest.find(|known| known.outcome == ModelOutcome::InForce);
                last.is_some_and(|last| (&last.hash, last.from) == (&entry.hash, entry.from))
            }
            ModelOutcome::InForce => false,
            // Repeated refusals of the same request get one entry.
            _ => newest.next().is_some_and(|last| {
                let of = |of: &ModelEntry| (of.hash.clone(), of.outcome, of.who.clone());
                of(last) == of(&entry)
            }),
        };
        let ends_person =
            entry.outcome == ModelOutcome::InForce && entry.from == ModelSource::Centre;
        if ends_person {
            self.damage = None;
        }
        if ends_person && self.kept.in_force.take().is_none() && is_again {
            return;
        }
        if !is_again {
            store::add(&mut self.kept, entry);
        } else if !ends_person {
            return;
        }
        self.write();
    }

    fn write(&mut self) {
        match self.shared.store.keep_standing(&self.kept) {
            Ok(()) => self.unwritten = None,
            Err(e) => {
                if self.unwritten.is_none() {
                    tracing::error!("models: {e}");
                }
                self.unwritten = Some(format!(
                    "the active model cannot be recorded ({e}): a restart would load the previous one. It is retried"
                ));
            }
        }
    }

    fn activate(
        &mut self,
        who: &str,
        what: Activate,
        confirm: Option<String>,
        deadline: &RequestDeadline,
        work: &Receiver<Job>,
    ) -> Reply {
        // The request timed out in the queue: do not start it.
        if deadline.left().is_zero() {
            tracing::warn!("models: {who}: {GIVEN_UP}");
            return refused(503, GIVEN_UP);
        }
        let (activation, candidate) = match self.prepare(what, confirm) {
            Ok(prepared) => prepared,
            Err(reply) => return reply,
        };
        if !deadline.claim() {
            tracing::warn!("models: {who}: {GIVEN_UP}");
            let refused_for = GIVEN_UP.to_owned();
            let entry = ModelEntry::refused(
                who,
                activation.hash,
                activation.from,
                activation.file,
                refused_for,
            );
            self.note(entry, None);
            return refused(503, GIVEN_UP);
        }
        let (hash, file, is_configured) = (
            activation.hash.clone(),
            activation.file.clone(),
            activation.machine == self.configured,
        );
        let (answer, receiver) = oneshot::channel();
        let request = ServiceRequest::new(
            Operation::Model(Box::new(activation)),
            who,
            Some(answer),
            &self.shared.switch,
        );
        if self.shared.requests.try_send(request).is_err() {
            return refused(503, "too many requests wait");
        }
        let Ok(mut reply) = receiver.blocking_recv() else {
            return refused(503, "the gateway is stopping");
        };
        // The service sent its report before the response. Refuse activations requested meanwhile.
        while let Ok(job) = work.try_recv() {
            match job {
                Job::Record(entry, text) => self.note(*entry, text),
                Job::Configured(machine) => self.configured = machine,
                Job::Activate { answer, .. } => {
                    let busy = "another model is being activated: check it and try again";
                    let _ = answer.send(refused(409, busy));
                }
            }
        }
        if reply.status != 200 {
            return reply;
        }
        self.damage = None;
        self.kept.in_force = (!is_configured).then(|| ModelInForce {
            hash,
            who: who.to_owned(),
            time: utc_now(),
            file,
        });
        self.write();
        if let (Answer::Reloaded(reloaded), Some(why)) = (&mut reply.answer, &self.unwritten) {
            reloaded.note = Some(why.clone());
        }
        if let Some(id) = candidate {
            // The engineer may have discarded the candidate meanwhile.
            let _ = self.shared.discard(&id);
        }
        reply
    }

    /// Differences from the active model. Empty if the file is not a valid machine, because the service reports that
    /// error.
    fn compare(&self, new: Option<&Machine>) -> Differences {
        let running = self.shared.published.model();
        let running = Machine::parse(&running.text, "the active model");
        match (new, running) {
            (Some(new), Ok(running)) => differences(new, &running, ACTIVE),
            _ => Differences::default(),
        }
    }

    /// Stores the machine file and builds the request to the service. Also returns the id of the candidate if the file
    /// comes from one.
    fn prepare(
        &self,
        what: Activate,
        confirm: Option<String>,
    ) -> Result<(ModelActivation, Option<String>), Reply> {
        let store = &self.shared.store;
        let (machine, hash, from, file, new, candidate) = match what {
            Activate::Candidate { id, hash, text, file } => {
                store
                    .keep(&hash, &text)
                    .map_err(|e| refused(507, format!("the model cannot be kept on disk: {e}")))?;
                let new = Machine::parse(&text, &file).ok();
                let machine = store.machine(&hash);
                (machine, hash, ModelSource::Upload, file, new, Some(id))
            }
            Activate::Kept(hash) => {
                let mut history = self.kept.history.iter().rev();
                let was = |entry: &&ModelEntry| {
                    entry.hash == hash && entry.outcome == ModelOutcome::InForce
                };
                let Some(entry) = history.find(was) else {
                    let why = format!("{hash} is not one of the earlier models");
                    return Err(refused(404, why));
                };
                let text = store.text(&hash).map_err(|what| refused(422, what))?;
                let new = Machine::parse(&text, &hash).ok();
                let machine = store.machine(&hash);
                (machine, hash, entry.from, entry.file.clone(), new, None)
            }
            Activate::Configured => {
                let machine = self.configured.clone();
                let read = Machine::read(&machine).map_err(|e| refused(422, e.to_string()))?;
                let file = machine.display().to_string();
                let hash = read.checksum();
                (machine, hash, ModelSource::File, file, Some(read), None)
            }
        };
        let activation = ModelActivation {
            machine,
            hash,
            from,
            file,
            confirm,
            differences: self.compare(new.as_ref()),
        };
        Ok((activation, candidate))
    }
}

/// `who` of the history entries recorded at start-up.
const GATEWAY: &str = "gateway";

/// State shared by the threads. A thread that holds one of its locks never waits for a disk.
pub(super) struct Shared {
    pub(super) store: Store,
    /// True for the built-in simulation, whose machine file cannot be replaced.
    pub(super) is_built_in: bool,
    pub(super) cycle_cpu: Option<usize>,
    pub(super) published: Published,
    pub(super) requests: RequestSender,
    pub(super) switch: DisarmSwitch,
    pub(super) shown: Mutex<ShownModels>,
    pub(super) candidate: Mutex<Option<HeldCandidate>>,
    pub(super) uploading: AtomicUsize,
    /// True while a comparison is running, even if its candidate was discarded.
    pub(super) is_comparing: AtomicBool,
}

#[derive(Default)]
pub(super) struct ShownModels {
    pub(super) kept: ModelsKept,
    pub(super) stored: Vec<String>,
    pub(super) from: ModelSource,
    pub(super) configured: ConfiguredModel,
    pub(super) trouble: Option<String>,
}

pub(super) enum Activate {
    Candidate { id: String, hash: String, text: String, file: String },
    Kept(String),
    Configured,
}

pub(super) enum Job {
    Record(Box<ModelEntry>, Option<String>),
    Configured(PathBuf),
    Activate {
        who: String,
        what: Activate,
        confirm: Option<String>,
        answer: oneshot::Sender<Reply>,
        deadline: RequestDeadline,
    },
}

pub(super) struct HeldCandidate {
    pub(super) document: Candidate,
    /// The text to store; `None` until the file has been parsed.
    pub(super) text: Option<String>,
}

/// Timeout until a request is passed to the service. A request that a hanging disk delays must not take effect
/// unexpectedly after its client has received the timeout.
const ACTIVATION_TIMEOUT: Duration = Duration::from_secs(5);

/// The deadline of one request. Invariant: the request is either passed to the service or withdrawn, never both.
#[derive(Clone, Debug)]
pub(super) struct RequestDeadline {
    until: Instant,
    is_decided: Arc<AtomicBool>,
}

impl RequestDeadline {
    pub(super) fn start() -> Self {
        Self { until: Instant::now() + ACTIVATION_TIMEOUT, is_decided: Arc::default() }
    }

    pub(super) fn left(&self) -> Duration {
        self.until.saturating_duration_since(Instant::now())
    }

    /// Claims the request for the service; `false` if the request was withdrawn or has timed out.
    fn claim(&self) -> bool {
        !self.left().is_zero() && !self.is_decided.swap(true, Ordering::AcqRel)
    }

    /// Withdraws the request; `false` if the service already has it.
    pub(super) fn withdraw(&self) -> bool {
        !self.is_decided.swap(true, Ordering::AcqRel)
    }
}

pub(super) const BUILT_IN: &str = "the machine file of the built-in simulation cannot be replaced; start the gateway with a configuration, which may name a simulated control";

pub(super) const GIVEN_UP: &str = "the disk with the models has not answered in time: the model was not activated, and will not be later. Try again once it answers";

pub(super) fn candidate_gone() -> Reply {
    refused(409, "this machine file is not here any more: it was discarded or activated")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_claimed_or_withdrawn() {
        let deadline = RequestDeadline::start();
        let of_desk = deadline.clone();
        assert!(of_desk.claim());
        assert!(!deadline.withdraw(), "its answer comes from the service");
        let deadline = RequestDeadline::start();
        let of_desk = deadline.clone();
        assert!(deadline.withdraw());
        assert!(!of_desk.claim());
        // The request was not withdrawn, but its deadline has passed.
        let late = RequestDeadline { until: Instant::now(), is_decided: Arc::default() };
        assert!(!late.claim());
    }
}
