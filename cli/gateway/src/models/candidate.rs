//! The model that somebody is making: how it goes from files to a machine file. One at a time; requests name it, so that nobody
//! goes on with the one of somebody else unseen.

use std::{
    fs,
    ops::{Deref, DerefMut},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, MutexGuard},
};

use volcomp_calibrate::Draft;
use volcomp_model::Machine;

use super::{
    Activate, Shared, UploadKind, gone, lock,
    measured::{Folder, NotMeasured, machine_file, result},
    quiet, refused, working,
};
use crate::{
    documents::{
        Candidate, CandidateBrief, CandidateDraft, CandidateResult, CandidateStep, DraftAnswer,
    },
    request::Reply,
};

/// A file on its way.
pub(crate) struct Coming {
    pub(crate) name: String,
    /// So many bytes of what may be uploaded are its own.
    pub(crate) bytes: u64,
}

/// The candidate, and what only this side knows of it.
pub(crate) struct Held {
    pub(crate) document: Candidate,
    pub(crate) folder: Folder,
    /// The machine file in force when it was begun.
    pub(crate) machine: Arc<str>,
    /// What its files are; `None`: there is none yet.
    pub(crate) kind: Option<UploadKind>,
    /// The files that are on their way.
    pub(crate) incoming: Vec<Coming>,
    /// Which state of the files and answers this is: what was made of an earlier one is not what this one says.
    pub(crate) turn: u64,
    pub(crate) drafted: Option<Arc<Draft>>,
    /// The machine file that came of it.
    pub(crate) text: Option<String>,
}

impl Held {
    /// One without files. `based_on` and `machine`: the hash and the text of the model in force.
    pub(crate) fn begun(
        brief: CandidateBrief,
        folder: Folder,
        based_on: String,
        machine: &str,
    ) -> Self {
        Self {
            document: Candidate {
                brief,
                based_on,
                files: Vec::new(),
                error: None,
                draft: None,
                result: None,
            },
            folder,
            machine: machine.into(),
            kind: None,
            incoming: Vec::new(),
            turn: 0,
            drafted: None,
            text: None,
        }
    }

    /// This one, if it is the one that is meant.
    pub(crate) fn if_it_is(&mut self, id: &str) -> Result<&mut Self, Reply> {
        if self.document.brief.id == id {
            Ok(self)
        } else {
            Err(gone())
        }
    }

    /// The answer to whoever wants to begin another one.
    pub(crate) fn is_there(&self) -> Reply {
        let brief = &self.document.brief;
        refused(
            409,
            format!(
                "{} has been making a model since {}: go on with that one, or discard it first",
                brief.who, brief.since
            ),
        )
    }

    /// Forgets what was made of the files so far.
    pub(crate) fn restart(&mut self) {
        self.turn += 1;
        self.document.brief.step = CandidateStep::Uploading;
        self.document.error = None;
        self.document.draft = None;
        self.document.result = None;
        self.drafted = None;
        self.text = None;
    }

    /// The bytes of all files, those that are on their way included.
    pub(crate) fn bytes(&self) -> u64 {
        let whole = self.document.files.iter().map(|file| file.bytes);
        let coming = self.incoming.iter().map(|file| file.bytes);
        whole.chain(coming).fold(0, u64::saturating_add)
    }

    /// Nobody goes on while a file is on its way, which would be left out.
    fn is_whole(&self) -> Result<(), Reply> {
        match self.incoming.first() {
            Some(file) => Err(refused(
                409,
                format!("{} is on its way: wait until it is there", file.name),
            )),
            None => Ok(()),
        }
    }

    /// What can be put in force. `seen` is the hash of the result that a person has looked at, `running` that of the model in
    /// force.
    pub(crate) fn ready(&self, seen: &str, running: &str) -> Result<Activate, Reply> {
        self.is_whole()?;
        let (Some(text), Some(result)) = (&self.text, &self.document.result) else {
            return Err(refused(
                409,
                "there is no model yet: answer the questions first",
            ));
        };
        if result.hash != seen {
            return Err(refused(
                409,
                format!(
                    "another model has been made meanwhile, {}: look at that one first",
                    result.hash
                ),
            ));
        }
        if self.kind == Some(UploadKind::Measurement) && self.document.based_on != running {
            return Err(refused(
                409,
                "the model in force has become another one since this was begun, and what was not measured was taken from the one before: discard this one and begin again",
            ));
        }
        // Files that were not used are no part of it.
        let what = match (&self.document.files[..], &result.used[..]) {
            ([one], []) => one.name.clone(),
            (_, [one]) => format!("measurement {one}"),
            (_, several) => format!("{} measurement files", several.len()),
        };
        Ok(Activate::Candidate {
            id: self.document.brief.id.clone(),
            hash: result.hash.clone(),
            text: text.clone(),
            file: what,
        })
    }
}

/// The candidate under its lock.
pub(crate) struct HeldGuard<'a>(MutexGuard<'a, Option<Held>>);

