//! `volcomp calibrate`: calibrates a machine from a calibration file, or drafts such a file.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::{
    Answer as AnswerOf, Calibration, CalibrationFile, CalibrationSummary, Draft, LEVER_KEYS, Turn,
    calibrate, draft,
};
use volcomp_document::quoted;
use volcomp_identify::unit_symbol;
use volcomp_model::{Machine, Provenance, is_date};
use volcomp_vocabulary::Urad;

use super::{
    Answer, fixed,
    identify::{EXPLAINED, found_text},
    refuse_overwriting, table, table_text,
};
use crate::{
    failure::Failure,
    output::{self, OutputFile},
    table::{folded, or_dash},
};

/// Fit measurement files to a machine file, or draft a calibration file from a folder
///
/// A measurement file is refused if it states another axis of the machine or another serial number, has no target within
/// the travel, a deviation over 100 mm or 100 mrad, or angles that vary by more than 5 mrad. Notes report, among others,
/// deviations over 1 mm or 1 mrad (except straightness), and lines without `point` on an axis with tilts.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp calibrate calibration.toml -o machine-new.toml
  volcomp --json calibrate calibration.toml -o machine-new.toml")]
pub(crate) struct CalibrateArguments {
    /// Calibration file (TOML), which names the machine file and the measurement files
    #[arg(required_unless_present = "draft")]
    calibration: Option<PathBuf>,
    /// Draft a calibration file, with open questions, from the files in this folder
    #[arg(long, value_name = "DIR", requires = "machine", conflicts_with = "calibration")]
    draft: Option<PathBuf>,
    /// With --draft: machine file with structure, axes and travels
    #[arg(long, short, value_name = "M.toml", requires = "draft")]
    machine: Option<PathBuf>,
    /// With --draft: overwrite an existing file with other content, answers included
    #[arg(long, requires = "draft")]
    replace: bool,
    /// With --draft: answer an open question everywhere (rides=carriage), or of an error or axis (EYX:sign=-1);
    /// repeatable; the most specific wins
    #[arg(long = "answer", value_name = "[OF:]KEY=VALUE", requires = "draft")]
    answers: Vec<String>,
    /// Day of the calibration for the provenance in the machine file [default: none]
    #[arg(long, value_name = "YYYY-MM-DD", conflicts_with = "draft")]
    date: Option<String>,
    /// Machine file to write; with --draft the calibration file
    #[arg(long, short)]
    output: PathBuf,
}

/// A calibration and the written machine file.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Calibrate {
    /// Path of the written machine file.
    file: String,
    #[serde(flatten)]
    found: CalibrationSummary,
}

pub(crate) fn run(arguments: &CalibrateArguments) -> Result<Answer, Failure> {
    if let (Some(folder), Some(machine)) = (&arguments.draft, &arguments.machine) {
        let wanted = Wanted { answers: &arguments.answers, replace: arguments.replace };
        return run_draft(folder, machine, &arguments.output, &wanted);
    }
    // clap requires a calibration file unless a draft is requested.
    let path = arguments.calibration.clone().unwrap_or_default();
    let file = CalibrationFile::read(&path)?;
    if let Some(date) = arguments.date.as_ref().filter(|date| !is_date(date)) {
        return Err(Failure::Input(format!(
            "--date: found {}, expected a day of the calendar such as 2026-11-26",
            quoted(date)
        )));
    }
    refuse_overwriting(&file.files, &arguments.output, "calibration")?;
    let output = OutputFile::open(&arguments.output)?;
    let mut calibration = fit(&file)?;
    if arguments.date.is_some() {
        let provenance = calibration.machine.provenance().clone();
        let dated = Provenance { date: arguments.date.clone(), ..provenance };
        let set = calibration.machine.set_provenance(dated);
        set.map_err(|refusal| Failure::Input(format!("--date: {refusal}")))?;
    }
    output.write_whole(calibration.machine.to_toml())?;
    let document = Calibrate {
        file: arguments.output.display().to_string(),
        found: CalibrationSummary::new(&calibration),
    };
    Answer::new(&document, text(&document), calibration.warnings)
}

pub(super) fn fit(file: &CalibrationFile) -> Result<Calibration, Failure> {
    let work = |told: &mut dyn FnMut(usize, usize)| calibrate(file, told);
    Ok(output::with_bar("errors fitted", work)?)
}

