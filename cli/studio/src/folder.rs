//! The folder chosen by the user, which holds the whole state of the studio.
//!
//! Inputs are the measurement files, `machine.toml` (the machine as built), `answers.json`, `calibration.toml`, and a
//! `setup.toml` for NC programs. The studio writes `calibration.toml` from the draft and the answers. Computed files
//! are below `result/`, which can be removed at any time.
//!
//! Invariant: a `calibration.toml` whose hash is not in `answers.json` was written or changed by the user. The studio
//! uses it unchanged and never replaces it.

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
    time::SystemTime,
};

use serde::{Deserialize, Serialize};
use volcomp_calibrate::{Draft, LeftOver, draft_of, files_below};
use volcomp_model::{Machine, sha256_of};
use volcomp_nc::SetUp;
use volcomp_vocabulary::AxisName;
use volcomp_web::file_name;

use crate::{
    error::{Interrupt, StudioError},
    questions::{AnsweredDraft, DraftState, TypedAnswer, questions, with_answers},
};

/// Maximum number of measurement files in a folder.
pub const MAX_FILES: usize = 200;
const MAX_RESULTS: usize = 10_000;
/// Maximum size of an uploaded file, bytes.
pub const MAX_FILE_BYTES: usize = 8 * 1024 * 1024;

pub(crate) const MACHINE: &str = "machine.toml";
/// Backup of the previous machine file, written when `machine.toml` is replaced.
pub(crate) const MACHINE_BACKUP: &str = ".machine.toml.bak";
pub(crate) const CALIBRATION: &str = "calibration.toml";
pub(crate) const SETUP: &str = "setup.toml";
pub(crate) const ANSWERS: &str = "answers.json";
pub(crate) const RESULT: &str = "result";
pub(crate) const FITTED: &str = "result/machine.toml";
pub(crate) const REPORT: &str = "result/report.html";
/// Folder of compensation tables for controls.
pub(crate) const TABLES: &str = "result/tables";
/// Folder of compensated NC programs.
pub(crate) const PROGRAMS: &str = "result/nc";
/// Prefix of the folders of earlier tables and programs. A number follows the prefix.
const EARLIER_PREFIX: &str = "result/before-";
pub(crate) const INPUTS: &str = "result/.inputs.sha256";

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Answers {
    /// SHA-256 of the calibration file that was written with these answers.
    calibration: String,
    answers: Vec<TypedAnswer>,
}

#[derive(Clone, Debug)]
pub struct Folder {
    path: PathBuf,
    pub(crate) interrupt: Interrupt,
}

/// State of the folder for the web page.
#[derive(Clone, Debug, Serialize)]
pub struct State {
    pub folder: String,
    /// Measurement files, used or not.
    pub files: Vec<FileState>,
    /// The machine; `None` without a valid machine file.
    pub machine: Option<MachineState>,
    /// The text of `machine.toml`; empty if the file is missing.
    pub machine_text: String,
    /// Why the machine file is invalid; `None` if the file is valid or missing.
    pub machine_error: Option<String>,
    /// True if `calibration.toml` was written by the user and is therefore used unchanged.
    pub by_hand: bool,
    /// The drafted calibration; `None` without a machine, or if the user wrote `calibration.toml`.
    pub draft: Option<DraftState>,
    /// The files below `result/`.
    pub results: Vec<String>,
    /// The earlier machine files of this folder, the latest first.
    pub models: Vec<EarlierModel>,
    /// True if an input has changed since the fit.
    pub is_stale: bool,
}

/// A machine file that a later fit replaced.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct EarlierModel {
    /// File name, relative to the folder.
    pub name: String,
    /// Time at which the file was written, seconds since 1970 (UTC).
    pub written_s: u64,
}

/// A measurement file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FileState {
    /// File name, relative to the folder.
    pub name: String,
    /// Name of the measured error; `None` if neither the file nor an answer states it.
    pub error: Option<String>,
    /// Description of the content of the file.
    pub said: Vec<String>,
    /// Why the file is not used; `None` if it is used.
    pub not_used: Option<String>,
}

/// The machine in `machine.toml`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MachineState {
    /// The name that the file states.
    pub name: String,
    pub structure: String,
    /// Each axis with its travel, mm or deg.
    pub axes: Vec<(AxisName, [f64; 2])>,
}