impl Deref for HeldGuard<'_> {
    type Target = Held;
    fn deref(&self) -> &Held {
        // It is made only around one.
        self.0.as_ref().unwrap_or_else(|| unreachable!())
    }
}

impl DerefMut for HeldGuard<'_> {
    fn deref_mut(&mut self) -> &mut Held {
        self.0.as_mut().unwrap_or_else(|| unreachable!())
    }
}

impl Shared {
    /// The candidate of this name.
    pub(crate) fn held(&self, id: &str) -> Option<HeldGuard<'_>> {
        let candidate = lock(&self.candidate);
        let is_it = |held: &Held| held.document.brief.id == id;
        candidate
            .as_ref()
            .is_some_and(is_it)
            .then(|| HeldGuard(candidate))
    }

    /// Gives the candidate up, with its files.
    pub(crate) fn discard(self: &Arc<Self>, id: &str) -> Result<(), Reply> {
        let folder = {
            let mut candidate = lock(&self.candidate);
            match candidate.take_if(|held| held.document.brief.id == id) {
                Some(held) => held.folder,
                None => return Err(gone()),
            }
        };
        self.remove(folder);
        Ok(())
    }

    /// Removes the folder of a candidate that is given up.
    pub(crate) fn remove(&self, folder: Folder) {
        // What stays is removed at the next start.
        let _ = quiet::spawn("volcomp-uploads", self.cycle_cpu, move || {
            let _ = fs::remove_dir_all(folder.0);
        });
    }

    /// Looks at a machine file that was uploaded.
    pub(crate) fn look_at_machine(
        self: &Arc<Self>,
        id: &str,
        name: &str,
    ) -> Result<Candidate, Reply> {
        let (folder, turn) = self.begin_work(id)?;
        let name = name.to_owned();
        self.work(id, turn, move || {
            let before = Machine::read(folder.0.join("machine.toml"));
            let before = before.map_err(|e| NotMeasured::of(e.to_string()))?;
            let bytes = fs::read(folder.files().join(&name));
            let bytes = bytes.map_err(|e| NotMeasured::of(format!("{name}: {e}")))?;
            let machine = machine_file(bytes, &name)?;
            let mut found =
                result(&machine, Some(&before)).map_err(|e| NotMeasured::of(e.to_string()))?;
            found.warnings.extend(machine.notes());
            Ok(Done {
                result: Some((machine.to_toml(), found)),
                ..Done::default()
            })
        })
    }

    /// Looks through the measurement files.
    pub(crate) fn look_through(self: &Arc<Self>, id: &str) -> Result<Candidate, Reply> {
        {
            let held = self.held(id).ok_or_else(gone)?;
            if held.kind != Some(UploadKind::Measurement) {
                return Err(refused(409, "upload the measurement files first"));
            }
        }
        let (folder, turn) = self.begin_work(id)?;
        self.work(id, turn, move || {
            let drafted = folder.draft()?;
            let document = folder.document(&drafted, Vec::new())?;
            if document.questions.is_empty() {
                let made = folder.calibrated(&drafted, &[]);
                let (result, error) = match made {
                    Ok(result) => (Some(result), None),
                    Err(NotMeasured(error)) => (None, Some(error)),
                };
                return Ok(Done {
                    drafted: Some((drafted, document)),
                    result,
                    error,
                    ..Done::default()
                });
            }
            Ok(Done {
                drafted: Some((drafted, document)),
                ..Done::default()
            })
        })
    }

    /// Takes one of several files off; what was made of all of them is forgotten.
    pub(crate) fn take_off(self: &Arc<Self>, id: &str, name: &str) -> Result<Candidate, Reply> {
        let (folder, turn) = {
            let mut held = self.held(id).ok_or_else(gone)?;
            let files = &held.document.files;
            if files.iter().all(|file| file.name != name) {
                return Err(refused(404, format!("{name} is none of the files")));
            }
            if files.len() == 1 {
                let only = format!("{name} is the only file: discard what is being made");
                return Err(refused(409, only));
            }
            let begun = held.begin_work()?;
            held.document.draft = None;
            held.drafted = None;
            begun
        };
        let name = name.to_owned();
        self.work(id, turn, move || {
            let removed = fs::remove_file(folder.files().join(&name));
            removed.map_err(|e| NotMeasured::of(format!("{name} cannot be removed: {e}")))?;
            Ok(Done {
                taken_off: Some(name),
                ..Done::default()
            })
        })
    }

    /// Takes answers; with none open the calibration is made.
    pub(crate) fn calibrate(
        self: &Arc<Self>,
        id: &str,
        answers: Vec<DraftAnswer>,
    ) -> Result<Candidate, Reply> {
        let (drafted, folder, turn) = {
            let mut held = self.held(id).ok_or_else(gone)?;
            let drafted = held.drafted.clone();
            let drafted = drafted
                .ok_or_else(|| refused(409, "the files have not been looked through yet"))?;
            let (folder, turn) = held.begin_work()?;
            // What was typed is kept, also where it is refused.
            if let Some(draft) = &mut held.document.draft {
                draft.answers.clone_from(&answers);
            }
            (drafted, folder, turn)
        };
        self.work(id, turn, move || {
            let document = folder.document(&drafted, answers.clone())?;
            let (result, error) = match folder.calibrated(&drafted, &answers) {
                Ok(result) => (Some(result), None),
                Err(NotMeasured(error)) => (None, Some(error)),
            };
            Ok(Done {
                drafted: Some((Draft::clone(&drafted), document)),
                result,
                error,
                ..Done::default()
            })
        })
    }

    fn begin_work(&self, id: &str) -> Result<(Folder, u64), Reply> {
        self.held(id).ok_or_else(gone)?.begin_work()
    }

    /// Works at the candidate on a quiet thread, and puts down what came of it, unless the candidate is gone or another one by then.
    fn work(
        self: &Arc<Self>,
        id: &str,
        turn: u64,
        work: impl FnOnce() -> Result<Done, NotMeasured> + Send + 'static,
    ) -> Result<Candidate, Reply> {
        let now = self.held(id).map(|held| held.document.clone());
        let now = now.ok_or_else(gone)?;
        let (shared, of) = (Arc::clone(self), id.to_owned());
        let begun = quiet::spawn("volcomp-models", self.cycle_cpu, move || {
            // A fault of the program in a calculation is no reason that nobody can discard it any more.
            let done = catch_unwind(AssertUnwindSafe(work));
            let done = done.unwrap_or_else(|_| {
                let what = "a fault of the program, written on standard error";
                Err(NotMeasured::of(what.to_owned()))
            });
            if let Some(mut held) = shared.held(&of) {
                held.take(turn, done);
            }
        });
        if let Err(e) = begun {
            if let Some(mut held) = self.held(id) {
                held.take(turn, Err(NotMeasured::of(e.to_string())));
            }
            return Err(refused(503, format!("no thread for it: {e}")));
        }
        Ok(now)
    }
}

