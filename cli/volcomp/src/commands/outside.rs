//! Positions outside the range of the model, and remarks on rows as text.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::State;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::table::folded;

/// The errors and axes for which a position is outside of what the model covers.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Outside {
    /// Errors whose curves are evaluated outside their range, sorted by name.
    pub(crate) outside_range: Vec<ErrorName>,
    /// Axes outside their travel.
    pub(crate) outside_travel: Vec<AxisName>,
}

pub(super) fn outside(machine: &Machine, state: &State) -> Outside {
    let mut outside_travel = machine.outside_travel(state);
    outside_travel.sort_unstable();
    Outside {
        outside_range: machine.outside_range(state),
        outside_travel,
    }
}

impl Outside {
    /// Text such as `outside travel Z, range EZY EZZ`; empty if everything is within range.
    pub(super) fn words(&self) -> String {
        let parts = [
            ("travel", joined(&self.outside_travel)),
            ("range", joined(&self.outside_range)),
        ];
        let said = parts.into_iter().filter(|(_, names)| !names.is_empty());
        let said: Vec<String> = said.map(|(of, names)| format!("{of} {names}")).collect();
        if said.is_empty() {
            return String::new();
        }
        format!("outside {}", said.join(", "))
    }
}

pub(super) fn outside_note<'a>(outside: impl Iterator<Item = &'a Outside>) -> Option<String> {
    let count = outside.filter(|o| !o.words().is_empty()).count();
    let positions = match count {
        0 => return None,
        1 => "one position lies".to_owned(),
        more => format!("{more} positions lie"),
    };
    Some(format!(
        "{positions} beyond an axis's travel or an error's measured range: the errors there are those at the end of the range"
    ))
}

pub(crate) fn joined<T: ToString>(names: &[T]) -> String {
    let names: Vec<String> = names.iter().map(ToString::to_string).collect();
    names.join(" ")
}

/// The remarks on the rows of a table, printed below it: rows with the same remark are grouped, in the order of first occurrence. Empty
/// without remarks.
pub(super) fn remarks(rows: impl Iterator<Item = String>) -> String {
    let mut by_remark: Vec<(String, Vec<usize>)> = Vec::new();
    for (row, remark) in (1..).zip(rows).filter(|(_, remark)| !remark.is_empty()) {
        match by_remark.iter_mut().find(|(known, _)| *known == remark) {
            Some((_, rows)) => rows.push(row),
            None => by_remark.push((remark, vec![row])),
        }
    }
    let lines = by_remark.iter().map(|(remark, rows)| {
        let plural = if rows.len() == 1 { "" } else { "s" };
        folded(&format!("row{plural} {}: {remark}", ranges(rows)), " ")
    });
    let lines: String = lines.collect();
    if lines.is_empty() {
        return lines;
    }
    format!("\n{lines}")
}

/// Ascending numbers with consecutive ones joined, such as `1, 3-7`.
fn ranges(rows: &[usize]) -> String {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for &row in rows {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == row => *last = row,
            _ => runs.push((row, row)),
        }
    }
    let runs = runs.iter().map(|(first, last)| match last - first {
        0 => first.to_string(),
        1 => format!("{first}, {last}"),
        _ => format!("{first}-{last}"),
    });
    runs.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_with_one_remark_stand_together() {
        let rows = ["", "a", "a", "a", "b", "", "a", "b", "b"];
        assert_eq!(
            remarks(rows.into_iter().map(str::to_owned)),
            "\n rows 2-4, 7: a\n rows 5, 8, 9: b\n"
        );
        assert_eq!(
            remarks(["", "", "c"].into_iter().map(str::to_owned)),
            "\n row 3: c\n"
        );
        assert_eq!(remarks(["", ""].into_iter().map(str::to_owned)), "");
    }
}
