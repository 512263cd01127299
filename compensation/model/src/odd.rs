//! Detects numbers in a machine file that look like another unit.

use std::f64::consts::TAU;

use volcomp_curve::{Curve, Field};

use crate::machine::Machine;

/// µm and µrad: smaller than any measurement of an axis location, so a file whose location errors are all below it states them in mm or deg.
const NEVER_MEASURED: f64 = 0.1;
/// Maximum relative deviation of a rounded 2π (6.28).
const WRITTEN: f64 = 6e-4;

/// Notes on location errors far below what can be measured, and on waves with a period of 2π degrees.
pub(crate) fn notes(machine: &Machine) -> Vec<String> {
    let stated = machine
        .locations()
        .iter()
        .filter(|(_, value)| **value != 0.0);
    let largest = stated.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let small = largest.filter(|(_, value)| value.abs() < NEVER_MEASURED);
    let of_locations = small.map(|(name, value)| {
        format!(
            "{name} = {value} is the largest location error: is it in mm or deg? Errors in machine files are in µm and µrad"
        )
    });
    let rotary = machine.errors().filter(|(name, _)| name.axis.is_rotary());
    let of_periods = rotary.filter_map(|(name, curve)| {
        let period = curve.fields().find_map(|field| match field {
            Field::Curve(Curve::Fourier(series)) => Some(series.period()),
            _ => None,
        })?;
        ((period - TAU).abs() <= WRITTEN * TAU).then(|| {
            format!(
                "{name}: the period of {period} deg would be one turn in radians: is it meant so? Coordinates of rotary axes are in deg"
            )
        })
    });
    of_locations.into_iter().chain(of_periods).collect()
}
