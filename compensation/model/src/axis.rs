//! The axes and tools of a machine, and the rules for the errors that an axis may have.

use volcomp_curve::{Curve, ErrorCurve, Field, Grid};
use volcomp_document::{LARGEST_NUMBER, split_head, unit_named};
use volcomp_kinematics::{Joint, MotionFrame, nalgebra::Vector3};
use volcomp_vocabulary::{AxisName, ErrorName, brought_into, is_within};

use crate::error::ErrorRefusal;

/// One axis as defined in the machine file.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Axis {
    pub name: AxisName,
    /// Lower and upper end of travel, mm (linear) or deg (rotary).
    pub travel: [f64; 2],
    /// Period of a rotary axis, deg: coordinates are moved into the travel by whole periods before curves are evaluated. `None`: no reduction.
    pub modulo: Option<f64>,
    /// Direction of positive motion of the tool relative to the workpiece, in the machine coordinate system at machine zero; not
    /// necessarily a unit vector. `None`: the direction of the letter.
    pub direction: Option<[f64; 3]>,
    /// A point on the axis line (rotary), or the point of the carriage to which its errors apply (linear), mm in the machine coordinate
    /// system at machine zero; `None`: the origin.
    pub point_mm: Option<[f64; 3]>,
    /// The frame of the error motions of a rotary axis. The error motions of a linear axis are in the non-rotating
    /// frame and move with the carriage.
    pub motion_frame: MotionFrame,
}

impl Axis {
    /// The coordinate at which curves are evaluated, mm or deg: `coordinate` moved into the travel by whole periods of
    /// `modulo`; unchanged without `modulo`.
    pub(crate) fn looked_up(&self, coordinate: f64) -> f64 {
        match self.modulo {
            Some(period) => brought_into(self.travel, period, coordinate),
            None => coordinate,
        }
    }

    /// The travel converted from radians to deg, if it looks as if it had been entered in radians. `Some` only for a
    /// rotary axis: both ends, read as radians, are common fractions of a turn rounded to a few digits (3.14, 1.571,
    /// 6.2832), and at least one end is not 0.
    pub fn travel_as_if_in_radians(&self) -> Option<[f64; 2]> {
        // Common angles, deg. The tolerance below admits π rounded to 3.14, which is 0.05 % too small.
        const USUAL: [f64; 13] =
            [0.0, 30.0, 45.0, 60.0, 90.0, 120.0, 135.0, 150.0, 180.0, 210.0, 240.0, 270.0, 360.0];
        let usual = |end: f64| {
            let deg = end.to_degrees();
            let near = |usual: &&f64| (deg.abs() - **usual).abs() <= 6e-4 * **usual;
            USUAL.iter().find(near).map(|usual| usual.copysign(deg))
        };
        if !self.name.is_rotary() {
            return None;
        }
        let [low, high] = self.travel;
        Some([usual(low)?, usual(high)?])
    }

    /// Whether the travel of a rotary axis is at least 359 deg: a full turn, which controls also describe as 0 to 359.999 deg.
    pub fn turns_round(&self) -> bool {
        const NEARLY_DEG: f64 = 359.0;
        self.name.is_rotary() && self.travel[1] - self.travel[0] >= NEARLY_DEG
    }

    /// Whether the travel has ends: the axis has no `modulo`, and its travel is less than a full turn.
    pub fn has_ends(&self) -> bool {
        self.modulo.is_none() && !self.turns_round()
    }

    /// The part of the travel, mm or deg, that covers every pose of the axis: for a full turn or more, one turn about the middle of the
    /// travel, otherwise the whole travel.
    pub fn all_poses(&self) -> [f64; 2] {
        let [low, high] = self.travel;
        if self.turns_round() {
            let middle = 0.5 * (low + high);
            return [middle - 180.0, middle + 180.0];
        }
        [low, high]
    }

