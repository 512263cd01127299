//! The columns of tables with coordinates of axes.

use volcomp_document::{split_head, unit_named};
use volcomp_vocabulary::AxisName;

/// The axis whose coordinates stand under a head: its letter, alone or with the unit in which coordinates are read: `X`, `X mm`,
/// `X_mm`, `C [deg]`, `C°`. Letters count as they are written: `x` is no axis.
pub fn axis_of_head(head: &str) -> Option<AxisName> {
    let (name, unit) = split_head(head);
    let axis: AxisName = name.parse().ok()?;
    let is_own = unit_named(unit) == Some(axis.kind().coordinate_unit());
    (head == name || is_own).then_some(axis)
}
