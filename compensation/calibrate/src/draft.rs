//! Drafts a calibration file for a folder of measurement files.
//!
//! Proposals come from the headers, extensions and names of the files; unknown values become questions.

use std::{
    fmt::{self, Write as _},
    path::{Path, PathBuf},
};

use volcomp_document::toml_string;
use volcomp_metrology::{Content, KnownReadings, Metadata, anomalies, read_content};
use volcomp_model::Machine;
use volcomp_vocabulary::ErrorName;

use crate::checks::different_machines;
use crate::proposal::{
    DEFAULT, FileHints, OPEN, Proposed, Question, ask_for_levers, of_log, of_measurement, open,
    out_of_place, question, sort,
};

/// A calibration file with open questions for the user.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Draft {
    /// Every scanned file: these must not be overwritten.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub scanned: Vec<PathBuf>,
    /// The calibration file, with `"?"` for each unknown value and a comment that asks for it.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub text: String,
    /// The proposed measurements.
    #[cfg_attr(feature = "serde", serde(rename = "measurements"))]
    pub proposed: Vec<Proposed>,
    /// Values that only the user can state; empty: the file is complete.
    pub questions: Vec<Question>,
    /// Files that were assigned to the same place, or have the same readings.
    pub conflicts: Vec<String>,
    /// Unused files, each with the reason.
    pub left_over: Vec<LeftOver>,
    /// Anomalies of the files that are used.
    #[cfg_attr(feature = "serde", serde(rename = "warnings"))]
    pub notes: Vec<String>,
    /// Path of the machine file in the text.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) machine_file: String,
    /// Whether the machine file has an angular error.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) machine_has_tilts: bool,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) squares: Vec<Square>,
}

/// A file that the draft does not use.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeftOver {
    /// Path relative to the calibration file.
    pub file: String,
    /// Reason why the file is not used, without its name.
    pub reason: String,
    /// Error named by the file name, the title or an answer.
    pub error: Option<ErrorName>,
}

impl fmt::Display for LeftOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, reason, error } = self;
        write!(f, "{file}: {reason}")?;
        match error {
            Some(error) => write!(f, "; it would have given {error}"),
            None => Ok(()),
        }
    }
}

/// Scans a folder and its subfolders, and drafts a calibration file for a machine. `machine_file` and the paths that `named` returns for measurement
/// files are relative to the future location of the draft.
///
/// # Errors
/// The folder cannot be read.
pub fn draft(
    folder: &Path,
    machine: &Machine,
    machine_file: &str,
    named: impl Fn(&Path) -> String,
) -> std::io::Result<Draft> {
    let paths = files_below(folder, &[], usize::MAX)?;
    Ok(draft_of(paths, machine, machine_file, named))
}

/// Like [`draft`], for the files in `paths` instead of a folder.
pub fn draft_of(
    paths: Vec<PathBuf>,
    machine: &Machine,
    machine_file: &str,
    named: impl Fn(&Path) -> String,
) -> Draft {
    let scanned = paths.clone();
    let (mut proposed, mut left_over, mut notes) = (Vec::new(), Vec::new(), Vec::new());
    let mut conflicts = Vec::new();
    let mut used: Vec<(String, Metadata)> = Vec::new();
    let mut seen = KnownReadings::default();
    let unused = |file: String, path: &Path, reason: String, metadata: &Metadata| LeftOver {
        file,
        reason,
        error: FileHints::of(path, metadata, machine).only_error(),
    };
    for path in paths {
        let name = named(&path);
        match read_content(&path, None) {
            Err(error) => {
                let reason = without_file(&error.to_string(), &path);
                left_over.push(unused(name, &path, reason, &Metadata::default()));
            }
            Ok(Content::Capture(capture)) => {
                let reason = format!(
                    "a dynamic capture of {} samples, which has no targets",
                    capture.samples.len()
                );
                left_over.push(unused(name, &path, reason, &Metadata::default()));
            }
            Ok(Content::Log(log)) => {
                let names = log.channels.iter().map(|channel| channel.name.as_str());
                let names = names.collect::<Vec<_>>().join(", ");
                proposed.push(of_log(name, &path, machine, &names));
            }
            Ok(Content::Measurement(measurement)) => {
                if let Some(other) = seen.before(&measurement, name.clone()) {
                    conflicts.push(format!(
                        "{name} has the same readings as {other}: is it one test under two names?"
                    ));
                }
                match of_measurement(&name, &path, &measurement, machine) {
                    Ok(mut found) => {
                        let odd = out_of_place(&found, &measurement, machine);
                        notes.extend(odd.iter().map(|odd| format!("{name}: {odd}")));
                        found.said.extend(odd.iter().map(|odd| format!("LOOK: {odd}")));
                        used.push((name.clone(), measurement.metadata.clone()));
                        notes.extend(
                            anomalies(&measurement).iter().map(|odd| format!("{name}: {odd}")),
                        );
                        proposed.push(found);
                    }
                    Err(reason) => {
                        let reason = without_file(&reason, &path);
                        left_over.push(unused(name, &path, reason, &measurement.metadata));
                    }
                }
            }
        }
    }
    let files: Vec<(String, &Metadata)> =
        (used.iter()).map(|(name, metadata)| (name.clone(), metadata)).collect();
    conflicts.extend(different_machines(&files));
    join_same_places(&mut proposed, &mut conflicts);
    sort(&mut proposed);
    let machine_has_tilts = machine.errors().any(|(name, _)| name.component.is_angular());
    ask_for_levers(&mut proposed, machine_has_tilts);
    let squares = squares_of(&proposed);
    let mut questions = Vec::new();
    for of in &proposed {
        questions.extend(of.questions());
    }
    questions.extend(squares.iter().map(Square::question));
    let text = text_of(machine_file, &proposed, &squares, &conflicts, &left_over);
    Draft {
        scanned,
        text,
        proposed,
        questions,
        conflicts,
        left_over,
        notes,
        machine_file: machine_file.to_owned(),
        machine_has_tilts,
        squares,
    }
}

