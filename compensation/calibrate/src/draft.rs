//! A first calibration file from a folder of measurement files: what their headers, endings and names say is proposed, the
//! rest is asked.

use std::fmt;
use std::path::{Path, PathBuf};

use volcomp_metrology::{Content, Metadata, SeenReadings, oddities, read_content};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::{
    checks::different_machines,
    draft_keys::Told,
    draft_text::{self, Square},
    folder::files_below,
    hints::{self, Hints},
    proposal::{of_log, of_measurement, out_of_place},
    questions::{OPEN, question},
    same_place,
};

/// A calibration file that somebody has to complete.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Draft {
    /// Every file that was looked at: what must not be overwritten.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub looked_at: Vec<PathBuf>,
    /// The calibration file, with `"?"` where a value is not known and a comment that asks for it.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub text: String,
    /// The measurements that it proposes.
    #[cfg_attr(feature = "serde", serde(rename = "measurements"))]
    pub proposed: Vec<Proposed>,
    /// Values that only the person who measured knows; empty: the file is complete.
    pub questions: Vec<Question>,
    /// Files that were given the same place, or hold the same readings.
    pub conflicts: Vec<String>,
    /// Files that fit nothing, each with the reason.
    pub left_over: Vec<LeftOver>,
    /// What is odd about the files that are used.
    #[cfg_attr(feature = "serde", serde(rename = "warnings"))]
    pub notes: Vec<String>,
    /// The machine file, as the text names it.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) machine_file: String,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) squares: Vec<Square>,
}

/// One `[[measurement]]` of a draft.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Proposed {
    /// The files; several where they are measurements of the same error at the same place.
    pub files: Vec<String>,
    /// The error, where it is known.
    pub error: Option<ErrorName>,
    /// Where the other axes stood, `None` where it is not known.
    #[cfg_attr(feature = "serde", serde(serialize_with = "as_map"))]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::collections::BTreeMap<AxisName, Option<f64>>")
    )]
    pub at: Vec<(AxisName, Option<f64>)>,
    /// Keys with their value as it stands in the file, `"?"` where it is open.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub keys: Vec<(&'static str, String)>,
    /// What stands above the table as comments.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub said: Vec<String>,
    /// What its keys follow from, beside the error.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) told: Told,
}

#[cfg(feature = "serde")]
fn as_map<S: serde::Serializer>(
    at: &[(AxisName, Option<f64>)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_map(at.iter().map(|(axis, place)| (axis, place)))
}

/// A value that is not known.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Question {
    /// The measurement file or files, or the squareness.
    pub of: String,
    /// The key of the calibration file: `point`, `at.Y`.
    pub key: String,
    /// What is asked.
    pub question: String,
}

/// A file that fits nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeftOver {
    /// The file, as it is named from the calibration file.
    pub file: String,
    /// Why it is not used, without the name of the file.
    pub reason: String,
    /// The error that it would have given, where its name, its title or an answer says which.
    pub error: Option<ErrorName>,
}

impl fmt::Display for LeftOver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            file,
            reason,
            error,
        } = self;
        write!(f, "{file}: {reason}")?;
        match error {
            Some(error) => write!(f, "; it would have given {error}"),
            None => Ok(()),
        }
    }
}

/// Looks through a folder and those in it, and proposes a calibration file for a machine. `machine_file` and the measurement
/// files are named as the caller says by `named`: relative to where the draft will stand.
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