/// What came of work at a candidate.
#[derive(Default)]
struct Done {
    drafted: Option<(Draft, CandidateDraft)>,
    result: Option<(String, CandidateResult)>,
    /// What kept it from a result.
    error: Option<String>,
    /// The file that is not there any more.
    taken_off: Option<String>,
}

impl Held {
    /// From here on the candidate is being worked at: where, and which turn this is.
    fn begin_work(&mut self) -> Result<(Folder, u64), Reply> {
        if self.document.brief.step == CandidateStep::Working {
            return Err(working());
        }
        self.is_whole()?;
        self.turn += 1;
        self.document.brief.step = CandidateStep::Working;
        self.document.error = None;
        self.document.result = None;
        self.text = None;
        Ok((self.folder.clone(), self.turn))
    }

    /// Takes what came of a turn; that of an earlier one is dropped.
    fn take(&mut self, turn: u64, done: Result<Done, NotMeasured>) {
        if turn != self.turn {
            return;
        }
        let done = match done {
            Ok(done) => done,
            Err(NotMeasured(error)) => Done {
                error: Some(error),
                ..Done::default()
            },
        };
        if let Some((drafted, document)) = done.drafted {
            self.drafted = Some(Arc::new(drafted));
            self.document.draft = Some(document);
        }
        if let Some(name) = done.taken_off {
            self.document.files.retain(|file| file.name != name);
        }
        self.document.error = done.error;
        (self.text, self.document.result) = done.result.unzip();
        self.document.brief.step = if self.document.result.is_some() {
            CandidateStep::Ready
        } else if self.document.draft.is_some() {
            CandidateStep::Asking
        } else {
            CandidateStep::Uploading
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn begun() -> Held {
        let brief = CandidateBrief {
            id: "1".to_owned(),
            who: "erna".to_owned(),
            since: String::new(),
            step: CandidateStep::Uploading,
        };
        Held::begun(brief, Folder("uploads/1".into()), String::new(), "")
    }

    /// A file comes, or the files are looked at anew, while a calculation is under way: its end changes nothing any more.
    #[test]
    fn an_older_calculation_is_dropped() {
        let mut held = begun();
        let error = |text: &str| Err(NotMeasured::of(text.to_owned()));
        let (_, first) = held.begin_work().expect("nothing is under way");
        held.restart();
        held.take(first, error("first"));
        assert_eq!(held.document.error, None);
        let (_, second) = held.begin_work().expect("nothing is under way");
        held.take(first, error("first"));
        assert_eq!(held.document.brief.step, CandidateStep::Working);
        held.take(second, error("second"));
        assert_eq!(held.document.error.as_deref(), Some("second"));
        assert_eq!(held.document.brief.step, CandidateStep::Uploading);
    }

    #[test]
    fn nobody_goes_on_while_a_file_is_on_its_way() {
        let mut held = begun();
        held.incoming.push(Coming {
            name: "exx.csv".to_owned(),
            bytes: 4,
        });
        assert_eq!(held.begin_work().expect_err("it comes").status, 409);
        held.incoming.clear();
        assert!(held.begin_work().is_ok());
    }
}