/// Removes the file name at the beginning of a message; the caller writes it before the message.
fn without_file(said: &str, path: &Path) -> String {
    let Some(rest) = said.strip_prefix(&path.display().to_string()) else {
        return said.to_owned();
    };
    match rest.strip_prefix(": ") {
        Some(what) => what.to_owned(),
        // A colon and the line number follow the file name.
        None => {
            rest.strip_prefix(':').map_or_else(|| said.to_owned(), |line| format!("line {line}"))
        }
    }
}

impl Proposed {
    /// Whether both measurements have the same error, the same axis positions and, if both state a measured point, the
    /// same point. Open positions are treated as equal.
    fn is_at_place_of(&self, other: &Self) -> bool {
        let is_one_point = match (self.point(), other.point()) {
            (Some(one), Some(other)) => one == other,
            _ => true,
        };
        self.error.is_some() && self.error == other.error && self.at == other.at && is_one_point
    }

    fn has_known_place(&self) -> bool {
        self.at.iter().all(|(_, place)| place.is_some())
    }

    fn point(&self) -> Option<&str> {
        let mut keys = self.keys.iter();
        let point = keys.find(|(key, value)| *key == "point" && *value != open());
        point.map(|(_, value)| value.as_str())
    }
}

/// Merges measurements at the same place into one measurement, whose file becomes a question. Measurements with an
/// unknown place are only listed as conflicts.
fn join_same_places(proposed: &mut Vec<Proposed>, conflicts: &mut Vec<String>) {
    let mut kept: Vec<Proposed> = Vec::new();
    for of in proposed.drain(..) {
        let Some(other) = kept.iter_mut().find(|other| of.is_at_place_of(other)) else {
            kept.push(of);
            continue;
        };
        if of.has_known_place() {
            conflicts.push(keep_one(other, &of));
            other.files.extend(of.files);
            other.said.extend(of.said);
        } else {
            conflicts.push(format!(
                "{}: `at` must distinguish them, else keep one",
                both_measure(other, &of)
            ));
            kept.push(of);
        }
    }
    *proposed = kept;
}

/// Messages on measurements that have the same place because of answers. Measurements that had the same place before
/// are already merged.
pub(crate) fn conflicts_of(now: &[Proposed]) -> Vec<String> {
    let conflict = |(place, of): (usize, &Proposed)| {
        let mut before = now[..place].iter();
        let other = before.find(|other| of.has_known_place() && of.is_at_place_of(other))?;
        Some(keep_one(other, of))
    };
    now.iter().enumerate().filter_map(conflict).collect()
}

fn keep_one(one: &Proposed, other: &Proposed) -> String {
    format!("{} at the same place: keep one", both_measure(one, other))
}

fn both_measure(one: &Proposed, other: &Proposed) -> String {
    format!(
        "{} and {} both measure {}",
        one.files.join(", "),
        other.files.join(", "),
        one.error.map_or(String::new(), |error| error.to_string())
    )
}

/// A squareness whose two straightness errors are in the draft.
#[derive(Clone, Debug)]
pub(crate) struct Square {
    pub(crate) error: ErrorName,
    from: [ErrorName; 2],
    pub(crate) reference_angle_urad: Option<f64>,
}

impl Square {
    pub(crate) fn question(&self) -> Question {
        Question {
            of: self.error.to_string(),
            key: "reference_angle_urad".to_owned(),
            question: question("reference_angle_urad", None),
        }
    }
}

