//! New models: files that are uploaded, what is made of them, and the way into force, which is that of a reload.
//!
//! Nothing here touches the cycle. Requests come from the dashboard; files are written and calibrations made on quiet threads;
//! one thread, the desk, keeps the models on disk and asks the service to take one. State: the folder of `store`, and the
//! candidate that somebody is making, which does not outlive the program.

use std::{
    path::PathBuf,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc::{Sender, channel},
    },
};

use tokio::sync::oneshot;
use volcomp_runtime::DisarmSwitch;

use crate::{
    audit::utc_now,
    config::Config,
    documents::{
        Answer, Candidate, CandidateBrief, CandidateStep, DraftAnswer, ModelSource, ModelState,
        Refusal, UploadedFile,
    },
    error::GatewayError,
    published::Published,
    request::{Asks, Reply},
};

mod candidate;
mod desk;
mod diagonals;
mod measured;
mod quiet;
pub(crate) mod store;
mod uploads;

use candidate::Held;
pub(crate) use desk::{Activate, Note};
use desk::{Desk, Job, Told};
use measured::Folder;
use store::Store;
pub(crate) use uploads::{Incoming, UploadError};
use uploads::{MOST_FILES, TIMES, check_room, sanitised};

/// The largest number of files that are uploaded at one time.
const AT_ONE_TIME: usize = 4;

/// What a file is that somebody uploads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UploadKind {
    /// A machine file.
    Machine,
    /// A measurement file.
    Measurement,
}

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
    pub(crate) fn tell(&self, note: Note) {
        if let Some(jobs) = &self.0 {
            // The desk has ended only where the gateway ends.
            let _ = jobs.send(Job::Noted(Box::new(note)));
        }
    }

    /// Tells that the configuration names another machine file.
    pub(crate) fn configured(&self, machine: PathBuf) {
        if let Some(jobs) = &self.0 {
            let _ = jobs.send(Job::Configured(machine));
        }
    }
}

/// What the threads share.
pub(crate) struct Shared {
    store: Store,
    /// The built-in simulation has its own machine file.
    is_built_in: bool,
    cycle_cpu: Option<usize>,
    largest_file: u64,
    published: Published,
    asks: Asks,
    switch: DisarmSwitch,
    told: Mutex<Told>,
    candidate: Mutex<Option<Held>>,
    uploading: AtomicUsize,
}

/// A file that may be written now. Its place is given back once neither the request nor the thread that writes has it any more.
pub(crate) struct Place {
    name: String,
    most: u64,
    length: u64,
    candidate: String,
    kind: UploadKind,
    folder: Folder,
    /// The machine file in force when the candidate was begun, where no file is there yet: the folder may have to be made.
    begins: Option<Arc<str>>,
    is_folder_made: AtomicBool,
    shared: Arc<Shared>,
}

impl Place {
    /// Begins the file, and the folder with the first one. It waits for the disk: for the thread that writes alone.
    pub(crate) fn open(&self) -> Result<Incoming, UploadError> {
        if let Some(machine) = &self.begins {
            let store = &self.shared.store;
            store.make()?;
            check_room(&store.uploads(), self.length)?;
            self.folder.make(machine)?;
            self.is_folder_made.store(true, Ordering::Release);
        }
        Incoming::begin(&self.folder.files(), &self.name, self.most)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.shared.uploading.fetch_sub(1, Ordering::AcqRel);
        let is_without_folder = self.begins.is_some() && !*self.is_folder_made.get_mut();
        let is_given_up = self.shared.held(&self.candidate).is_none_or(|mut held| {
            held.incoming.retain(|name| *name != self.name);
            is_without_folder && held.incoming.is_empty() && held.document.files.is_empty()
        });
        if is_given_up {
            // It may have been discarded before its folder was made.
            let _ = self.shared.discard(&self.candidate);
            self.shared.remove(self.folder.clone());
        }
    }
}

