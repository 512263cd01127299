//! A first calibration file from a folder of measurement files: what their headers, endings and names say is proposed, the
//! rest is asked.

use std::fmt;
use std::path::{Path, PathBuf};

use volcomp_metrology::{
    Content, Measurement, Metadata, Quantity, SeenReadings, axis_named, oddities, read_content,
};
use volcomp_model::{Axis, Machine};
use volcomp_vocabulary::{AxisName, Component, ErrorName};

use crate::{
    checks::{beyond_travel, different_machines, other_machine},
    draft_keys::Told,
    draft_text::{self, Square},
    hints::{self, Hints},
    questions::{OPEN, question},
    same_place,
};

/// A calibration file that somebody has to complete.
#[derive(Clone, Debug)]
pub struct Draft {
    /// Every file that was looked at: what must not be overwritten.
    pub looked_at: Vec<PathBuf>,
    /// The calibration file, with `"?"` where a value is not known and a comment that asks for it.
    pub text: String,
    /// The measurements that it proposes.
    pub proposed: Vec<Proposed>,
    /// What nobody but the one who measured can say.
    pub questions: Vec<Question>,
    /// Files that were given the same place, or hold the same readings.
    pub conflicts: Vec<String>,
    /// Files that fit nothing, each with the reason.
    pub left_over: Vec<LeftOver>,
    /// What is odd about the files that are used.
    pub notes: Vec<String>,
    /// The machine file, as the text names it.
    pub(crate) machine_file: String,
    pub(crate) squares: Vec<Square>,
}

/// One `[[measurement]]` of a draft.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposed {
    /// The files; several where they are measurements of the same error at the same place.
    pub files: Vec<String>,
    /// The error, where it is known.
    pub error: Option<ErrorName>,
    /// Where the other axes stood, `None` where it is not known.
    pub at: Vec<(AxisName, Option<f64>)>,
    /// Keys with their value as it stands in the file, `"?"` where it is open.
    pub keys: Vec<(&'static str, String)>,
    /// What stands above the table as comments.
    pub said: Vec<String>,
    /// What its keys follow from, beside the error.
    pub(crate) told: Told,
}

/// A value that is not known.
#[derive(Clone, Debug, PartialEq, Eq)]
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
    let paths = files_below(folder)?;
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
    Ok(Draft {
        looked_at,
        text,
        proposed,
        questions,
        conflicts,
        left_over,
        notes,
        machine_file: machine_file.to_owned(),
        squares,
    })
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

/// Files below a folder in the order of their names, without hidden ones and the TOML files that say something of others. Links to folders are
/// not followed.
///
/// # Errors
/// A folder that cannot be read.
pub fn files_below(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    list(folder, 0, &mut paths)?;
    paths.sort();
    Ok(paths)
}

fn list(folder: &Path, depth: usize, paths: &mut Vec<PathBuf>) -> std::io::Result<()> {
    const DEEPEST: usize = 8;
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let path = entry.path();
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_toml = path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("toml"));
        if name.starts_with('.') || is_toml {
            continue;
        }
        let kind = entry.file_type()?;
        if kind.is_dir() {
            if depth < DEEPEST {
                list(&path, depth + 1, paths)?;
            }
        } else {
            paths.push(path);
        }
    }
    Ok(())
}

/// A log of which nobody said which channel is what.
fn of_log(name: String, path: &Path, machine: &Machine, channels: &str) -> Proposed {
    let hints = Hints::of(path, &Metadata::default(), machine);
    let told = Told {
        is_log: true,
        ..told(&hints, machine)
    };
    let mut found = proposed(name, hints.only_error(), told);
    found.said.push(format!("a log of the channels {channels}"));
    found.said.extend(hints.contradictions);
    found
}

/// What a file with readings is proposed as, or why it fits nothing.
fn of_measurement(
    name: &str,
    path: &Path,
    measurement: &Measurement,
    machine: &Machine,
) -> Result<Proposed, String> {
    let hints = Hints::of(path, &measurement.metadata, machine);
    let stated = measurement.metadata.axis.as_deref().and_then(axis_named);
    if let Some(axis) = stated.filter(|axis| machine.axis(*axis).is_none()) {
        return Err(format!(
            "it states axis {axis}, which the machine does not have"
        ));
    }
    let axis = stated.or(hints.axis);
    let mut said = vec![facts(measurement)];
    let mut candidates = match axis {
        Some(axis) => candidates(axis, measurement.quantity),
        None => Vec::new(),
    };
    let error = match hints.only_error() {
        Some(hinted) if stated.is_some_and(|axis| axis != hinted.axis) => {
            said.push(format!(
                "CONTRADICTION: the file states axis {}, its name or title says {hinted}",
                stated.map_or(String::new(), |axis| axis.to_string())
            ));
            None
        }
        Some(hinted) => {
            let fits = crate::draft::candidates(hinted.axis, measurement.quantity);
            let is_angular_method = measurement.quantity == Some(Quantity::Angle)
                && !hinted.component.is_angular()
                && !hinted.axis.is_rotary()
                && hinted.component.mcs_index() != hinted.axis.mcs_index();
            // Lengths under the name of a straightness: some programs write these as .rtl, too.
            let is_length = measurement.quantity == Some(Quantity::Positioning)
                && !hinted.component.is_angular();
            if fits.contains(&hinted) || is_angular_method || is_length {
                Some(hinted)
            } else {
                candidates = fits;
                said.push(format!(
                    "CONTRADICTION: the name or title says {hinted}, the kind of file does not measure it"
                ));
                None
            }
        }
        None if hints.errors.len() > 1 => {
            let names: Vec<String> = hints.errors.iter().map(ToString::to_string).collect();
            said.push(format!(
                "CONTRADICTION: name and title say {}",
                names.join(" and ")
            ));
            None
        }
        None => match candidates[..] {
            [only] => Some(only),
            _ => None,
        },
    };
    check_targets(measurement, error.map(|error| error.axis).or(axis), machine)?;
    if error.is_none() && !candidates.is_empty() {
        let names: Vec<String> = candidates.iter().map(ToString::to_string).collect();
        said.push(format!("error: one of {}", names.join(", ")));
    } else if error.is_none() {
        let fits = axes_that_reach(measurement, machine);
        said.push(format!("the targets are within the travel of {fits}"));
    }
    said.extend(hints.contradictions.iter().cloned());
    let told = Told {
        axis,
        quantity: measurement.quantity,
        format: measurement.format,
        unit: measurement.unit,
        asks_unit: measurement.unit.is_none(),
        ..told(&hints, machine)
    };
    let mut found = proposed(name.to_owned(), error, told);
    found.said = said;
    Ok(found)
}

