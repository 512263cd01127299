//! What a control tells about itself when it is connected as a configuration says. Nothing is written.

use std::time::{Duration, Instant};

use volcomp_port::Words;

use crate::{
    config::FocasConfig, error::FocasError, link::Link, plan::Abilities, shift_source::ShiftSource,
};

/// What a control tells about itself when it is connected as a configuration says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Inspection {
    /// The version that the control answers with: 2, 3 or 4 by its generation.
    pub version: u16,
    /// The letters of the control's axes.
    pub axes: Vec<char>,
    /// From which words the control takes the shifts of the axes.
    pub shift_source: ShiftSource,
    /// In which form the control accepts the requests of a cycle.
    pub abilities: Abilities,
    /// What deserves to be known and is no error, in words.
    pub notes: Vec<String>,
    /// The report of the control's barrier as it was when the control was asked; `None` where the configuration has none,
    /// or the control did not tell.
    pub report: Option<Words>,
}

/// How long the reading may take.
const READ_WITHIN: Duration = Duration::from_secs(2);

/// Connects, makes every check that a correction makes before its first cycle, reads once, and ends. Nothing is written.
///
/// # Errors
/// The first check that fails: no connection, an axis that the control lacks, a parameter that says otherwise, a question
/// that it refuses.
pub fn inspect(config: &FocasConfig) -> Result<Inspection, FocasError> {
    config.describe()?;
    let mut link = Link::open(config)?;
    let mut found = link.found().clone();
    let read = link.read(Instant::now() + READ_WITHIN);
    found.report = read.ok().and_then(|snapshot| snapshot.report);
    Ok(found)
}