fn text(document: &Calibrate) -> String {
    let mut fitted = table(&[
        "error",
        "direction",
        "curve",
        "points",
        "residual min",
        "max",
        "rms",
        "LOO error",
        "",
    ]);
    for curve in &document.found.curves {
        fitted.add_row([
            curve.error.to_string(),
            curve.direction.unwrap_or("both").to_owned(),
            curve.curve.to_owned(),
            curve.readings.to_string(),
            fixed(curve.residual.min, 2),
            fixed(curve.residual.max, 2),
            fixed(curve.residual.rms, 2),
            or_dash(curve.leave_one_out, 2),
            unit_symbol(curve.unit).to_owned(),
        ]);
    }
    let mut text = table_text(&fitted);
    if !document.found.squareness_urad.is_empty() {
        let mut squareness = table(&["squareness", "", ""]);
        for (error, value) in &document.found.squareness_urad {
            squareness.add_row([error.clone(), fixed(*value, 2), Urad::SYMBOL.to_owned()]);
        }
        text.push('\n');
        text += &table_text(&squareness);
    }
    if !document.found.locations.is_empty() {
        let mut stated = table(&["location error", "stated", "uncertainty", ""]);
        for (error, location) in &document.found.locations {
            stated.add_row([
                error.clone(),
                fixed(location.value, 2),
                fixed(location.uncertainty, 2),
                unit_symbol(location.unit).to_owned(),
            ]);
        }
        text.push('\n');
        text += &table_text(&stated);
    }
    if let Some(identified) = &document.found.identified {
        text.push('\n');
        text += &found_text(&identified.found);
    }
    let _ = write!(
        text,
        "\nwrote {}: {} fitted, {} squareness\n",
        document.file,
        counted(document.found.curves.len(), "curve"),
        document.found.squareness_urad.len()
    );
    text += "\nResidual: mean reading minus curve. LOO error: root mean square of what the\n\
             curve misses of the readings of a target that were left out of its fit, one\n\
             target at a time.\n";
    if document.found.identified.is_some() {
        text += EXPLAINED;
    }
    text
}

fn counted(count: usize, what: &str) -> String {
    let s = if count == 1 { "" } else { "s" };
    format!("{count} {what}{s}")
}

pub(super) struct Wanted<'a> {
    /// Answers to groups of questions, each `[OF:]KEY=VALUE`.
    pub(super) answers: &'a [String],
    pub(super) replace: bool,
}

fn run_draft(
    folder: &Path,
    machine_file: &Path,
    output: &Path,
    wanted: &Wanted<'_>,
) -> Result<Answer, Failure> {
    let machine = Machine::read(machine_file)?;
    let file = OutputFile::open_beside(output, &[(machine_file, "the machine file")])?;
    let base = base_of(output);
    let named = |path: &Path| relative(path, &base);
    let found = draft(folder, &machine, &named(machine_file), named)
        .map_err(|error| Failure::in_file(folder, format_args!("cannot be searched: {error}")))?;
    if found.proposed.is_empty() {
        let reasons: Vec<String> = found.left_over.iter().map(ToString::to_string).collect();
        let reasons = match reasons[..] {
            [] => "it holds no files".to_owned(),
            _ => reasons.join("; "),
        };
        return Err(Failure::in_file(
            folder,
            format_args!("found no measurement file for this machine: {reasons}"),
        ));
    }
    let (found, mut told) = answered(&found, wanted.answers)?;
    refuse_overwriting(&found.scanned, output, "draft")?;
    if !wanted.replace {
        refuse_another(output, &found.text)?;
    }
    file.write_whole(&found.text)?;
    let name = output.display().to_string();
    told.extend(notes(&found));
    let text = draft_text(&name, &found);
    Answer::new(&Drafted { file: name, found }, text, told)
}

/// A draft and the path of its file.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Drafted {
    /// Path of the written calibration file.
    file: String,
    #[serde(flatten)]
    found: Draft,
}

/// Applies answers to a draft. The most specific answer wins (error, then axis, then all); of equals, the first. Also
/// returns notes on answers that match no question.
fn answered(draft: &Draft, answers: &[String]) -> Result<(Draft, Vec<String>), Failure> {
    let (mut all, mut notes) = (Vec::new(), Vec::new());
    let mut decided = draft.clone();
    let mut answers: Vec<&String> = answers.iter().collect();
    answers.sort_by_key(|given| std::cmp::Reverse(narrowness(given)));
    // The error determines the further questions, and then the unit determines the rest.
    for turn in Turn::ALL {
        let now = answers.iter().filter(|given| turn_of(given) == turn);
        take(now.copied(), &[draft, &decided], &mut all, &mut notes)?;
        decided =
            draft.answered(&all).map_err(|error| Failure::Input(format!("--answer: {error}")))?;
    }
    Ok((decided, notes))
}

/// Splits `[OF:]KEY=VALUE` into the error or axis to which the answer applies, its key, and its value.
fn parts(given: &str) -> (Option<&str>, &str, Option<&str>) {
    let (asked, value) = match given.split_once('=') {
        Some((asked, value)) => (asked, Some(value.trim())),
        None => (given, None),
    };
    match asked.split_once(':') {
        Some((of, key)) => (Some(of.trim()), key.trim(), value),
        None => (None, asked.trim(), value),
    }
}

/// Specificity of an answer: the length of its subject. Error names are longer than axis names, and both are longer
/// than a missing subject.
fn narrowness(given: &str) -> usize {
    parts(given).0.map_or(0, str::len)
}

