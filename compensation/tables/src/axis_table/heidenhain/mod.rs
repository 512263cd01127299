//! HEIDENHAIN: .com and .cma of the TNC 640, .COM of the iTNC 530.

mod itnc530;
mod tnc640;
mod turn;
mod write;

use volcomp_vocabulary::AxisName;

use super::{ExchangeError, LineError, TextFile};

pub(crate) use itnc530::read_itnc530;
pub(crate) use tnc640::read_tnc640;
pub(crate) use write::{write_itnc530, write_tnc640};

/// Lines of a table.
const MOST_LINES: usize = 256;
/// Decimals of mm and deg, as in the files that are known.
const DECIMALS: usize = 4;
/// A TNC 407 counts in 0.1 µm, mm.
const STEP_OF_TNC407_MM: f64 = 1e-4;

/// The exponent n where a spacing is 2^n × 0.1 µm; `None` where it is none that a TNC 407 takes.
pub fn steps_of_tnc407(spacing_mm: f64) -> Option<u32> {
    (0..31).find(|n| (spacing_mm - STEP_OF_TNC407_MM * f64::from(1_u32 << n)).abs() < 1e-9)
}

/// Why a TNC 407 refuses a spacing, in words that name the nearest that it takes; `None` where it takes it.
pub fn spacing_refused_by_tnc407(spacing_mm: f64) -> Option<String> {
    if steps_of_tnc407(spacing_mm).is_some() {
        return None;
    }
    let at = |n: u32| STEP_OF_TNC407_MM * f64::from(1_u32 << n);
    let above = (0..31).find(|n| at(*n) > spacing_mm).unwrap_or(30);
    let below = above.saturating_sub(1);
    Some(format!(
        "a power of two times 0.1 µm: {} or {}",
        at(below),
        at(above)
    ))
}

/// The lines of a file without those that are empty, with their numbers.
fn lines(file: &TextFile) -> impl Iterator<Item = (usize, &str)> {
    let lines = file.text.lines().enumerate();
    lines
        .map(|(index, line)| (index + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty())
}

/// `AXIS_X.COM`, `AXIS-X.COM`: the letter.
fn axis_in(name: &str) -> Option<AxisName> {
    let stem = name.split('.').next()?.to_ascii_uppercase();
    stem.rsplit(['_', '-']).next()?.parse().ok()
}

/// The word behind BEGIN.
fn begin<'a>(
    file: &'a TextFile,
    line: Option<&(usize, &'a str)>,
) -> Result<&'a str, ExchangeError> {
    let found = line.map_or("", |(_, text)| *text);
    let name = found
        .strip_prefix("BEGIN ")
        .and_then(|rest| rest.split_whitespace().next());
    name.ok_or_else(|| {
        let number = line.map_or(1, |(number, _)| *number);
        LineError::at(
            file,
            number,
            volcomp_document::quoted(found),
            "BEGIN and the name of the table",
        )
    })
}

/// A table of a rotary axis over 0 to 360 deg repeats.
fn is_turn(axis: AxisName, positions: &[f64]) -> bool {
    let length = positions
        .last()
        .zip(positions.first())
        .map_or(0.0, |(last, first)| last - first);
    axis.is_rotary() && (length - core::f64::consts::TAU).abs() < 1e-6
}
