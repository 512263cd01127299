//! The reasons why nothing can be identified.

use volcomp_curve::CurveError;
use volcomp_document::{InputError, ReadError};
use volcomp_model::ModelError;

/// Why observations do not make a machine.
#[derive(Debug, thiserror::Error)]
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
        /// The error that is to be found.
        error: volcomp_vocabulary::ErrorName,
        /// Why the curve cannot be built.
        source: CurveError,
    },
    /// A row speaks of a part of the set-up that is not there; a file that was read has none of these.
    #[error(
        "{file}: line {line}: found number {found} of the set-up's {what}, expected less than {count}"
    )]
    NoSuchPlace {
        /// The row file.
        file: String,
        /// The line in it, from 1.
        line: usize,
        /// `frames`, `points` or `numbers` of the set-up.
        what: &'static str,
        /// The place that the row states, from 0.
        found: usize,
        /// How many there are.
        count: usize,
    },
    /// Observations hold something of which no equations can be made; a file that was read has none of this.
    #[error("{place}: {why}")]
    Unusable {
        /// The row, the unknown or the part of the set-up.
        place: String,
        /// What was found and expected.
        why: String,
    },
    /// A value is given for something that is not unknown.
    #[error("found a value of `{found}`, which is none of the unknowns, expected one of {known}")]
    NoSuchUnknown {
        /// The name that was given.
        found: String,
        /// The names of the unknowns.
        known: String,
    },
    /// Known errors are those of a machine that is built otherwise.
    #[error(
        "found a machine with the structure `{found}`, expected `{expected}` as in the observations"
    )]
    OtherStructure {
        /// The structure of the machine.
        found: String,
        /// That of the machine of the observations.
        expected: String,
    },
    /// There are fewer numbers than unknowns.
    #[error(
        "found {numbers} numbers in {poses} poses for {unknowns} unknowns of the set-up and the machine, of which they determine {rank} at the most: expected more poses, or fewer unknowns"
    )]
    TooFew {
        /// How many poses there are.
        poses: usize,
        /// How many numbers were observed.
        numbers: usize,
        /// How many unknowns there are.
        unknowns: usize,
        /// How many of them the poses determine.
        rank: usize,
    },
    /// The lever of a target at which tilts act is not determined.
    #[error(
        "{target} cannot be told apart from {with}, and what tilts do at the tip depends on it: measure with a ruler where the target is from the tip and state it, `target = [x, y, z]` with its standard uncertainty `target_within_mm`, or turn the tool with rotary axes"
    )]
    Target {
        /// The target.
        target: String,
        /// What it cannot be told apart from.
        with: String,
    },
    /// The machine stood at the same place in all rows.
    #[error(
        "found {rows} rows that all stand at the same pose, expected poses that differ: one pose says nothing of the errors of an axis"
    )]
    AllAlike {
        /// How many rows there are.
        rows: usize,
    },
    /// What was found belongs to other observations.
    #[error(
        "what was found has other unknowns than the observations, expected what `identify` found of these observations"
    )]
    OtherObservations,
    /// Errors cannot follow an unknown like this.
    #[error("errors of the machine cannot follow {parameter}: {why}")]
    NotFollowing {
        /// The unknown.
        parameter: String,
        /// What is wrong.
        why: &'static str,
    },
    /// No row is there to be fitted.
    #[error(
        "found no rows to fit, expected at least one observation with rows and without `judge = true`"
    )]
    NothingToFit,
    /// Rows are further from the nominal machine than machines miss.
    #[error("{}", far_files(files))]
    FarRows {
        /// The files that they are in, the worst first.
        files: Vec<FarFile>,
    },
    /// After the fit the residuals of a file are larger than machines miss.
    #[error(
        "{}: after the fit {typical_mm:.2} mm is left of the rows of this file, most at this row, expected at most {limit_mm} mm: did a zero, a sphere or the instrument move between two rows, or do the unknowns not describe the machine?",
        at(file, *line)
    )]
    Unexplained {
        /// The row file.
        file: String,
        /// The line of the row with the largest residual, from 1.
        line: usize,
        /// The RMS residual; with robust weights the median.
        typical_mm: f64,
        /// How large it may be.
        limit_mm: f64,
    },
    /// The frame of a tracker is not determined.
    #[error(
        "{frame}: the frame cannot be found, {direction} is not determined by {rows} rows: expected at least three targets that are not on one line"
    )]
    Frame {
        /// The name of the frame.
        frame: String,
        /// What of it is not determined.
        direction: String,
        /// How many rows see from it.
        rows: usize,
    },
    /// The search did not come to an end.
    #[error(
        "the search did not converge in {steps} steps; the last step was {last:.1} standard uncertainties. There are {numbers} numbers for {unknowns} unknowns, of which they determine {rank}: expected more poses if these are few, else observations that the unknowns can explain"
    )]
    NotConverged {
        /// How many steps were taken.
        steps: usize,
        /// The largest last step, in standard uncertainties.
        last: f64,
        /// How many numbers were observed.
        numbers: usize,
        /// How many unknowns there are.
        unknowns: usize,
        /// How many of them the numbers determine.
        rank: usize,
    },
}

/// A file with rows that are further from the nominal machine than machines miss.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{}: this row is {largest_mm:.1} mm from where the nominal machine would be, expected at most {limit_mm} mm ({rows} of {of} rows are further, median {typical_mm:.1} mm): do the machine file and the columns describe the machine that was measured (structure, points of the rotary axes, directions, units, tool, sphere)?",
    at(file, *line)
)]
pub struct FarFile {
    /// The row file.
    pub file: String,
    /// The line of the row that is furthest away, from 1.
    pub line: usize,
    /// How many rows are too far away.
    pub rows: usize,
    /// Of how many.
    pub of: usize,
    /// The median of the distances of those that are too far away.
    pub typical_mm: f64,
    /// The distance of the row that is furthest away.
    pub largest_mm: f64,
    /// How far they may be.
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
