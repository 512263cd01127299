//! Validity rules for error motions and location errors.

use volcomp_curve::{Curve, ErrorCurve, Field, Grid};
use volcomp_document::LARGEST_NUMBER;
use volcomp_kinematics::Joint;
use volcomp_vocabulary::{ErrorName, brought_into};

use crate::{axis::Axis, error::ErrorRefusal};

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