pub(crate) fn squares_of(proposed: &[Proposed]) -> Vec<Square> {
    const PAIRS: [(&str, [&str; 2]); 3] =
        [("EC0Y", ["EXY", "EYX"]), ("EA0Z", ["EYZ", "EZY"]), ("EB0Z", ["EXZ", "EZX"])];
    let has = |error: &ErrorName| proposed.iter().any(|of| of.error == Some(*error));
    let mut squares = Vec::new();
    for (error, from) in PAIRS {
        let names = from.map(str::parse::<ErrorName>);
        if let (Ok(error), [Ok(first), Ok(second)]) = (error.parse(), names)
            && has(&first)
            && has(&second)
        {
            squares.push(Square { error, from: [first, second], reference_angle_urad: None });
        }
    }
    squares
}

pub(crate) fn text_of(
    machine_file: &str,
    proposed: &[Proposed],
    squares: &[Square],
    conflicts: &[String],
    left_over: &[LeftOver],
) -> String {
    let mut text = String::from(
        "# Draft of a calibration file. Every \"?\" is a question that only the one who measured can answer;\n\
         # while there is one, `volcomp calibrate` refuses the file and names it. A key with a default may be taken out\n\
         # (\"Default\"); one answer to many questions, in a new draft: `--draft … --replace --answer KEY=VALUE`.\n",
    );
    for conflict in conflicts {
        comment(&mut text, &format!("CONFLICT: {conflict}"));
    }
    for of in left_over {
        comment(&mut text, &format!("not used: {of}"));
    }
    // Writing to a String cannot fail.
    let _ = writeln!(text, "machine = {}", toml_string(machine_file));
    for of in proposed {
        text.push('\n');
        for said in of.said.iter().filter(|said| !said.is_empty()) {
            comment(&mut text, said);
        }
        for asked in of.questions() {
            comment(&mut text, &format!("QUESTION {}: {}", asked.key, asked.question));
        }
        text.push_str("[[measurement]]\n");
        let error = of.error.map_or_else(|| OPEN.to_owned(), |error| error.to_string());
        let _ = writeln!(text, "error = \"{error}\"");
        match &of.files[..] {
            [only] => {
                let _ = writeln!(text, "file = {}", toml_string(only));
            }
            several => {
                comment(&mut text, &format!("files: {}", several.join(", ")));
                let _ = writeln!(text, "file = \"{OPEN}\"");
            }
        }
        if !of.at.is_empty() {
            let places: Vec<String> = of
                .at
                .iter()
                .map(|(axis, place)| match place {
                    Some(place) => format!("{axis} = {place:?}"),
                    None => format!("{axis} = \"{OPEN}\""),
                })
                .collect();
            let _ = writeln!(text, "at = {{ {} }}", places.join(", "));
        }
        for (key, value) in of.keys.iter().filter(|(_, value)| value != DEFAULT) {
            let _ = writeln!(text, "{key} = {value}");
        }
    }
    for square in squares {
        let [first, second] = square.from;
        text.push('\n');
        if square.reference_angle_urad.is_none() {
            let asked = square.question();
            comment(&mut text, &format!("QUESTION {}: {}", asked.key, asked.question));
        }
        let angle = match square.reference_angle_urad {
            Some(angle) => format!("{angle:?}"),
            None => format!("\"{OPEN}\""),
        };
        let _ = writeln!(
            text,
            "[[squareness]]\nerror = \"{}\"\nfrom = [\"{first}\", \"{second}\"]\nreference_angle_urad = {angle}",
            square.error
        );
    }
    text
}

/// Writes a comment. Control characters are replaced, so that text of a file cannot end the comment.
fn comment(text: &mut String, said: &str) {
    let clean: String = said.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    text.push_str("# ");
    text.push_str(&clean);
    text.push('\n');
}

/// Files below a folder, ordered by path, without hidden files, special files and TOML files. Links to folders, the folders `without`, and
/// folders more than eight levels deep are not entered. The search ends when more than `most` files have been found.
///
/// # Errors
/// A folder that cannot be read.
pub fn files_below(
    folder: &Path,
    without: &[PathBuf],
    most: usize,
) -> std::io::Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    list(folder, without, 0, most, &mut paths)?;
    paths.sort();
    Ok(paths)
}

fn list(
    folder: &Path,
    without: &[PathBuf],
    depth: usize,
    most: usize,
    paths: &mut Vec<PathBuf>,
) -> std::io::Result<()> {
    const DEEPEST: usize = 8;
    for entry in std::fs::read_dir(folder)? {
        if paths.len() > most {
            return Ok(());
        }
        let entry = entry?;
        let path = entry.path();
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_toml = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"));
        if name.starts_with('.') || is_toml {
            continue;
        }
        let kind = entry.file_type()?;
        if kind.is_dir() {
            if depth < DEEPEST && !without.contains(&path) {
                list(&path, without, depth + 1, most, paths)?;
            }
        } else if path.is_file() {
            // Only files are listed: reading a pipe or a socket would block.
            paths.push(path);
        }
    }
    Ok(())
}