/// Why a request cannot be carried out, and the status of HTTP.
pub(crate) fn refused(status: u16, why: impl Into<String>) -> Reply {
    Reply {
        status,
        answer: Answer::Refusal(Refusal::new(why)),
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
            store: Store::new(&config.audit_dir),
            is_built_in,
            cycle_cpu: config.realtime.cpu,
            largest_file: config.dashboard.upload_bytes(),
            published: published.clone(),
            asks: asks.clone(),
            switch: switch.clone(),
            told: Mutex::default(),
            candidate: Mutex::default(),
            uploading: AtomicUsize::new(0),
        });
        // What was being made when the program ended is made anew; nobody can have begun another one yet.
        let _ = std::fs::remove_dir_all(shared.store.uploads());
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
        let candidate = lock(&shared.candidate);
        let told = lock(&shared.told);
        let mut configured = told.configured.clone();
        configured.differs = configured.hash.as_ref() != Some(&model.hash);
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
            largest_file_bytes: shared.largest_file,
            largest_upload_bytes: shared.largest_file.saturating_mul(TIMES),
            most_files: MOST_FILES,
            trouble: told.trouble.clone(),
        }
    }

    /// The candidate, where there is one.
    pub(crate) fn candidate(&self) -> Option<Candidate> {
        let candidate = lock(&self.shared.candidate);
        candidate.as_ref().map(|held| held.document.clone())
    }

    /// A place for a file of `who`. Without an `id` it begins a candidate. It waits for no disk: the thread that writes makes the
    /// folder.
    pub(crate) fn begin_file(
        &self,
        who: &str,
        kind: UploadKind,
        name: &str,
        id: Option<&str>,
        length: Option<u64>,
    ) -> Result<Place, Reply> {
        let shared = &self.shared;
        let wrong = |error: UploadError| refused(error.status(), error.to_string());
        if shared.is_built_in {
            return Err(refused(422, BUILT_IN));
        }
        let name = sanitised(name).map_err(wrong)?;
        let is_toml = name.to_ascii_lowercase().ends_with(".toml");
        if is_toml && kind == UploadKind::Measurement {
            return Err(wrong(UploadError::Toml { name }));
        }
        let most = shared.largest_file;
        if length.is_some_and(|length| length > most) {
            return Err(wrong(UploadError::Large {
                mib: most / 1024 / 1024,
            }));
        }
        let is_place = || shared.uploading.load(Ordering::Acquire) < AT_ONE_TIME;
        let crowded = || refused(503, "other files are being uploaded: try again");
        let mut candidate = lock(&shared.candidate);
        let held = match (candidate.as_mut(), id) {
            (Some(held), None) => return Err(held.is_there()),
            (Some(held), Some(id)) => held.if_it_is(id)?,
            (None, Some(_)) => return Err(gone()),
            (None, None) if !is_place() => return Err(crowded()),
            (None, None) => candidate.insert(self.begin(who)),
        };
        let files = &held.document.files;
        let is_same = |known: &String| known.eq_ignore_ascii_case(&name);
        let twice =
            files.iter().any(|file| is_same(&file.name)) || held.incoming.iter().any(is_same);
        let total: u64 = files.iter().map(|file| file.bytes).sum();
        let quota = most.saturating_mul(TIMES);
        let refusal = if held.document.brief.step == CandidateStep::Working {
            Some(working())
        } else if held
            .kind
            .is_some_and(|known| known != kind || kind == UploadKind::Machine)
        {
            Some(refused(
                409,
                "a model is made of one machine file or of measurement files: discard the one that is being made first",
            ))
        } else if twice {
            Some(wrong(UploadError::Twice { name: name.clone() }))
        } else if files.len() + held.incoming.len() >= MOST_FILES {
            Some(wrong(UploadError::Files))
        } else if total.saturating_add(length.unwrap_or(0)) > quota {
            Some(wrong(UploadError::Quota {
                mib: quota / 1024 / 1024,
            }))
        } else if !is_place() {
            Some(crowded())
        } else {
            None
        };
        if let Some(refusal) = refusal {
            return Err(refusal);
        }
        let is_first = files.is_empty();
        held.kind = Some(kind);
        held.incoming.push(name.clone());
        shared.uploading.fetch_add(1, Ordering::AcqRel);
        Ok(Place {
            most: most.min(quota - total),
            length: length.unwrap_or(0),
            candidate: held.document.brief.id.clone(),
            begins: is_first.then(|| Arc::clone(&held.machine)),
            is_folder_made: AtomicBool::new(false),
            folder: held.folder.clone(),
            name,
            kind,
            shared: Arc::clone(shared),
        })
    }

    /// A candidate of `who`, whose folder is not made yet.
    fn begin(&self, who: &str) -> Held {
        let model = self.shared.published.model();
        let id = crate::hex(&rand::random::<u64>().to_be_bytes());
        let folder = Folder(self.shared.store.uploads().join(&id));
        let brief = CandidateBrief {
            id,
            who: who.to_owned(),
            since: utc_now(),
            step: CandidateStep::Uploading,
        };
        Held::begun(brief, folder, model.hash.clone(), &model.text)
    }

    /// Begins to write a file, on a thread of its own.
    pub(crate) fn write(&self, work: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
        quiet::spawn("volcomp-uploads", self.shared.cycle_cpu, work)
    }

    /// A file is on disk.
    pub(crate) fn file_done(&self, place: &Place, bytes: u64) -> Result<Candidate, Reply> {
        {
            let mut held = self.shared.held(&place.candidate).ok_or_else(gone)?;
            held.incoming.retain(|name| *name != place.name);
            held.document.files.push(UploadedFile {
                name: place.name.clone(),
                bytes,
            });
            // What was made of the files before is not what these files say.
            held.restart();
        }
        if place.kind == UploadKind::Machine {
            return self.shared.look_at_machine(&place.candidate, &place.name);
        }
        self.candidate().ok_or_else(gone)
    }

    /// The answer where a file did not get onto the disk. Whoever discards a candidate has its folder removed under the file.
    pub(crate) fn file_failed(&self, place: &Place, error: &UploadError) -> Reply {
        if self.shared.held(&place.candidate).is_none() {
            return gone();
        }
        refused(error.status(), error.to_string())
    }

    /// All files are there: they are looked through.
    pub(crate) fn draft(&self, id: &str) -> Result<Candidate, Reply> {
        self.shared.look_through(id)
    }

    /// Takes the answers to the questions, and makes the calibration where none is open.
    pub(crate) fn answer(&self, id: &str, answers: Vec<DraftAnswer>) -> Result<Candidate, Reply> {
        self.shared.calibrate(id, answers)
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
    ) -> Result<oneshot::Receiver<Reply>, Reply> {
        let what = {
            let held = self.shared.held(id).ok_or_else(gone)?;
            held.ready(hash, &self.shared.published.model().hash)?
        };
        Ok(self.ask(who, what, confirm))
    }

    /// Asks the desk to put a model that is kept in force, or the configured machine file.
    pub(crate) fn back(
        &self,
        who: &str,
        hash: Option<String>,
        confirm: Option<String>,
    ) -> Result<oneshot::Receiver<Reply>, Reply> {
        if self.shared.is_built_in {
            return Err(refused(422, BUILT_IN));
        }
        let what = hash.map_or(Activate::Configured, Activate::Kept);
        Ok(self.ask(who, what, confirm))
    }

    fn ask(&self, who: &str, what: Activate, confirm: Option<String>) -> oneshot::Receiver<Reply> {
        let (answer, answered) = oneshot::channel();
        // Where the desk has ended the receiver tells so.
        let _ = self.jobs.send(Job::Activate {
            who: who.to_owned(),
            what,
            confirm,
            answer,
        });
        answered
    }
}

const BUILT_IN: &str =
    "the built-in simulation has its own machine file: start the gateway with a configuration";

/// The answer where a request names a candidate that is not there any more.
fn gone() -> Reply {
    refused(
        409,
        "the model that this is about is not being made any more: it was discarded, or put in force",
    )
}

fn working() -> Reply {
    refused(
        409,
        "the files are being looked at: wait until that is done",
    )
}

/// Nothing that holds one of these locks waits for a disk, or can panic in the middle of a change.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
