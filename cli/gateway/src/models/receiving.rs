//! Files of a candidate that are being received: which may begin, and what becomes of one that is whole, fails or is given up.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use super::{
    BUILT_IN, Models, Shared, UploadKind,
    candidate::{Coming, Held},
    gone, lock,
    measured::Folder,
    quiet, refused,
    uploads::{Incoming, LARGEST_FILE, MOST_FILES, TIMES, UploadError, check_room, sanitised},
    working,
};
use crate::{
    audit::utc_now,
    documents::{Candidate, CandidateBrief, CandidateStep, UploadedFile},
    request::Reply,
};

/// The largest number of files that are uploaded at one time.
const AT_ONE_TIME: usize = 4;

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
            held.incoming.retain(|file| file.name != self.name);
            is_without_folder && held.incoming.is_empty() && held.document.files.is_empty()
        });
        if is_given_up {
            // It may have been discarded before its folder was made.
            let _ = self.shared.discard(&self.candidate);
            self.shared.remove(self.folder.clone());
        }
    }
}

impl Models {
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
        let most = LARGEST_FILE;
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
        let twice = files.iter().any(|file| is_same(&file.name))
            || held.incoming.iter().any(|file| is_same(&file.name));
        let quota = most.saturating_mul(TIMES);
        let left = quota.saturating_sub(held.bytes());
        // One that does not say how large it is may become as large as one may be.
        let reserved = length.unwrap_or(most.min(left));
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
        } else if reserved > left || (length.is_none() && left == 0) {
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
        held.incoming.push(Coming {
            name: name.clone(),
            bytes: reserved,
        });
        shared.uploading.fetch_add(1, Ordering::AcqRel);
        Ok(Place {
            most: reserved,
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
            held.incoming.retain(|file| file.name != place.name);
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
}
