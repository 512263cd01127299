//! HEIDENHAIN TNC 640: .com and .cma.

mod tnc640;
mod turn;
mod write;

use volcomp_vocabulary::AxisName;

use super::{ExchangeError, LineError, TextFile};

pub(crate) use tnc640::read_tnc640;
pub(crate) use write::write_tnc640;

/// Lines of a table.
const MOST_LINES: usize = 256;
/// Decimals of mm and deg, as in the files that are known.
const DECIMALS: usize = 4;
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
