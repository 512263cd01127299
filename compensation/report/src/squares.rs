//! Squareness of the linear axes, and the other location errors of a machine.

use volcomp_calibrate::is_square;
use volcomp_metrology::opening;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::report::{Location, Square, Tilt};

const PAIRS: [[AxisName; 2]; 3] =
    [[AxisName::X, AxisName::Y], [AxisName::Y, AxisName::Z], [AxisName::X, AxisName::Z]];

/// Angles between the linear axes from the location errors of a machine. `measured` returns
/// whether the calibration determined the angle of a pair, `uncertainty` the standard uncertainty
/// of an error, µrad.
pub(crate) fn squares(
    machine: &Machine,
    measured: impl Fn([AxisName; 2]) -> bool,
    uncertainty: impl Fn(ErrorName) -> Option<f64>,
) -> Vec<Square> {
    let pairs = PAIRS.into_iter().filter_map(|pair| {
        if pair.iter().any(|name| machine.axis(*name).is_none()) {
            return None;
        }
        let mut from = Vec::new();
        let mut angle_urad = 0.0;
        for (name, value) in machine.locations() {
            let Some(opens) = opening(*name).filter(|_| pair_of(*name) == Some(pair)) else {
                continue;
            };
            angle_urad += opens * value;
            from.push(Tilt {
                error: name.to_string(),
                urad: *value,
                uncertainty: uncertainty(*name),
            });
        }
        (!from.is_empty()).then(|| Square {
            first: pair[0].to_string(),
            second: pair[1].to_string(),
            angle_urad,
            from,
            measured: measured(pair),
        })
    });
    pairs.collect()
}

pub(crate) fn pair_of(error: ErrorName) -> Option<[AxisName; 2]> {
    PAIRS.into_iter().find(|pair| {
        pair.contains(&error.axis)
            && pair.iter().all(|axis| axis.mcs_index() != error.component.mcs_index())
    })
}

/// The location errors other than squareness.
pub(crate) fn other_locations(
    machine: &Machine,
    stated: &[volcomp_calibrate::Location],
) -> Vec<Location> {
    let others = machine.locations().iter().filter(|(name, _)| !is_square(**name));
    let location = |(name, value): (&ErrorName, &f64)| Location {
        error: name.to_string(),
        value: *value,
        unit: name.component.symbol().to_owned(),
        uncertainty: stated
            .iter()
            .find(|of| of.error == *name)
            .map(|of| of.uncertainty)
            .filter(|stated| *stated > 0.0),
    };
    others.map(location).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By the right-hand rule EC0Y and EA0Z increase the angles XY and YZ, and EB0Z decreases XZ (see `volcomp_metrology::squareness`). The
    /// same tilt of the other axis has the opposite effect.
    #[test]
    fn location_errors_open_and_close_the_angles() {
        let machine = Machine::parse(
            "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 1000]\nZ.travel = [0, 1000]\n[errors]\nEC0Y = 10.0\nEA0Z = 20.0\nEB0Z = 30.0\nEC0X = 4.0\n",
            "machine.toml",
        )
        .expect("a machine");
        let found = squares(&machine, |pair| pair[0] == AxisName::Y, |_| None);
        let angles: Vec<f64> = found.iter().map(|square| square.angle_urad).collect();
        assert_eq!(angles, [6.0, 20.0, -30.0]);
        assert_eq!(found[0].from.len(), 2);
        assert!(found[1].measured && !found[2].measured);
        assert!(other_locations(&machine, &[]).is_empty());
    }
}