fn turn_of(given: &str) -> Turn {
    Turn::of(parts(given).1)
}

/// Collects answers to all questions of the drafts that no earlier answer has settled, and notes on answers that match
/// no question.
fn take<'a>(
    answers: impl Iterator<Item = &'a String>,
    drafts: &[&Draft],
    all: &mut Vec<AnswerOf>,
    notes: &mut Vec<String>,
) -> Result<(), Failure> {
    for given in answers {
        let wrong = |message: String| Failure::Input(format!("--answer {given}: {message}"));
        let (of, key, Some(value)) = parts(given) else {
            let message = "expected [OF:]KEY=VALUE, such as rides=carriage or Y:at.X=4000";
            return Err(wrong(message.to_owned()));
        };
        let found = drafts.iter();
        let found: Vec<AnswerOf> = found.flat_map(|draft| draft.for_all(of, key, value)).collect();
        if found.is_empty() {
            let asked = drafts.iter().flat_map(|draft| &draft.questions);
            let mut keys: Vec<&str> = asked.map(|q| q.key.as_str()).collect();
            let is_lever = |key: &str| LEVER_KEYS.contains(&key);
            if is_lever(key) && !keys.iter().any(|asked| is_lever(asked)) {
                notes.push(format!(
                    "--answer {given} is not used: no tilt is measured, so that the place of a line has no effect"
                ));
                continue;
            }
            keys.sort_unstable();
            keys.dedup();
            return Err(wrong(format!(
                "no question is open for it, expected one of {}",
                keys.join(", ")
            )));
        }
        let before = all.len();
        for answer in found {
            let is_settled = |known: &AnswerOf| known.of == answer.of && known.key == answer.key;
            if !all.iter().any(is_settled) {
                all.push(answer);
            }
        }
        if all.len() == before {
            notes.push(format!(
                "--answer {given} settles nothing: other answers settle every question that it is for"
            ));
        }
    }
    Ok(())
}

/// Refuses to overwrite a file with another text, because the user may have answered its questions.
fn refuse_another(output: &Path, text: &str) -> Result<(), Failure> {
    if !output.exists() || std::fs::read(output).is_ok_and(|there| there == text.as_bytes()) {
        return Ok(());
    }
    Err(Failure::Input(format!(
        "--output {}: the file is there and is not this draft; expected another file, or --replace",
        output.display()
    )))
}

/// The folder of the draft. The file names of the draft are relative to it.
fn base_of(output: &Path) -> PathBuf {
    let folder = match output.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    folder.canonicalize().unwrap_or_else(|_| folder.to_owned())
}

/// The path of a file: relative to `base` if the file is inside, otherwise absolute.
fn relative(path: &Path, base: &Path) -> String {
    let whole = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    whole.strip_prefix(base).unwrap_or(&whole).display().to_string()
}

fn notes(draft: &Draft) -> Vec<String> {
    let mut notes = draft.conflicts.clone();
    let left_over = draft.left_over.iter();
    notes.extend(left_over.map(|of| format!("not used: {of}")));
    notes.extend(draft.notes.iter().cloned());
    notes
}

fn draft_text(file: &str, draft: &Draft) -> String {
    let mut proposed = table(&["error", "file", "open"]);
    for of in &draft.proposed {
        let open: Vec<String> = of.questions().into_iter().map(|asked| asked.key).collect();
        let error = of.error.map_or_else(|| "?".to_owned(), |error| error.to_string());
        proposed.add_row([error, of.files.join(" or "), open.join(" ")]);
    }
    let mut text = table_text(&proposed);
    let _ = match draft.questions.len() {
        0 => writeln!(text, "\nwrote {file}: no question is open"),
        1 => writeln!(text, "\nwrote {file}: one question is open, marked \"?\""),
        open => writeln!(
            text,
            "\nwrote {file}: {open} questions are open, each marked \"?\" with a comment"
        ),
    };
    text + &kinds_of_questions(draft)
}

/// The keys of the open questions with their counts. Equal questions are listed once.
fn kinds_of_questions(draft: &Draft) -> String {
    let mut kinds: Vec<(&str, &str, usize)> = Vec::new();
    for asked in &draft.questions {
        match kinds.iter_mut().find(|(key, _, _)| *key == asked.key) {
            Some((_, _, count)) => *count += 1,
            None => kinds.push((&asked.key, &asked.question, 1)),
        }
    }
    if kinds.is_empty() {
        return String::new();
    }
    let mut text = String::from("\nOpen questions, and how often:\n");
    for (key, question, count) in kinds {
        text += &folded(&format!("{key} ({count}): {question}"), " ");
    }
    text += &folded(
        "Where many have the same answer, call this again with --replace (which drops changes in the file) and give it once: --answer rides=carriage, for an error or an axis --answer EYX:sign=-1 or --answer Y:at.X=4000, for a default --answer sign=default; the most specific answer wins, in any order.",
        "",
    );
    text
}
