use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::{Answer as AnswerOf, Draft, LEVER_KEYS, Turn, draft};
use volcomp_model::Machine;

use super::{Answer, refuse_overwriting, table, table_text};
use crate::{failure::Failure, output::OutputFile, table::folded};

pub(super) struct Wanted<'a> {
    /// Answers to groups of questions, each `[OF:]KEY=VALUE`.
    pub(super) answers: &'a [String],
    pub(super) replace: bool,
}

pub(super) fn run(
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
    let text = text(&name, &found);
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

fn text(file: &str, draft: &Draft) -> String {
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
