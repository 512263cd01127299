//! Column heads, which are a name alone, or a name followed by a unit.

use volcomp_document::{Column, CsvTable, quoted, split_head};

use volcomp_vocabulary::Direction;

use crate::MetrologyError;

/// Unit in a head with this name, such as `target mm`, `target_mm` or `deviation [µm]`; empty for the name alone.
/// `None` if the head has another name.
pub(crate) fn unit_of<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    let (found, unit) = split_head(head);
    found.eq_ignore_ascii_case(name).then_some(unit)
}

/// The column with this name, alone or followed by a unit, and its unit. Errors: two such columns.
pub(crate) fn with_unit<'t>(
    table: &'t CsvTable,
    name: &str,
) -> Result<Option<(Column, &'t str)>, MetrologyError> {
    one_column(table, name, |head| unit_of(head, name))
}

/// The column for whose head `unit` returns a unit (possibly empty), and this unit; `None` if there is no such column.
/// Errors: two such columns.
pub(crate) fn one_column<'t>(
    table: &'t CsvTable,
    name: &str,
    unit: impl Fn(&'t str) -> Option<&'t str>,
) -> Result<Option<(Column, &'t str)>, MetrologyError> {
    let mut named = table.names().filter_map(|(column, head)| Some((column, unit(head)?)));
    let first = named.next();
    if named.next().is_some() {
        let message = format!("column `{name}` appears twice");
        return Err(table.header_error(message).into());
    }
    Ok(first)
}

/// Error for readings in inches with targets without a unit: the targets may be in inches or in mm.
pub(crate) fn inches_without_targets(table: &CsvTable) -> MetrologyError {
    let message = "found deviations in inches and targets without a unit, expected `target inch`, `target mm` or `target deg`";
    table.header_error(message).into()
}

pub(crate) fn heads(table: &CsvTable) -> String {
    let heads: Vec<&str> = table.names().map(|(_, name)| name).collect();
    quoted(&heads.join(&table.separator().to_string()))
}

pub(crate) fn not_read(names: &[&str]) -> Option<String> {
    (!names.is_empty()).then(|| format!("columns that are not read: {}", names.join(", ")))
}

/// Direction of approach by any of its usual words, case-insensitive.
pub(crate) fn direction_named(text: &str) -> Option<Direction> {
    match text.to_lowercase().as_str() {
        "+" | "+1" | "1" | "f" | "fw" | "fwd" | "forward" | "forwards" | "pos" | "positive"
        | "up" | "↑" => Some(Direction::Positive),
        "-" | "−" | "-1" | "r" | "b" | "rev" | "reverse" | "bw" | "bwd" | "back" | "backward"
        | "backwards" | "neg" | "negative" | "down" | "↓" => Some(Direction::Negative),
        _ => None,
    }
}
