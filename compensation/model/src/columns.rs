//! Column headers of tables of axis coordinates.

use volcomp_document::{split_head, unit_named};
use volcomp_vocabulary::AxisName;

/// The axis that a column header names: its letter, alone or with the unit of the coordinates: `X`, `X mm`, `X_mm`, `C [deg]`, `C°`. Case
/// matters: `x` is not an axis.
pub fn axis_of_head(head: &str) -> Option<AxisName> {
    let (name, unit) = split_head(head);
    let axis: AxisName = name.parse().ok()?;
    let is_own = unit_named(unit) == Some(axis.kind().coordinate_unit());
    (head == name || is_own).then_some(axis)
}
