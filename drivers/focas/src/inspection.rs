//! What a control tells about itself when it is connected as a configuration says. Nothing is written.

use std::{
    thread,
    time::{Duration, Instant},
};

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
    /// Reports of the control's barrier with the times of their readings, two that are a second apart: how far the tick
    /// moved on between them tells how long a scan takes. Empty where the configuration has no barrier, or the control did
    /// not tell.
    pub reports: Vec<(Instant, Words)>,
}

/// How long the reading may take.
const READ_WITHIN: Duration = Duration::from_secs(2);

/// The time between two reports of a barrier.
const APART: Duration = Duration::from_secs(1);

/// Connects, makes every check that a correction makes before its first cycle, reads once, and ends. Nothing is written.
///
/// # Errors
/// The first check that fails: no connection, an axis that the control lacks, a parameter that says otherwise, a question
/// that it refuses.
pub fn inspect(config: &FocasConfig) -> Result<Inspection, FocasError> {
    config.describe()?;
    let mut link = Link::open(config)?;
    let mut found = link.found().clone();
    let mut read = || {
        let snapshot = link.read(Instant::now() + READ_WITHIN).ok()?;
        Some((snapshot.taken, snapshot.report?))
    };
    found.reports.extend(read());
    if !found.reports.is_empty() {
        thread::sleep(APART);
        found.reports.extend(read());
    }
    Ok(found)
}