/// What is said of a file that looks like one of another axis or machine.
fn out_of_place(of: &Proposed, measurement: &Measurement, machine: &Machine) -> Vec<String> {
    let axis = of.error.and_then(|error| machine.axis(error.axis));
    let beyond = axis.and_then(|axis| beyond_travel(measurement, axis));
    let said = [beyond, other_machine(measurement, machine)];
    said.into_iter().flatten().collect()
}

/// What names and texts say of where the axes stood.
fn told(hints: &Hints, machine: &Machine) -> Told {
    let place = |axis: &Axis| {
        let place = hints.places.get(&axis.name).copied();
        // A place where the axis cannot stand is no hint.
        let place = place.filter(|place| axis.check_coordinate(*place).is_ok());
        (axis.name, place)
    };
    Told {
        places: machine.axes().iter().map(place).collect(),
        axis: None,
        quantity: None,
        format: None,
        unit: None,
        asks_unit: false,
        is_log: false,
    }
}

fn proposed(file: String, error: Option<ErrorName>, told: Told) -> Proposed {
    let mut found = Proposed {
        files: vec![file],
        error,
        at: Vec::new(),
        keys: Vec::new(),
        said: Vec::new(),
        told,
    };
    found.follow();
    found
}

/// The errors of an axis that a kind of file may measure.
pub(crate) fn candidates(axis: AxisName, quantity: Option<Quantity>) -> Vec<ErrorName> {
    let errors = Component::ALL.map(|component| ErrorName::motion(component, axis));
    let is_own = |error: &ErrorName| error.component.mcs_index() == axis.mcs_index();
    let fits = |error: &ErrorName| match quantity {
        None => true,
        Some(Quantity::Angle) => error.component.is_angular(),
        Some(Quantity::Straightness) => !error.component.is_angular() && !is_own(error),
        Some(Quantity::Positioning) => {
            is_own(error) && error.component.is_angular() == axis.is_rotary()
        }
    };
    errors.into_iter().filter(fits).collect()
}

fn check_targets(
    measurement: &Measurement,
    axis: Option<AxisName>,
    machine: &Machine,
) -> Result<(), String> {
    let Some(axis) = axis.and_then(|name| machine.axis(name)) else {
        return match axis {
            Some(axis) => Err(format!(
                "it measures axis {axis}, which the machine does not have"
            )),
            None => Ok(()),
        };
    };
    let targets = measurement.targets();
    let (Some(first), Some(last)) = (targets.first(), targets.last()) else {
        return Err("it holds no targets".to_owned());
    };
    if targets.iter().any(|target| axis.may_stand_at(*target)) {
        return Ok(());
    }
    let [low, high] = axis.travel;
    let unit = axis.name.kind().coordinate_unit();
    Err(format!(
        "its targets from {first} to {last} {unit} are not within the travel of {}, {low} to {high} {unit}",
        axis.name
    ))
}

fn axes_that_reach(measurement: &Measurement, machine: &Machine) -> String {
    let targets = measurement.targets();
    let reach = machine
        .axes()
        .iter()
        .filter(|axis| targets.iter().all(|target| axis.may_stand_at(*target)));
    let names: Vec<String> = reach.map(|axis| axis.name.to_string()).collect();
    if names.is_empty() {
        "no axis".to_owned()
    } else {
        names.join(", ")
    }
}

/// What the file says of itself, in one line.
fn facts(measurement: &Measurement) -> String {
    let mut facts = Vec::new();
    facts.extend(
        measurement
            .format
            .map(|format| format.instrument().to_owned()),
    );
    let meta = &measurement.metadata;
    for (key, text) in [
        ("machine", &meta.machine),
        ("axis", &meta.axis),
        ("date", &meta.date),
        ("location", &meta.location),
        ("title", &meta.title),
    ] {
        facts.extend(text.as_ref().map(|text| format!("{key} {text}")));
    }
    let targets = measurement.targets();
    if let [first, .., last] = targets[..] {
        facts.push(format!("{} targets from {first} to {last}", targets.len()));
    }
    facts.join("; ")
}