/// The draft of these files, as [`draft`] makes that of a folder.
pub fn draft_of(
    paths: Vec<PathBuf>,
    machine: &Machine,
    machine_file: &str,
    named: impl Fn(&Path) -> String,
) -> Draft {
    let looked_at = paths.clone();
    let (mut proposed, mut left_over, mut notes) = (Vec::new(), Vec::new(), Vec::new());
    let mut conflicts = Vec::new();
    let mut used: Vec<(String, Metadata)> = Vec::new();
    let mut seen = SeenReadings::default();
    for path in paths {
        let name = named(&path);
        match read_content(&path, None) {
            Err(error) => left_over.push(LeftOver {
                file: name,
                reason: without_file(&error.to_string(), &path),
                error: Hints::of(&path, &Metadata::default(), machine).only_error(),
            }),
            Ok(Content::Capture(capture)) => left_over.push(LeftOver {
                file: name,
                reason: format!(
                    "a dynamic capture of {} samples, which has no targets",
                    capture.samples.len()
                ),
                error: Hints::of(&path, &Metadata::default(), machine).only_error(),
            }),
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
                        found
                            .said
                            .extend(odd.iter().map(|odd| format!("LOOK: {odd}")));
                        used.push((name.clone(), measurement.metadata.clone()));
                        notes.extend(
                            oddities(&measurement)
                                .iter()
                                .map(|odd| format!("{name}: {odd}")),
                        );
                        proposed.push(found);
                    }
                    Err(reason) => left_over.push(LeftOver {
                        file: name,
                        reason: without_file(&reason, &path),
                        error: Hints::of(&path, &measurement.metadata, machine).only_error(),
                    }),
                }
            }
        }
    }
    let files: Vec<(String, &Metadata)> = (used.iter())
        .map(|(name, metadata)| (name.clone(), metadata))
        .collect();
    conflicts.extend(different_machines(&files));
    same_place::join(&mut proposed, &mut conflicts);
    hints::sort(&mut proposed);
    let squares = draft_text::squares(&proposed);
    let mut questions = Vec::new();
    for of in &proposed {
        questions.extend(of.questions());
    }
    questions.extend(squares.iter().map(Square::question));
    let text = draft_text::text(machine_file, &proposed, &squares, &conflicts, &left_over);
    Draft {
        looked_at,
        text,
        proposed,
        questions,
        conflicts,
        left_over,
        notes,
        machine_file: machine_file.to_owned(),
        squares,
    }
}

/// What is wrong with a file, without the file's name at its beginning, which stands before the reason.
fn without_file(said: &str, path: &Path) -> String {
    let Some(rest) = said.strip_prefix(&path.display().to_string()) else {
        return said.to_owned();
    };
    match rest.strip_prefix(": ") {
        Some(what) => what.to_owned(),
        // The number of a line comes next.
        None => rest
            .strip_prefix(':')
            .map_or_else(|| said.to_owned(), |line| format!("line {line}")),
    }
}

impl Proposed {
    /// What is open about it, in the order of its keys.
    pub fn questions(&self) -> Vec<Question> {
        let of = self.files.join(", ");
        let mut questions = Vec::new();
        let mut ask = |key: String, question: String| {
            questions.push(Question {
                of: of.clone(),
                key,
                question,
            });
        };
        if self.error.is_none() {
            ask("error".to_owned(), question("error", None));
        }
        if self.files.len() > 1 {
            ask("file".to_owned(), question("file", None));
        }
        for (axis, _) in self.at.iter().filter(|(_, place)| place.is_none()) {
            ask(
                format!("at.{axis}"),
                question("at", Some(&axis.to_string())),
            );
        }
        for (key, value) in &self.keys {
            if *key == "channels" {
                let is_open = |inner: &&str| value.contains(&format!("{inner} = {}", open()));
                for inner in CHANNEL_KEYS.into_iter().filter(is_open) {
                    ask(
                        format!("channels.{inner}"),
                        question("channels", Some(inner)),
                    );
                }
            } else if *value == open() {
                ask((*key).to_owned(), question(key, None));
            }
        }
        questions
    }
}

/// The keys of `channels` that have no default.
pub(crate) const CHANNEL_KEYS: [&str; 4] = ["target", "reading", "reading_is", "unit"];

pub(crate) fn open() -> String {
    format!("\"{OPEN}\"")
}
