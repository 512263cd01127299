//! The uploaded machine file. It is received in memory, then parsed and compared with the active model on a
//! low-priority thread. There is one candidate at a time; requests refer to it by id, so that an engineer does not
//! activate another engineer's file unseen.
//!
//! Invariant: the candidate is written to disk only when it is activated; it does not survive a restart.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::Ordering},
};

use volcomp_model::{Machine, ModelError};
use volcomp_web::file_name;

use super::{
    diagonals::diagonals,
    quiet,
    shared::{Activate, BUILT_IN, Held, Shared, gone},
};
use crate::{
    audit::utc_now,
    differences::{Differences, differences},
    documents::{Candidate, CandidateBrief, CandidateResult, CandidateStep, UploadedFile},
    locked,
    request::{Reply, refused},
};

/// Maximum size of a machine file, bytes. Parsing needs about fifty times as much memory, in the process that corrects.
pub(crate) const LARGEST_FILE: usize = 4 * 1024 * 1024;
/// Maximum number of concurrent uploads.
const AT_ONE_TIME: usize = 4;

/// An upload slot, released on drop.
pub(crate) struct Place(Arc<Shared>);

impl Drop for Place {
    fn drop(&mut self) {
        self.0.uploading.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Reserves an upload slot.
pub(super) fn place(shared: &Arc<Shared>) -> Result<Place, Reply> {
    if shared.is_built_in {
        return Err(refused(422, BUILT_IN));
    }
    if let Some(held) = &*locked(&shared.candidate) {
        return Err(held.is_there());
    }
    let more = |open| (open < AT_ONE_TIME).then_some(open + 1);
    let uploading = &shared.uploading;
    match uploading.fetch_update(Ordering::AcqRel, Ordering::Acquire, more) {
        Ok(_) => Ok(Place(Arc::clone(shared))),
        Err(_) => Err(refused(503, "other files are being received: try again")),
    }
}

/// Stores a machine file uploaded by `who` and starts the comparison.
pub(super) fn take(
    shared: &Arc<Shared>,
    who: &str,
    name: &str,
    bytes: Vec<u8>,
) -> Result<Candidate, Reply> {
    let Some(name) = file_name::sanitised(name) else {
        let why = "the name has no letter or digit, expected a file name";
        return Err(refused(400, why));
    };
    let id = crate::hex(&rand::random::<u64>().to_be_bytes());
    let document = Candidate {
        brief: CandidateBrief {
            id: id.clone(),
            who: who.to_owned(),
            since: utc_now(),
            step: CandidateStep::Working,
        },
        file: UploadedFile {
            name: name.clone(),
            bytes: bytes.len() as u64,
        },
        error: None,
        result: None,
    };
    {
        let mut candidate = locked(&shared.candidate);
        if let Some(held) = &*candidate {
            return Err(held.is_there());
        }
        // A comparison cannot be stopped: without this check, those of discarded candidates would run concurrently with
        // the next.
        if shared.is_comparing.swap(true, Ordering::AcqRel) {
            let why = "the machine file that was discarded is still being compared: try again";
            return Err(refused(503, why));
        }
        let document = document.clone();
        *candidate = Some(Held {
            document,
            text: None,
        });
    }
    let running = shared.published.model();
    let (of, begun) = (id.clone(), Arc::clone(shared));
    let spawned = quiet::spawn("volcomp-models", shared.cycle_cpu, move || {
        // A panic in a comparison must not leave a candidate that cannot be discarded.
        let work = || compared(bytes, &name, &running.text);
        let done = catch_unwind(AssertUnwindSafe(work));
        let fault = "a fault of the program, written on standard error";
        begun.is_comparing.store(false, Ordering::Release);
        begun.done(&of, done.unwrap_or_else(|_| Err(fault.to_owned())));
    });
    if let Err(e) = spawned {
        shared.is_comparing.store(false, Ordering::Release);
        // No other request has seen it, or it is already discarded.
        let _ = shared.discard(&id);
        return Err(refused(503, format!("no thread for it: {e}")));
    }
    Ok(document)
}

impl Shared {
    /// Stores the result of a comparison; the result of a discarded candidate is dropped.
    fn done(&self, id: &str, done: Result<(String, CandidateResult), String>) {
        let mut candidate = locked(&self.candidate);
        let Some(held) = candidate.as_mut().filter(|held| held.is(id)) else {
            return;
        };
        match done {
            Ok((text, result)) => {
                held.text = Some(text);
                held.document.result = Some(result);
                held.document.brief.step = CandidateStep::Ready;
            }
            Err(error) => {
                held.document.error = Some(error);
                held.document.brief.step = CandidateStep::Refused;
            }
        }
    }

    pub(crate) fn discard(&self, id: &str) -> Result<(), Reply> {
        let taken = locked(&self.candidate).take_if(|held| held.is(id));
        taken.map(drop).ok_or_else(gone)
    }

    /// The candidate, ready for activation. `seen` is the hash of the result shown to the engineer.
    pub(crate) fn ready(&self, id: &str, seen: &str) -> Result<Activate, Reply> {
        let candidate = locked(&self.candidate);
        let held = candidate.as_ref().filter(|held| held.is(id));
        held.ok_or_else(gone)?.ready(seen)
    }
}

impl Held {
    fn is(&self, id: &str) -> bool {
        self.document.brief.id == id
    }

    /// The refusal for a second upload.
    fn is_there(&self) -> Reply {
        let CandidateBrief { who, since, .. } = &self.document.brief;
        refused(
            409,
            format!(
                "{who} has sent a machine file at {since}: put that one in force, or discard it first"
            ),
        )
    }

    fn ready(&self, seen: &str) -> Result<Activate, Reply> {
        let (Some(text), Some(result)) = (&self.text, &self.document.result) else {
            return Err(refused(
                409,
                "there is no model yet that can be put in force",
            ));
        };
        if result.hash != seen {
            let hash = &result.hash;
            return Err(refused(
                409,
                format!("this is another model, {hash}: look at that one first"),
            ));
        }
        Ok(Activate::Candidate {
            id: self.document.brief.id.clone(),
            hash: result.hash.clone(),
            text: text.clone(),
            file: self.document.file.name.clone(),
        })
    }
}

/// Parses a machine file and compares it with the active model. Returns the text to be stored and the result for the
/// page.
fn compared(
    bytes: Vec<u8>,
    name: &str,
    running: &str,
) -> Result<(String, CandidateResult), String> {
    let text = String::from_utf8(bytes).map_err(|e| {
        let place = e.utf8_error().valid_up_to();
        format!("{name}: found a byte that is no text at place {place}, expected a machine file in UTF-8")
    })?;
    let named = |e: ModelError| match e {
        ModelError::Input(_) => e.to_string(),
        other => format!("{name}: {other}"),
    };
    let machine = Machine::parse(&text, name).map_err(named)?;
    let running = Machine::parse(running, "the model in force").map_err(|e| e.to_string())?;
    let Differences {
        refusal,
        to_confirm,
    } = differences(&machine, &running);
    let mut warnings = to_confirm;
    if machine.checksum() == running.checksum() {
        warnings.push("this is the model in force: nothing would change".to_owned());
    }
    warnings.extend(machine.notes());
    let result = CandidateResult {
        refusal,
        hash: machine.checksum(),
        name: machine.name.clone(),
        structure: machine.chain().structure().to_string(),
        warnings,
        diagonals: diagonals(&running, &machine).map_err(named)?,
    };
    Ok((machine.to_toml(), result))
}