    /// `count` evenly spaced coordinates over the travel for a grid of poses, mm or deg, including both ends; a count
    /// of 1 gives the middle. For a travel of a full turn or more, the coordinates cover one turn. Its end is omitted,
    /// because that is the same pose as its start.
    pub fn nodes(&self, count: usize) -> Vec<f64> {
        let [low, high] = self.all_poses();
        if count == 1 {
            return vec![0.5 * (low + high)];
        }
        let parts = if self.turns_round() { count } else { count.saturating_sub(1) };
        let node = |place: usize| low + (high - low) * place as f64 / parts as f64;
        (0..count).map(node).collect()
    }

    /// 0, or the end of travel nearest to it, mm or deg.
    pub fn nearest_zero(&self) -> f64 {
        let [low, high] = self.travel;
        0.0_f64.max(low).min(high)
    }

    /// Distance of a coordinate beyond the travel, mm or deg, after reduction by `modulo`; negative within the travel.
    pub fn beyond_travel(&self, coordinate: f64) -> f64 {
        let [low, high] = self.travel;
        let at = self.looked_up(coordinate);
        (low - at).max(at - high)
    }

    /// Whether a coordinate, mm or deg, is within the travel, with a tolerance for rounding.
    pub fn contains(&self, coordinate: f64) -> bool {
        is_within(self.travel, coordinate)
    }

    /// Whether the axis can be at a coordinate, mm or deg: within the travel after reduction by `modulo`, with a tolerance for rounding.
    pub fn may_stand_at(&self, coordinate: f64) -> bool {
        self.contains(self.looked_up(coordinate))
    }

    /// Checks that the axis can be at a coordinate, mm or deg.
    ///
    /// # Errors
    /// A message that starts with "found" and names the coordinate, its unit and the travel.
    pub fn check_coordinate(&self, coordinate: f64) -> Result<(), String> {
        if self.may_stand_at(coordinate) {
            return Ok(());
        }
        let ([low, high], unit) = (self.travel, self.name.kind().coordinate_unit());
        Err(format!(
            "found {coordinate} {unit}, expected a position within the travel of {}, {low} to {high} {unit}",
            self.name
        ))
    }
}

/// The axis in a column header: its letter, alone or with the unit of the coordinates: `X`, `X mm`, `X_mm`, `C [deg]`, `C°`. `None` for other
/// headers. Case matters: `x` is not an axis.
pub fn axis_of_head(head: &str) -> Option<AxisName> {
    let (name, unit) = split_head(head);
    let axis: AxisName = name.parse().ok()?;
    let is_own = unit_named(unit) == Some(axis.kind().coordinate_unit());
    (head == name || is_own).then_some(axis)
}

/// A tool of the machine file. Keys that are `None` come from `[tool]`, else from the default.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Tool {
    /// Tip of the tool, mm in the machine coordinate system at machine zero.
    pub tip_mm: Option<[f64; 3]>,
    /// Gauge point of the spindle, mm in the machine coordinate system at machine zero; alternative to `tip_mm`.
    pub gauge_mm: Option<[f64; 3]>,
    /// Length from the gauge point to the tip, mm.
    pub length_mm: Option<f64>,
    /// Offset added to the tip, mm in the machine coordinate system.
    pub offset_mm: Option<[f64; 3]>,
    /// Direction from the tip to the spindle, in the machine coordinate system at machine zero; not necessarily a unit vector.
    pub axis: Option<[f64; 3]>,
}

impl Tool {
    /// This tool, with missing keys taken from `base`.
    pub(crate) fn over(&self, base: &Self) -> Self {
        // A tip replaces the gauge point and its keys, and vice versa.
        let (keeps_tip, keeps_gauge) = (self.gauge_mm.is_none(), self.tip_mm.is_none());
        Self {
            tip_mm: self.tip_mm.or(base.tip_mm.filter(|_| keeps_tip)),
            gauge_mm: self.gauge_mm.or(base.gauge_mm.filter(|_| keeps_gauge)),
            length_mm: self.length_mm.or(base.length_mm.filter(|_| keeps_gauge)),
            offset_mm: self.offset_mm.or(base.offset_mm.filter(|_| keeps_gauge)),
            axis: self.axis.or(base.axis),
        }
    }

