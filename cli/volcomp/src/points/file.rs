//! Positions from a CSV file, which may have other columns too.

use std::path::Path;

use volcomp_document::{Column, CsvTable, InputError, read_text, split_head, unit_named};
use volcomp_kinematics::State;
use volcomp_model::{Machine, axis_of_head};
use volcomp_vocabulary::AxisName;

use crate::failure::Failure;

/// A table of positions: one state for each row.
pub(crate) struct PointFile {
    pub(crate) table: CsvTable,
    pub(super) states: Vec<State>,
    /// The axes whose coordinates stand in a column.
    pub(super) axes: Vec<AxisName>,
}

/// What stands behind the letter of an axis in the columns that `volcomp correct` adds.
const OF_A_CORRECTION: [&str; 4] = [
    "_corrected_mm",
    "_corrected_deg",
    "_correction_um",
    "_correction_urad",
];

/// The head of a column by what stands in it.
#[derive(Debug, PartialEq, Eq)]
enum Head<'a> {
    /// Coordinates of an axis, mm or deg.
    Coordinates(AxisName),
    /// A letter with a unit that its coordinates are not read in.
    OtherUnit(AxisName, &'a str),
    /// A letter and something that is no unit known here: positions in an unknown unit, or no positions at all.
    Unclear(AxisName),
    /// A column that is no position.
    Other,
}

impl PointFile {
    /// Reads a file whose header has axis letters, one position a row.
    pub(super) fn read(machine: &Machine, path: &Path) -> Result<Self, Failure> {
        let table = CsvTable::parse(&path.display().to_string(), &read_text(path)?)?;
        let columns = coordinates(&table, machine)?;
        for &(name, _) in &columns {
            machine
                .index_of(name)
                .map_err(|e| table.header_error(e.to_string()))?;
        }
        let mut states = Vec::new();
        for row in table.rows() {
            let mut coordinates = Vec::new();
            for &(name, column) in &columns {
                coordinates.push((name, row.cell(column).number()?));
            }
            states.push(machine.state(&coordinates)?);
        }
        Ok(Self {
            axes: columns.into_iter().map(|(name, _)| name).collect(),
            states,
            table,
        })
    }
}

/// The column of each axis that the header names. Beside `X` a column `x` is another quantity, as in files of targets.
///
/// An axis of the machine whose letter heads a column in another or an unknown unit, and no column with positions, is
/// an error: it must not silently stand at 0.
fn coordinates(table: &CsvTable, machine: &Machine) -> Result<Vec<(AxisName, Column)>, InputError> {
    let is_small = |text: &str| text.starts_with(|letter: char| letter.is_ascii_lowercase());
    let mut found: Vec<(AxisName, Column, &str)> = Vec::new();
    for (column, text) in table.names() {
        if let Head::Coordinates(name) = head(text) {
            found.push((name, column, text));
        }
    }
    let has_large: Vec<AxisName> = found
        .iter()
        .filter(|(_, _, text)| !is_small(text))
        .map(|(name, _, _)| *name)
        .collect();
    found.retain(|(name, _, text)| !(is_small(text) && has_large.contains(name)));
    let mut columns: Vec<(AxisName, Column)> = Vec::new();
    for (place, &(name, column, text)) in found.iter().enumerate() {
        if let Some((_, _, first)) = found[..place].iter().find(|(axis, _, _)| *axis == name) {
            return Err(table.header_error(if *first == text {
                format!("column `{text}` stands twice")
            } else {
                format!(
                    "found columns `{first}` and `{text}`, expected one with positions of {name}"
                )
            }));
        }
        columns.push((name, column));
    }
    for (_, text) in table.names() {
        let (name, in_unit) = match head(text) {
            Head::OtherUnit(name, unit) => (name, format!(" with the unit `{unit}`")),
            Head::Unclear(name) if machine.axis(name).is_some() => (name, String::new()),
            _ => continue,
        };
        if columns.iter().all(|(axis, _)| *axis != name) {
            let expected = name.kind().coordinate_unit();
            return Err(table.header_error(format!(
                "found column `{text}`{in_unit}, expected positions of {name} in {expected}: {name} or {name}_{expected}"
            )));
        }
    }
    if columns.is_empty() {
        let expected = "found no axis letter, expected at least one of X Y Z A B C U V W, alone or with its unit: X, X mm, X_mm, C_deg";
        return Err(table.header_error(expected));
    }
    Ok(columns)
}

/// Reads a head: a letter in upper or lower case, alone or with a unit behind a blank or a mark: `X`, `X mm`, `x_mm`,
/// `X [mm]`, `C (deg)`.
fn head(text: &str) -> Head<'_> {
    let mut letters = text.chars();
    let first = letters.next().map(|letter| letter.to_ascii_uppercase());
    let (Some(name), rest) = (first.and_then(AxisName::from_letter), letters.as_str()) else {
        return Head::Other;
    };
    let unit = split_head(text).1;
    // A letter that goes on into a word is no axis: `Zone`, `amount`.
    let is_word = rest.starts_with(char::is_alphabetic);
    if is_word || OF_A_CORRECTION.contains(&rest) {
        Head::Other
    } else if axis_of_head(&format!("{name}{rest}")) == Some(name) {
        Head::Coordinates(name)
    } else if unit_named(unit).is_some() {
        Head::OtherUnit(name, unit)
    } else {
        Head::Unclear(name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_letters_alone_or_with_their_unit() {
        let (x, c) = (AxisName::X, AxisName::C);
        for text in [
            "X", "x", "X mm", "X_mm", "x [mm]", "X (MM)", "X/mm", "X, mm",
        ] {
            assert_eq!(head(text), Head::Coordinates(x), "{text}");
        }
        for text in ["C", "C deg", "C_deg", "c [°]", "C°"] {
            assert_eq!(head(text), Head::Coordinates(c), "{text}");
        }
        for (text, name, unit) in [
            ("X in", x, "in"),
            ("X_um", x, "um"),
            ("X [µm]", x, "µm"),
            ("C rad", c, "rad"),
            ("C_mm", c, "mm"),
            ("X deg", x, "deg"),
        ] {
            assert_eq!(head(text), Head::OtherUnit(name, unit), "{text}");
        }
        for text in [
            "X_inches",
            "X_mil",
            "X(thou)",
            "X [dm]",
            "X 1/1000in",
            "X:",
            "X'",
            "X1",
            "X#mm",
            "X remark",
            "X_corrected_in",
        ] {
            assert_eq!(head(text), Head::Unclear(x), "{text}");
        }
        for text in [
            "",
            "N",
            "Xmm",
            "Zone",
            "amount",
            "X_corrected_mm",
            "X_correction_um",
            "error_x_um",
            "uncertainty_x_um",
            "µ",
        ] {
            assert_eq!(head(text), Head::Other, "{text}");
        }
    }
}
