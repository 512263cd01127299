//! Fourth stage: squareness errors from slopes, and the location errors that state them on a machine.

use volcomp_metrology::{squareness, squareness_parts};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{AxisName, ErrorName, Urad};

use crate::{
    calibration_file::{CalibrationFile, Squareness, SquarenessSource},
    error::CalibrateError,
    slopes::Slopes,
};

/// Every squareness of a file that is given, or made from the slopes of its two straightness errors.
pub(crate) fn squares(
    file: &CalibrationFile,
    slopes: &Slopes,
) -> Result<Vec<(ErrorName, Urad)>, CalibrateError> {
    let mut found = Vec::new();
    for entry in &file.squareness {
        found.extend(square(entry, slopes)?.map(|value| (entry.error, value)));
    }
    Ok(found)
}

/// `None` where it comes from diagonals, which need all others.
fn square(entry: &Squareness, slopes: &Slopes) -> Result<Option<Urad>, CalibrateError> {
    let reference_angle = match entry.source {
        SquarenessSource::Value(value) => return Ok(Some(value)),
        SquarenessSource::Diagonals => return Ok(None),
        SquarenessSource::Slopes { reference_angle } => reference_angle,
    };
    let [first, second] = squareness_parts(entry.error)?;
    let slope = |straightness: ErrorName| {
        let found = slopes.get(&straightness).copied();
        found.ok_or(CalibrateError::NoSlope {
            squareness: entry.error,
            straightness,
        })
    };
    let parts = [(first, slope(first)?), (second, slope(second)?)];
    Ok(Some(squareness(entry.error, reference_angle, parts)?))
}

/// The machine with a squareness, which is the difference of the tilts of its two axes about the third; the reference
/// axes have none: of the pair, the primary, else the secondary.
pub(crate) fn set_square(
    machine: &mut Machine,
    reference_axes: [AxisName; 2],
    error: ErrorName,
    value: Urad,
) -> Result<(), ModelError> {
    let (tilt, sign) = tilt_of(error, reference_axes);
    for name in [error, partner_tilt(error)] {
        let value = if name == tilt { sign * value.0 } else { 0.0 };
        // A zero is written only over what the machine file had.
        if value != 0.0 || name == error || machine.locations().contains_key(&name) {
            machine.set_location(name, value)?;
        }
    }
    Ok(())
}

/// The tilt that states a squareness on a machine with these reference axes, and its sign there.
pub(crate) fn tilt_of(squareness: ErrorName, reference_axes: [AxisName; 2]) -> (ErrorName, f64) {
    if reference_of(reference_axes, squareness) == partner_of(squareness) {
        (squareness, 1.0)
    } else {
        (partner_tilt(squareness), -1.0)
    }
}

/// The tilt of the other axis of a squareness about the same direction.
fn partner_tilt(squareness: ErrorName) -> ErrorName {
    ErrorName::location(squareness.component, partner_of(squareness))
}

/// Which of the two axes of a squareness has no tilt: the primary reference axis where it is one of them, else the
/// secondary.
pub(crate) fn reference_of([primary, secondary]: [AxisName; 2], squareness: ErrorName) -> AxisName {
    if [squareness.axis, partner_of(squareness)].contains(&primary) {
        primary
    } else {
        secondary
    }
}

/// The other axis of a squareness: neither its own nor the one it turns about.
pub(crate) fn partner_of(squareness: ErrorName) -> AxisName {
    let is_partner = |axis: &AxisName| {
        let index = axis.mcs_index();
        index != squareness.axis.mcs_index() && index != squareness.component.mcs_index()
    };
    let primary = [AxisName::X, AxisName::Y, AxisName::Z];
    // A name that is no squareness may leave none over; it is refused where it is used.
    primary
        .into_iter()
        .find(is_partner)
        .unwrap_or(squareness.axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{file, machine, name};

    fn entry(error: &str, source: SquarenessSource) -> Squareness {
        Squareness {
            error: name(error),
            source,
        }
    }

    /// EC0Y = (φ − π/2) − slope(EXY) − slope(EYX) = −3 − (−10) − 4.
    #[test]
    fn slopes_and_the_reference_make_a_squareness() {
        let slopes = Slopes::from([(name("EXY"), Urad(-10.0)), (name("EYX"), Urad(4.0))]);
        let reference_angle = Urad(-3.0);
        let mut file = file(Vec::new());
        file.squareness = vec![
            entry("EC0Y", SquarenessSource::Slopes { reference_angle }),
            entry("EA0Z", SquarenessSource::Value(Urad(8.0))),
        ];
        let found = squares(&file, &slopes).unwrap();
        assert_eq!(
            found,
            [(name("EC0Y"), Urad(3.0)), (name("EA0Z"), Urad(8.0))]
        );
        file.squareness = vec![entry("EB0Z", SquarenessSource::Slopes { reference_angle })];
        let missing = squares(&file, &slopes).unwrap_err();
        assert!(
            matches!(missing, CalibrateError::NoSlope { straightness, .. } if straightness == name("EXZ"))
        );
    }

    /// With Y as primary and Z as secondary axis the tilt between X and Y goes to X, with the other sign.
    #[test]
    fn the_reference_axes_have_no_tilt() {
        let mut with_x = machine("");
        set_square(
            &mut with_x,
            [AxisName::X, AxisName::Y],
            name("EC0Y"),
            Urad(5.0),
        )
        .unwrap();
        assert_eq!(with_x.locations().get(&name("EC0Y")), Some(&5.0));
        let mut with_y = machine("EC0Y = 9.0");
        set_square(
            &mut with_y,
            [AxisName::Y, AxisName::Z],
            name("EC0Y"),
            Urad(5.0),
        )
        .unwrap();
        assert_eq!(with_y.locations().get(&name("EC0X")), Some(&-5.0));
        assert_eq!(
            with_y
                .locations()
                .get(&name("EC0Y"))
                .copied()
                .unwrap_or(0.0),
            0.0
        );
    }
}