    /// Tip and axis: tip = gauge − length·axis + offset.
    pub(crate) fn tip_and_axis(&self) -> ([f64; 3], [f64; 3]) {
        let axis = self.axis.unwrap_or([0.0, 0.0, 1.0]);
        let Some(gauge) = self.gauge_mm else {
            return (self.tip_mm.unwrap_or_default(), axis);
        };
        let unit = Vector3::from(axis).try_normalize(0.0).unwrap_or_default();
        let tip = Vector3::from(gauge) - unit * self.length_mm.unwrap_or(0.0)
            + Vector3::from(self.offset_mm.unwrap_or_default());
        (tip.into(), axis)
    }
}

/// Maximum difference between the ends of a closed curve, µm or µrad, which allows for rounding.
const CLOSED_WITHIN: f64 = 1e-9;

/// Maximum jump of a curve at the roll-over of its axis, µm or µrad: one increment of most controls. Curves fitted to
/// readings do not close exactly, so a small jump is accepted.
const LARGEST_JUMP: f64 = 1.0;
/// Distance from an end of travel at which the values on its two sides are compared, deg.
const END_OFFSET_DEG: f64 = 1e-6;

/// Why a location error is rejected; `None` if it is valid.
pub(crate) fn location_refusal(name: ErrorName, value: f64, joint: &Joint) -> Option<ErrorRefusal> {
    if !name.location {
        return Some(ErrorRefusal::ErrorMotion);
    }
    if !is_number(value) {
        return Some(ErrorRefusal::NotFinite);
    }
    joint.no_effect(name.component).map(ErrorRefusal::NoEffect)
}

/// Why the curve of an error motion of the axis with index `own` is rejected on a machine with these axes; `None` if it is valid.
pub(crate) fn curve_refusal(
    name: ErrorName,
    curve: &ErrorCurve,
    own: usize,
    axes: &[Axis],
) -> Option<ErrorRefusal> {
    if name.location {
        return Some(ErrorRefusal::CurveOfLocation);
    }
    if !curve.is_finite() || !is_finite_within_travel(curve, own, axes) {
        return Some(ErrorRefusal::NotFinite);
    }
    let goes_round = |axis: usize| axes.get(axis).is_some_and(|axis| axis.modulo.is_some());
    curve.fields().find_map(|field| match field {
        Field::Grid(grid) => {
            let count = axes.len();
            let missing = grid.axes().into_iter().find(|&axis| axis >= count);
            let missing = missing.map(|axis| ErrorRefusal::GridAxis { axis, axes: count });
            missing.or_else(|| open_grid(grid, goes_round))
        }
        Field::Curve(curve) => axes.get(own).and_then(|axis| {
            let period = axis.modulo?;
            open_ends(curve).or_else(|| jump(curve, axis.travel, period))
        }),
    })
}

/// Whether a number is finite and within the bound for machine files, so that results computed from it stay finite.
pub(crate) fn is_number(value: f64) -> bool {
    value.abs() <= LARGEST_NUMBER
}

/// Whether the values at both ends of the travel are finite. Polynomials are largest there; other kinds of curve stay near their
/// coefficients.
fn is_finite_within_travel(curve: &ErrorCurve, own: usize, axes: &[Axis]) -> bool {
    let Some(axis) = axes.get(own) else {
        return true;
    };
    curve.fields().all(|field| match field {
        Field::Curve(curve) => axis.travel.iter().all(|end| is_number(curve.value(*end))),
        Field::Grid(_) => true,
    })
}

/// Refusal of a grid whose values differ at the two ends of an axis with `modulo`.
fn open_grid(grid: &Grid, goes_round: impl Fn(usize) -> bool) -> Option<ErrorRefusal> {
    let values = grid.values();
    let [rows, columns] = grid.axes().map(goes_round);
    let around_rows = values.first()?.iter().zip(values.last()?);
    let around_columns = values.iter().filter_map(|row| row.first().zip(row.last()));
    let ends = around_rows.filter(|_| rows).chain(around_columns.filter(|_| columns));
    ends.map(|(&first, &last)| [first, last]).find_map(not_closed)
}

