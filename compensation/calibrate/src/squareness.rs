//! Tilts of two axes that form a squareness, and the location errors by which a machine states it.

use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{AxisName, Component, ErrorName, Urad};

/// Sets a squareness as the tilt of one axis of its pair, and sets the tilt of the other axis to zero. The axis without
/// tilt is the primary reference axis if it belongs to the pair, else the secondary reference axis.
pub(crate) fn set_square(
    machine: &mut Machine,
    reference_axes: [AxisName; 2],
    error: ErrorName,
    value: Urad,
) -> Result<(), ModelError> {
    let (tilt, sign) = tilt_of(error, reference_axes);
    for name in [error, partner_tilt(error)] {
        let value = if name == tilt { sign * value.0 } else { 0.0 };
        // A zero tilt is set only to replace a value of the machine file.
        if value != 0.0 || name == error || machine.locations().contains_key(&name) {
            machine.set_location(name, value)?;
        }
    }
    Ok(())
}

/// The tilt by which a machine with these reference axes states a squareness, and its sign relative
/// to the squareness.
pub(crate) fn tilt_of(squareness: ErrorName, reference_axes: [AxisName; 2]) -> (ErrorName, f64) {
    if reference_of(reference_axes, squareness) == partner_of(squareness) {
        (squareness, 1.0)
    } else {
        (partner_tilt(squareness), -1.0)
    }
}

/// Tilt of the partner axis of a squareness about the same direction.
fn partner_tilt(squareness: ErrorName) -> ErrorName {
    ErrorName::location(squareness.component, partner_of(squareness))
}

/// The axis of a squareness that has no tilt: the primary reference axis if it belongs to the pair, else the secondary
/// reference axis.
pub(crate) fn reference_of([primary, secondary]: [AxisName; 2], squareness: ErrorName) -> AxisName {
    if [squareness.axis, partner_of(squareness)].contains(&primary) { primary } else { secondary }
}

/// The other axis of a squareness: the linear axis that is neither the axis in its name nor parallel to its axis of
/// rotation.
pub(crate) fn partner_of(squareness: ErrorName) -> AxisName {
    let is_partner = |axis: &AxisName| {
        let index = axis.mcs_index();
        index != squareness.axis.mcs_index() && index != squareness.component.mcs_index()
    };
    let primary = [AxisName::X, AxisName::Y, AxisName::Z];
    // A name that is not a squareness may have no partner; the callers reject such names.
    primary.into_iter().find(is_partner).unwrap_or(squareness.axis)
}

/// Whether a location error is one of the tilts of X, Y and Z that form their squareness.
pub fn is_square(error: ErrorName) -> bool {
    volcomp_metrology::opening(error).is_some()
}

/// Name of the squareness that a tilt of X, Y or Z belongs to, the same for both tilts of a pair: `EC0X` and `EC0Y`
/// give `EC0Y`. Every other error is returned unchanged.
pub(crate) fn square_of(error: ErrorName) -> ErrorName {
    if !is_square(error) {
        return error;
    }
    let axis = match error.component {
        Component::EC => AxisName::Y,
        _ => AxisName::Z,
    };
    ErrorName::location(error.component, axis)
}
