//! Positions outside the range of the model, and remarks on the rows of a table.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::State;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::table::folded;

/// Errors and axes whose range the position exceeds.
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
    Outside { outside_range: machine.outside_range(state), outside_travel }
}

impl Outside {
    /// True if the position is within all ranges and travels.
    pub(crate) fn is_empty(&self) -> bool {
        self.outside_range.is_empty() && self.outside_travel.is_empty()
    }

    /// Text such as `outside travel Z, range EZY EZZ`; empty if the position is within all ranges and travels.
    pub(crate) fn words(&self) -> String {
        let parts =
            [("travel", joined(&self.outside_travel)), ("range", joined(&self.outside_range))];
        let said = parts.into_iter().filter(|(_, names)| !names.is_empty());
        let said: Vec<String> = said.map(|(of, names)| format!("{of} {names}")).collect();
        if said.is_empty() {
            return String::new();
        }
        format!("outside {}", said.join(", "))
    }
}

/// Note that `count` positions are outside the range of the model; `None` if `count` is 0.
pub(super) fn outside_note(count: usize) -> Option<String> {
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

/// The remarks on the rows of a table, printed below the table. Rows with the same remark are grouped, in the order of
/// first occurrence.
#[derive(Default)]
pub(crate) struct Remarks(Vec<(String, Vec<[usize; 2]>)>);

impl Remarks {
    /// Adds the remark on a row. An empty text is no remark.
    pub(crate) fn add(&mut self, row: usize, remark: String) {
        if remark.is_empty() {
            return;
        }
        match self.0.iter_mut().find(|(known, _)| *known == remark) {
            Some((_, runs)) => match runs.last_mut() {
                Some([_, last]) if *last + 1 == row => *last = row,
                _ => runs.push([row, row]),
            },
            None => self.0.push((remark, vec![[row, row]])),
        }
    }

    /// The lines below the table; empty if there are no remarks.
    pub(crate) fn text(&self) -> String {
        let lines = self.0.iter().map(|(remark, runs)| {
            let plural =
                if matches!(runs[..], [[first, last]] if first == last) { "" } else { "s" };
            folded(&format!("row{plural} {}: {remark}", ranges(runs)), " ")
        });
        let lines: String = lines.collect();
        if lines.is_empty() {
            return lines;
        }
        format!("\n{lines}")
    }
}

/// Formats runs of consecutive numbers, each given by its first and last number: `1, 3-7`.
fn ranges(runs: &[[usize; 2]]) -> String {
    let runs = runs.iter().map(|[first, last]| match last - first {
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
        let text = |rows: &[&str]| {
            let mut remarks = Remarks::default();
            for (row, remark) in (1..).zip(rows) {
                remarks.add(row, (*remark).to_owned());
            }
            remarks.text()
        };
        assert_eq!(
            text(&["", "a", "a", "a", "b", "", "a", "b", "b"]),
            "\n rows 2-4, 7: a\n rows 5, 8, 9: b\n"
        );
        assert_eq!(text(&["", "", "c"]), "\n row 3: c\n");
        assert_eq!(text(&["", ""]), "");
    }
}
