//! The reasons why nothing can be identified.

use volcomp_curve::CurveError;
use volcomp_document::{InputError, ReadError};
use volcomp_model::ModelError;

/// Why observations do not make a machine.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say what the fields are")]
#[non_exhaustive]
pub enum IdentifyError {
    /// A file cannot be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Something in a file is wrong.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Something in the machine file is wrong, or the machine cannot have an error that was found.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// A curve cannot be built from what was found.
    #[error("{error}: {source}")]
    Curve {
        error: volcomp_vocabulary::ErrorName,
        source: CurveError,
    },
    /// A row speaks of a part of the set-up that is not there; a file that was read has none of these.
    #[error(
        "{file}: line {line}: found number {found} of the set-up's {what}, expected less than {count}"
    )]
    NoSuchPlace {
        file: String,
        line: usize,
        what: &'static str,
        found: usize,
        count: usize,
    },
    /// Observations hold something of which no equations can be made; a file that was read has none of this.
    #[error("{place}: {why}")]
    Unusable { place: String, why: String },
    /// A value is given for something that is not unknown.
    #[error("found a value of `{found}`, which is none of the unknowns, expected one of {known}")]
    NoSuchUnknown { found: String, known: String },
    /// Known errors are those of a machine that is built otherwise.
    #[error(
        "found a machine with the structure `{found}`, expected `{expected}` as in the observations"
    )]
    OtherStructure { found: String, expected: String },
    /// There are fewer numbers than unknowns.
    #[error(
        "found {numbers} numbers in {poses} poses for {unknowns} unknowns of the set-up and the machine, of which they determine {rank} at the most: expected more poses, or fewer unknowns"
    )]
    TooFew {
        poses: usize,
        numbers: usize,
        unknowns: usize,
        rank: usize,
    },
    /// The lever of a target at which tilts act is not determined.
    #[error(
        "{target} cannot be told apart from {with}, and what tilts do at the tip depends on it: measure with a ruler where the target is from the tip and state it, `target = [x, y, z]` with its standard uncertainty `target_within_mm`, or turn the tool with rotary axes"
    )]
    Target { target: String, with: String },
    /// The machine stood at the same place in all rows.
    #[error(
        "found {rows} rows that all stand at the same pose, expected poses that differ: one pose says nothing of the errors of an axis"
    )]
    AllAlike { rows: usize },
    /// What was found belongs to other observations.
    #[error(
        "what was found has other unknowns than the observations, expected what `identify` found of these observations"
    )]
    OtherObservations,
    /// Errors cannot follow an unknown like this.
    #[error("errors of the machine cannot follow {parameter}: {why}")]
    NotFollowing {
        parameter: String,
        why: &'static str,
    },
    /// No row is there to be fitted.
    #[error(
        "found no rows to fit, expected at least one observation with rows and without `judge = true`"
    )]
    NothingToFit,
    /// Rows are further from the nominal machine than machines miss.
    #[error("{}", far_files(files))]
    FarRows { files: Vec<FarFile> },
    /// After the fit the residuals of a file are larger than machines miss.
    #[error(
        "{}: after the fit {typical_mm:.2} mm is left of the rows of this file, most at this row, expected at most {limit_mm} mm: did a zero, a sphere or the instrument move between two rows, or do the unknowns not describe the machine?",
        at(file, *line)
    )]
    Unexplained {
        file: String,
        line: usize,
        typical_mm: f64,
        limit_mm: f64,
    },
    /// The frame of a tracker is not determined.
    #[error(
        "{frame}: the frame cannot be found, {direction} is not determined by {rows} rows: expected at least three targets that are not on one line"
    )]
    Frame {
        frame: String,
        direction: String,
        rows: usize,
    },
    /// The search did not come to an end.
    #[error(
        "the search did not converge in {steps} steps; the last step was {last:.1} standard uncertainties. There are {numbers} numbers for {unknowns} unknowns, of which they determine {rank}: expected more poses if these are few, else observations that the unknowns can explain"
    )]
    NotConverged {
        steps: usize,
        last: f64,
        numbers: usize,
        unknowns: usize,
        rank: usize,
    },
}

/// A file with rows that are further from the nominal machine than machines miss.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{}: this row is {largest_mm:.1} mm from where the nominal machine would be, expected at most {limit_mm} mm ({rows} of {of} rows are further, median {typical_mm:.1} mm): do the machine file and the columns describe the machine that was measured (structure, points of the rotary axes, directions, units, tool, sphere)?",
    at(file, *line)
)]
#[expect(missing_docs, reason = "the message says what the fields are")]
pub struct FarFile {
    pub file: String,
    /// The line of the row that is furthest away, from 1.
    pub line: usize,
    pub rows: usize,
    pub of: usize,
    /// The median of the distances of those that are too far away.
    pub typical_mm: f64,
    pub largest_mm: f64,
    pub limit_mm: f64,
}

/// A row in messages: its file and line, and the file alone where a row has no line.
pub(crate) fn at(file: &str, line: usize) -> String {
    match line {
        0 => file.to_owned(),
        _ => format!("{file}:{line}"),
    }
}

/// The files in words, not too many.
fn far_files(files: &[FarFile]) -> String {
    const SHOWN: usize = 5;
    let mut words: Vec<String> = files.iter().take(SHOWN).map(ToString::to_string).collect();
    if files.len() > SHOWN {
        words.push(format!("and {} more files", files.len() - SHOWN));
    }
    words.join("\n")
}
