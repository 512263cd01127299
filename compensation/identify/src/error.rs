use volcomp_curve::CurveError;
use volcomp_document::{InputError, ReadError};
use volcomp_model::ModelError;

/// Reason why observations cannot be identified.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum IdentifyError {
    /// A file could not be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Invalid entry in a file.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Invalid machine file, or a machine that cannot have an identified error.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// No curve can be built from the identified coefficients.
    #[error("{error}: {source}")]
    Curve { error: volcomp_vocabulary::ErrorName, source: CurveError },
    /// A row refers to a missing part of the set-up; does not occur for observations read from a file.
    #[error(
        "{file}: line {line}: found number {found} of the set-up's {what}, expected less than {count}"
    )]
    NoSuchPlace { file: String, line: usize, what: &'static str, found: usize, count: usize },
    /// No equations can be formed from the observations; does not occur for observations read from a file.
    #[error("{place}: {why}")]
    Unusable { place: String, why: String },
    #[error("found a value of `{found}`, which is not an unknown, expected one of {known}")]
    NoSuchUnknown { found: String, known: String },
    #[error(
        "found a machine with the structure `{found}`, expected `{expected}` as in the observations"
    )]
    OtherStructure { found: String, expected: String },
    #[error(
        "found {numbers} numbers in {poses} poses for {unknowns} unknowns of the set-up and the machine, of which they determine at most {rank}: expected more poses, or fewer unknowns"
    )]
    TooFew { poses: usize, numbers: usize, unknowns: usize, rank: usize },
    #[error(
        "{target} cannot be distinguished from {with}, and the effect of tilts at the tip depends on it: measure the offset of the target from the tip with a ruler and state it as `target = [x, y, z]` with its standard uncertainty `target_within_mm`, or turn the tool with rotary axes"
    )]
    Target { target: String, with: String },
    #[error(
        "found {rows} rows that all have the same pose, expected different poses: a single pose contains no information about the errors of an axis"
    )]
    AllAlike { rows: usize },
    #[error(
        "the identification has other unknowns than the observations, expected the result of `identify` for these observations"
    )]
    OtherObservations,
    #[error("errors of the machine cannot follow {parameter}: {why}")]
    NotFollowing { parameter: String, why: &'static str },
    #[error(
        "found no rows to fit, expected at least one observation with rows and without `judge = true`"
    )]
    NothingToFit,
    /// Rows are further from the nominal machine than real machines deviate from it.
    #[error("{}", far_files(files))]
    FarRows { files: Vec<FarFile> },
    #[error(
        "{}: after the fit the residual of the rows of this file is {typical_mm:.2} mm, largest at this row, expected at most {limit_mm} mm: did a zero, a sphere or the instrument move between two rows, or do the unknowns not describe the machine?",
        at(file, *line)
    )]
    Unexplained { file: String, line: usize, typical_mm: f64, limit_mm: f64 },
    #[error(
        "{frame}: the frame cannot be determined, {direction} is not fixed by {rows} rows: expected at least three targets that are not on one line"
    )]
    Frame { frame: String, direction: String, rows: usize },
    #[error(
        "the search did not converge in {steps} steps; the last step was {last:.1} standard uncertainties. There are {numbers} numbers for {unknowns} unknowns, of which they determine {rank}: expected more poses if these are few, otherwise observations that the unknowns can explain"
    )]
    NotConverged { steps: usize, last: f64, numbers: usize, unknowns: usize, rank: usize },
}

/// A file with rows beyond the limit on the distance from the nominal machine.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{}: this row is {largest_mm:.1} mm from the nominal machine, expected at most {limit_mm} mm ({rows} of {of} rows are further, median {typical_mm:.1} mm): do the machine file and the columns describe the machine that was measured (structure, points of the rotary axes, directions, units, tool, sphere)?",
    at(file, *line)
)]
pub struct FarFile {
    pub file: String,
    /// Line of the furthest row, from 1.
    pub line: usize,
    pub rows: usize,
    pub of: usize,
    /// Median distance of the rows beyond the limit, mm.
    pub typical_mm: f64,
    pub largest_mm: f64,
    pub limit_mm: f64,
}

/// Location of a row for messages: file and line, or the file alone if the row has no line.
pub(crate) fn at(file: &str, line: usize) -> String {
    match line {
        0 => file.to_owned(),
        _ => format!("{file}:{line}"),
    }
}

fn far_files(files: &[FarFile]) -> String {
    const MAX_LISTED: usize = 5;
    let mut words: Vec<String> = files.iter().take(MAX_LISTED).map(ToString::to_string).collect();
    if files.len() > MAX_LISTED {
        words.push(format!("and {} more files", files.len() - MAX_LISTED));
    }
    words.join("\n")
}