impl MachineState {
    fn of(machine: &Machine) -> Self {
        let axes = machine.axes().iter();
        Self {
            name: machine.name.clone(),
            structure: machine.chain().structure().to_string(),
            axes: axes.map(|axis| (axis.name, axis.travel)).collect(),
        }
    }
}

impl Folder {
    /// Opens a folder.
    ///
    /// # Errors
    /// The folder does not exist.
    pub fn open(path: &Path) -> Result<Self, StudioError> {
        let whole = path.canonicalize();
        let path = whole.map_err(StudioError::disk(path.display()))?;
        fs::read_dir(&path).map_err(StudioError::disk(path.display()))?;
        // Reading a pipe would block forever.
        let of_its_own = [MACHINE, SETUP, CALIBRATION, ANSWERS, INPUTS, FITTED];
        for name in of_its_own {
            if fs::metadata(path.join(name)).is_ok_and(|metadata| !metadata.is_file()) {
                let no_file = "found a pipe, folder or device, expected a file";
                return Err(StudioError::disk(name)(io::Error::other(no_file)));
            }
        }
        Ok(Self { path, interrupt: Interrupt::default() })
    }

    pub(crate) fn at(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    pub(crate) fn relative(&self, message: &impl ToString) -> String {
        let path = format!("{}/", self.path.display());
        message.to_string().replace(&path, "")
    }

    /// Reads the state shown in the web page from the folder.
    ///
    /// # Errors
    /// The folder cannot be read, or holds too many files. An invalid machine file is reported in the state.
    pub fn state(&self) -> Result<State, StudioError> {
        let paths = self.measurement_files()?;
        let results = self.results()?;
        let mut state = State {
            folder: self.path.display().to_string(),
            files: Vec::new(),
            machine: None,
            machine_text: String::new(),
            machine_error: None,
            by_hand: self.is_by_hand(),
            draft: None,
            models: self.models()?,
            is_stale: self.is_stale(&paths),
            results,
        };
        let machine = match self.machine() {
            Ok(machine) => machine,
            Err(error) => {
                if !matches!(error, StudioError::NoMachine) {
                    state.machine_error = Some(self.relative(&error));
                    state.machine_text = self.text_of(MACHINE);
                }
                let names = paths.iter().map(|path| self.relative(&path.display()));
                state.files = names.map(FileState::named).collect();
                return Ok(state);
            }
        };
        state.machine = Some(MachineState::of(&machine));
        state.machine_text = self.text_of(MACHINE);
        let draft = self.draft(paths, &machine);
        let given = self.answers()?;
        // Another program wrote an answer that is invalid. Show the questions without the answers.
        let answered = with_answers(&draft, &given).or_else(|_| with_answers(&draft, &[]))?;
        state.files = self.files(&draft, &answered);
        if !state.by_hand {
            let whole = &answered.whole;
            state.draft = Some(DraftState {
                questions: questions(&draft, &answered.decided, &machine),
                answers: given,
                open: whole.questions.len(),
                conflicts: whole.conflicts.clone(),
                notes: whole.notes.clone(),
                text: whole.text.clone(),
            });
        }
        Ok(state)
    }

    pub(crate) fn machine(&self) -> Result<Machine, StudioError> {
        let path = self.at(MACHINE);
        if !path.exists() {
            return Err(StudioError::NoMachine);
        }
        Ok(Machine::read(path)?)
    }

    fn text_of(&self, name: &str) -> String {
        fs::read_to_string(self.at(name)).unwrap_or_default()
    }

    pub(crate) fn is_by_hand(&self) -> bool {
        let written = sha256_of(&self.at(CALIBRATION)).ok();
        written.is_some_and(|hash| !self.kept().is_ok_and(|kept| kept.calibration == hash))
    }

    /// Files that may be measurements.
    pub(crate) fn measurement_files(&self) -> Result<Vec<PathBuf>, StudioError> {
        // The limit is one file more than the maximum, because the file of the answers is also in the folder.
        let found = files_below(&self.path, &[self.at(RESULT)], MAX_FILES + 1);
        let mut paths = found.map_err(StudioError::disk(self.path.display()))?;
        let answers = self.at(ANSWERS);
        paths.retain(|path| *path != answers);
        if paths.len() > MAX_FILES {
            return Err(StudioError::TooManyFiles {
                folder: self.path.display().to_string(),
                most: MAX_FILES,
            });
        }
        Ok(paths)
    }

    pub(crate) fn draft(&self, paths: Vec<PathBuf>, machine: &Machine) -> Draft {
        let named = |path: &Path| self.relative(&path.display());
        draft_of(paths, machine, MACHINE, named)
    }

    fn files(&self, draft: &Draft, answered: &AnsweredDraft) -> Vec<FileState> {
        let mut files = Vec::new();
        for (place, of) in draft.proposed.iter().enumerate() {
            let error = answered.decided.proposed[place].error;
            let said = of.said.iter().filter(|said| !said.is_empty());
            let said: Vec<String> = said.cloned().collect();
            files.extend(of.files.iter().map(|name| FileState {
                error: error.map(|error| error.to_string()),
                said: said.clone(),
                ..FileState::named(name.clone())
            }));
        }
        for LeftOver { file, reason, .. } in &answered.whole.left_over {
            let reason = Some(self.relative(&reason));
            match files.iter_mut().find(|known| known.name == *file) {
                Some(known) => known.not_used = reason,
                None => {
                    files.push(FileState { not_used: reason, ..FileState::named(file.clone()) });
                }
            }
        }
        files.sort_by(|one, other| one.name.cmp(&other.name));
        files
    }

    pub(crate) fn answers(&self) -> Result<Vec<TypedAnswer>, StudioError> {
        self.kept().map(|kept| kept.answers)
    }

    fn kept(&self) -> Result<Answers, StudioError> {
        let path = self.at(ANSWERS);
        if !path.exists() {
            return Ok(Answers::default());
        }
        let text = fs::read_to_string(path).map_err(StudioError::disk(ANSWERS))?;
        serde_json::from_str(&text).map_err(|e| StudioError::Upload {
            name: ANSWERS.to_owned(),
            why: format!("{e}; expected the answers as written by this page, or no such file"),
        })
    }

    /// Replaces the answers, and writes the calibration file with them.
    ///
    /// # Errors
    /// An answer is invalid for its question, or the user wrote the calibration file.
    pub fn answer(&self, given: &[TypedAnswer]) -> Result<(), StudioError> {
        let machine = self.machine()?;
        let draft = self.draft(self.measurement_files()?, &machine);
        let answered = with_answers(&draft, given)?;
        self.keep(given, &answered.whole)
    }

    pub(crate) fn keep(&self, given: &[TypedAnswer], whole: &Draft) -> Result<(), StudioError> {
        if self.is_by_hand() {
            return Err(StudioError::Upload {
                name: CALIBRATION.to_owned(),
                why: "found a file that this page did not write, or that was changed since; it is not replaced: move it away to answer questions here".to_owned(),
            });
        }
        self.interrupt.check()?;
        self.write(CALIBRATION, whole.text.as_bytes())?;
        let hash = sha256_of(&self.at(CALIBRATION)).map_err(StudioError::disk(CALIBRATION))?;
        let kept = Answers { calibration: hash, answers: given.to_vec() };
        let text = serde_json::to_string_pretty(&kept);
        let text = text.map_err(|e| StudioError::disk(ANSWERS)(e.into()))?;
        self.write(ANSWERS, text.as_bytes())
    }

    /// Stores an uploaded file. A machine file becomes `machine.toml`, a set-up file for NC programs `setup.toml`; any
    /// other file is a measurement file and keeps its name. A measurement file with different content is never
    /// replaced.
    ///
    /// # Errors
    /// The name is invalid, the file is a TOML file of another kind or too large, or the folder has too many files.
    pub fn receive(&self, name: &str, bytes: &[u8]) -> Result<(), StudioError> {
        self.interrupt.check()?;
        let name = name_of_upload(name)?;
        let wrong = |why: String| StudioError::Upload { name: name.clone(), why };
        if bytes.len() > MAX_FILE_BYTES {
            let mib = MAX_FILE_BYTES / 1024 / 1024;
            return Err(wrong(format!("larger than the maximum of {mib} MiB")));
        }
        let ending = Path::new(&name).extension().unwrap_or_default();
        if ending.eq_ignore_ascii_case("toml") {
            let text = std::str::from_utf8(bytes);
            let text = text.map_err(|e| wrong(format!("{e}; expected UTF-8 text")))?;
            if name.eq_ignore_ascii_case(SETUP) {
                SetUp::parse(text, SETUP).map_err(|e| wrong(e.to_string()))?;
                return self.write(SETUP, bytes);
            }
            return self.set_machine(&name, text);
        }
        if name.eq_ignore_ascii_case(ANSWERS) || name.eq_ignore_ascii_case(RESULT) {
            return Err(wrong("a reserved name of the studio; rename the file".to_owned()));
        }
        let path = self.at(&name);
        if path.exists() {
            let same = fs::read(&path).is_ok_and(|present| present == bytes);
            let other = "is in the folder with different content; rename one of them";
            return if same { Ok(()) } else { Err(wrong(other.to_owned())) };
        }
        if self.measurement_files()?.len() >= MAX_FILES {
            return Err(wrong(format!("the folder contains the maximum of {MAX_FILES} files")));
        }
        self.write(&name, bytes)
    }

    /// Writes a valid machine file. The previous one is kept as `.machine.toml.bak`.
    ///
    /// # Errors
    /// Key and line of the error in the text, under the name `name`.
    pub fn set_machine(&self, name: &str, text: &str) -> Result<(), StudioError> {
        Machine::parse(text, name)?;
        self.interrupt.check()?;
        let path = self.at(MACHINE);
        // Writing an unchanged file would replace the backup with a copy of the file.
        if fs::read(&path).is_ok_and(|present| present == text.as_bytes()) {
            return Ok(());
        }
        if path.exists() {
            let kept = fs::copy(&path, self.at(MACHINE_BACKUP));
            kept.map_err(StudioError::disk(MACHINE))?;
        }
        self.write(MACHINE, text.as_bytes())
    }

    pub(crate) fn write(&self, name: &str, bytes: &[u8]) -> Result<(), StudioError> {
        let path = self.at(name);
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        let part = path.with_file_name(format!(".{file}.part"));
        let folder = path.parent().unwrap_or(&self.path);
        let written = fs::create_dir_all(folder)
            .and_then(|()| fs::write(&part, bytes))
            .and_then(|()| fs::rename(&part, &path));
        written.map_err(StudioError::disk(name))
    }

    /// The folder to which the next fit moves the previous result.
    pub(crate) fn next_aside(&self) -> PathBuf {
        let mut folders = (1_u64..).map(|number| self.at(&format!("{EARLIER_PREFIX}{number}")));
        folders.find(|path| !path.exists()).unwrap_or_default()
    }

    /// Moves the tables and programs of the previous result to a separate folder, because they would be mistaken for
    /// tables of the new machine file. Also moves the previous machine file and report if `fitted`, the content of the
    /// new machine file, differs.
    pub(crate) fn set_outputs_aside(&self, fitted: &str) -> Result<(), StudioError> {
        let before = fs::read_to_string(self.at(FITTED));
        let is_other = before.is_ok_and(|before| before != fitted);
        let mut outputs = vec![TABLES, PROGRAMS];
        outputs.extend(is_other.then_some([FITTED, REPORT]).into_iter().flatten());
        let mut outputs: Vec<PathBuf> = outputs.into_iter().map(|name| self.at(name)).collect();
        outputs.retain(|path| path.exists());
        if outputs.is_empty() {
            return Ok(());
        }
        let aside = self.next_aside();
        let moved = || {
            fs::create_dir(&aside)?;
            for path in outputs {
                fs::rename(&path, aside.join(path.file_name().unwrap_or_default()))?;
            }
            Ok(())
        };
        moved().map_err(StudioError::disk(aside.display()))
    }

    /// The machine files that [`Self::set_outputs_aside`] moved.
    pub(crate) fn models(&self) -> Result<Vec<EarlierModel>, StudioError> {
        let mut models = Vec::new();
        for number in 1_u64.. {
            let folder = format!("{EARLIER_PREFIX}{number}");
            if !self.at(&folder).exists() {
                break;
            }
            let name = format!("{folder}/{MACHINE}");
            let Ok(file) = fs::metadata(self.at(&name)) else {
                continue;
            };
            let written = file.modified().map_err(StudioError::disk(&name))?;
            let since = written.duration_since(SystemTime::UNIX_EPOCH);
            models.push(EarlierModel { name, written_s: since.unwrap_or_default().as_secs() });
        }
        models.reverse();
        Ok(models)
    }

    /// Files below `result/`, by their names relative to the folder.
    pub(crate) fn results(&self) -> Result<Vec<String>, StudioError> {
        let result = self.at(RESULT);
        if !result.is_dir() {
            return Ok(Vec::new());
        }
        let inside = fs::read_dir(&result).map_err(StudioError::disk(RESULT))?;
        let inside = inside.flatten().map(|entry| entry.path());
        let before = self.at(EARLIER_PREFIX).display().to_string();
        let earlier: Vec<PathBuf> =
            inside.filter(|path| path.display().to_string().starts_with(&before)).collect();
        let found = files_below(&result, &earlier, MAX_RESULTS);
        let found = found.map_err(StudioError::disk(RESULT))?;
        let names = found.iter().map(|path| self.relative(&path.display()));
        let mut names: Vec<String> = names.collect();
        // `files_below` omits files that end in `.toml`.
        names.extend(self.at(FITTED).exists().then(|| FITTED.to_owned()));
        names.sort();
        Ok(names)
    }

    /// Reads a file below `result/`.
    ///
    /// # Errors
    /// The state does not list the file, or it cannot be read.
    pub fn result(&self, name: &str) -> Result<Vec<u8>, StudioError> {
        if !self.results()?.iter().any(|known| known == name) {
            return Err(StudioError::Request {
                key: "name",
                why: format!("found {name:?}, expected one of the files below {RESULT}/"),
            });
        }
        fs::read(self.at(name)).map_err(StudioError::disk(name))
    }

    /// The machine with the fitted errors. Fails without a result, or if an input has changed since the fit.
    pub(crate) fn fitted_machine(&self) -> Result<Machine, StudioError> {
        let path = self.at(FITTED);
        if !path.exists() {
            return Err(StudioError::NoResult);
        }
        if self.is_stale(&self.measurement_files()?) {
            return Err(StudioError::Stale);
        }
        Ok(Machine::read(path)?)
    }

    /// True if an input was changed, added or removed since the result was computed.
    fn is_stale(&self, measurements: &[PathBuf]) -> bool {
        if !self.at(FITTED).exists() {
            return false;
        }
        let before = fs::read_to_string(self.at(INPUTS)).unwrap_or_default();
        let pairs = before.lines().filter_map(|line| line.split_once("  "));
        let before: BTreeMap<&str, &str> = pairs.map(|(hash, name)| (name, hash)).collect();
        let is_same =
            |(name, hash): (&&str, &&str)| sha256_of(&self.at(name)).is_ok_and(|now| now == **hash);
        let is_known = |path: &PathBuf| before.contains_key(&*self.relative(&path.display()));
        let own = Some(self.at(CALIBRATION)).filter(|path| path.exists());
        let mut now = measurements.iter().chain(&own);
        !before.iter().all(is_same) || !now.all(is_known)
    }

    /// Hash and name of every input in the format of `sha256sum`: measurement files, machine file, calibration file,
    /// and the files in `named`.
    pub(crate) fn inputs(&self, named: &[PathBuf]) -> Result<String, StudioError> {
        let mut paths = self.measurement_files()?;
        let own = [MACHINE, CALIBRATION].map(|name| self.at(name));
        paths.extend(own.into_iter().filter(|path| path.exists()));
        paths.extend(named.iter().cloned());
        let mut hashes = BTreeMap::new();
        for path in paths {
            let name = self.relative(&path.display());
            let hash = sha256_of(&path).map_err(StudioError::disk(&name))?;
            hashes.insert(name, hash);
        }
        let lines = hashes.iter().map(|(name, hash)| format!("{hash}  {name}\n"));
        Ok(lines.collect())
    }
}

pub(crate) fn name_of_upload(name: &str) -> Result<String, StudioError> {
    file_name::sanitised(name).ok_or_else(|| StudioError::Upload {
        name: name.chars().take(100).collect(),
        why: "expected a file name with a letter or a digit".to_owned(),
    })
}

impl FileState {
    fn named(name: String) -> Self {
        Self { name, error: None, said: Vec::new(), not_used: None }
    }
}
