//! Which errors a machine can have: the rules by which an error motion or a location error is refused.

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_kinematics::Joint;
use volcomp_vocabulary::ErrorName;

use crate::error::ErrorRefusal;

/// Why a location error is refused.
pub(crate) fn location_refusal(name: ErrorName, value: f64, joint: &Joint) -> Option<ErrorRefusal> {
    if !name.location {
        return Some(ErrorRefusal::ErrorMotion);
    }
    if !value.is_finite() {
        return Some(ErrorRefusal::NotFinite);
    }
    joint.no_effect(name.component).map(ErrorRefusal::NoEffect)
}

/// Why the curve of an error motion is refused on a machine with so many axes; `goes_round`: the axis has a
/// `modulo`.
pub(crate) fn curve_refusal(
    name: ErrorName,
    curve: &ErrorCurve,
    axes: usize,
    goes_round: bool,
) -> Option<ErrorRefusal> {
    if name.location {
        return Some(ErrorRefusal::CurveOfLocation);
    }
    if !curve.is_finite() {
        return Some(ErrorRefusal::NotFinite);
    }
    curve.fields().find_map(|field| match field {
        Field::Grid(grid) => {
            let missing = grid.axes().into_iter().find(|&axis| axis >= axes);
            missing.map(|axis| ErrorRefusal::GridAxis { axis, axes })
        }
        Field::Curve(curve) if goes_round => open_ends(curve),
        Field::Curve(_) => None,
    })
}

/// On an axis that goes round, a curve given by nodes must close.
fn open_ends(curve: &Curve) -> Option<ErrorRefusal> {
    let nodes = match curve {
        Curve::Table(table) => table.nodes(),
        Curve::MovingLeastSquares(mls) => mls.nodes(),
        _ => return None,
    };
    let (first, last) = (nodes.first()?[1], nodes.last()?[1]);
    ((first - last).abs() > 1e-9).then_some(ErrorRefusal::NotClosed { first, last })
}