/// The refusal if the first and the last value of a curve (µm or µrad) differ by more than `CLOSED_WITHIN`.
fn not_closed([first, last]: [f64; 2]) -> Option<ErrorRefusal> {
    ((first - last).abs() > CLOSED_WITHIN).then_some(ErrorRefusal::NotClosed { first, last })
}

/// Refusal of a curve that jumps by more than `LARGEST_JUMP` at the roll-over of its axis. The correction of a rotary
/// table positioned at the roll-over would switch back and forth with the last digit of its position.
fn jump(curve: &Curve, travel: [f64; 2], period: f64) -> Option<ErrorRefusal> {
    let [low, high] = travel;
    let value = |at: f64| curve.value(brought_into(travel, period, at));
    let ends = [[low - END_OFFSET_DEG, low], [high, high + END_OFFSET_DEG]];
    let across = ends.map(|sides| sides.map(value));
    let jumps = across.into_iter().find(|[one, other]| {
        let jump = (one - other).abs();
        // NaN is rejected as well.
        jump.is_nan() || jump > LARGEST_JUMP
    })?;
    Some(ErrorRefusal::Jumps { first: jumps[0], last: jumps[1], largest: LARGEST_JUMP })
}

/// Refusal of a curve given by nodes whose first and last value differ, for an axis with `modulo`.
fn open_ends(curve: &Curve) -> Option<ErrorRefusal> {
    let nodes = match curve {
        Curve::Table(table) => table.nodes(),
        Curve::MovingLeastSquares(mls) => mls.nodes(),
        _ => return None,
    };
    not_closed([nodes.first()?[1], nodes.last()?[1]])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(name: AxisName, travel: [f64; 2]) -> Axis {
        Axis {
            name,
            travel,
            modulo: None,
            direction: None,
            point_mm: None,
            motion_frame: MotionFrame::Fixed,
        }
    }

    /// A linear axis has ends at any length. A rotary travel of 0 to 359.999 deg is a full turn.
    #[test]
    fn what_turns_all_the_way_round_has_no_ends() {
        for (name, travel, modulo, has_ends) in [
            (AxisName::X, [0.0, 4000.0], None, true),
            (AxisName::C, [0.0, 350.0], None, true),
            (AxisName::C, [0.0, 350.0], Some(360.0), false),
            (AxisName::C, [0.0, 359.999], None, false),
            (AxisName::C, [-180.0, 180.0], None, false),
            (AxisName::A, [-3600.0, 3600.0], None, false),
        ] {
            let axis = Axis { modulo, ..axis(name, travel) };
            assert_eq!(axis.has_ends(), has_ends, "{axis:?}");
        }
    }

    /// All nodes are at different angles, even if the travel has several turns.
    #[test]
    fn nodes_of_several_turns_are_different_poses() {
        for turns in [1.0, 2.0, 4.0, 8.0, 100.0] {
            for travel in [[-360.0 * turns, 360.0 * turns], [0.0, 360.0 * turns]] {
                let mut nodes = axis(AxisName::C, travel).nodes(8);
                assert!(nodes.iter().all(|at| (travel[0]..=travel[1]).contains(at)));
                for at in &mut nodes {
                    *at = at.rem_euclid(360.0);
                }
                nodes.sort_by(f64::total_cmp);
                assert_eq!(nodes, [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]);
            }
        }
    }

    #[test]
    fn other_axes_have_nodes_from_end_to_end() {
        assert_eq!(axis(AxisName::X, [0.0, 600.0]).nodes(3), [0.0, 300.0, 600.0]);
        assert_eq!(axis(AxisName::A, [-100.0, 30.0]).nodes(2), [-100.0, 30.0]);
        assert_eq!(axis(AxisName::A, [-100.0, 30.0]).nodes(1), [-35.0]);
        assert_eq!(axis(AxisName::X, [0.0, 1.0]).nodes(0), [0.0; 0]);
    }
}
