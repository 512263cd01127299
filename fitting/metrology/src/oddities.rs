//! What is odd about the readings of a file by themselves, whatever they are used for.

use volcomp_vocabulary::{AxisName, Direction};

use crate::{DeviationUnit, Measurement, Quantity, ReferenceLine, outlier_hints};

/// More is odd for a machine tool: 1 mm and 1 mrad, in µm and µrad.
pub const ODD_ABOVE: f64 = 1e3;
/// Deviations that are all smaller are odd for a machine tool: 0.1 µm and 0.1 µrad.
pub const SMALL_BELOW: f64 = 0.1;
/// No linear axis is longer, mm.
const LONGEST_MM: f64 = 200_000.0;

/// Warnings for a person: what the reader noted, and what no test of a machine tool should show: deviations that are all
/// the same, very large or very small, targets beyond any axis, a unit of targets that is not that of the axis, a
/// single target, runs and readings unlike the others.
pub fn oddities(measurement: &Measurement) -> Vec<String> {
    let mut odd = measurement.notes.clone();
    let sizes = || measurement.readings.iter().map(|reading| reading.deviation);
    let line = set_up_along(measurement);
    let largest = measurement.readings.iter().fold(0.0_f64, |largest, of| {
        let from = line.map_or(0.0, |line| line.value_um(of.target));
        largest.max((of.deviation - from).abs())
    });
    let unit = with_space(measurement.unit);
    if measurement.unit.is_none() {
        odd.push("the unit of the deviations is not stated".into());
    }
    let several = measurement.readings.len() > 1;
    if several && sizes().all(|size| Some(size) == sizes().next()) {
        let first = sizes().next().unwrap_or_default();
        odd.push(format!(
            "every deviation is {first}{unit}: was anything measured?"
        ));
    } else {
        odd.extend(small(largest, measurement.unit));
    }
    odd.extend(large(largest, measurement.unit));
    let targets = measurement.targets();
    if let [only] = targets[..] {
        odd.push(format!("there is a single target, {only}"));
    }
    if targets.iter().any(|target| target.abs() > LONGEST_MM) {
        odd.push(format!(
            "targets are beyond {LONGEST_MM} mm: are they in another unit?"
        ));
    }
    let axis = measurement.metadata.axis.as_deref().and_then(axis_named);
    if let Some(axis) = axis
        && let Err(error) = measurement.check_targets(axis)
    {
        odd.push(error.to_string());
    }
    let [forward, backward] = Direction::BOTH.map(|direction| measurement.has(direction));
    if forward
        && backward
        && let Err(error) = measurement.check_directions()
    {
        odd.push(error.to_string());
    }
    odd.extend(outlier_hints(measurement).into_iter().map(|hint| hint.text));
    odd
}

/// The line that a straightness contains, along which the optics were set up: its size says nothing of the machine. Two targets have none that
/// leaves anything.
fn set_up_along(measurement: &Measurement) -> Option<ReferenceLine> {
    let is_straightness = measurement.quantity == Some(Quantity::Straightness);
    let points = measurement.mean_curve();
    let points = Some(points).filter(|points| is_straightness && points.len() > 2)?;
    ReferenceLine::least_squares(&points).ok()
}

/// That deviations with this largest size, µm or µrad, are larger or smaller than those of a machine tool, in a sentence: most often
/// they are in another unit.
pub fn odd_size(largest: f64, unit: Option<DeviationUnit>) -> Option<String> {
    large(largest, unit).or_else(|| small(largest, unit))
}

fn large(largest: f64, unit: Option<DeviationUnit>) -> Option<String> {
    (largest > ODD_ABOVE).then(|| {
        let unit = with_space(unit);
        format!(
            "deviations of up to {largest:.0}{unit} are large for a machine tool: are they in another unit?"
        )
    })
}

fn small(largest: f64, unit: Option<DeviationUnit>) -> Option<String> {
    (largest < SMALL_BELOW).then(|| {
        let unit = with_space(unit);
        format!("every deviation is below {SMALL_BELOW}{unit}: are they in another unit?")
    })
}

fn with_space(unit: Option<DeviationUnit>) -> String {
    unit.map_or(String::new(), |unit| format!(" {unit}"))
}

/// The axis of a text such as `X`, `x-axis` or `Axis Y`.
pub fn axis_named(text: &str) -> Option<AxisName> {
    let words = text.split(|c: char| !c.is_alphanumeric());
    let mut letters = words.filter_map(|word| word.to_uppercase().parse::<AxisName>().ok());
    let first = letters.next()?;
    letters.all(|other| other == first).then_some(first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse_csv;

    #[test]
    fn axes_are_found_in_words() {
        for (text, axis) in [
            ("X", Some(AxisName::X)),
            (" y-axis", Some(AxisName::Y)),
            ("Axis c", Some(AxisName::C)),
            ("X to Y", None),
            ("Table", None),
            ("", None),
        ] {
            assert_eq!(axis_named(text), axis, "{text}");
        }
    }

    #[test]
    fn readings_that_no_machine_has_are_told() {
        let said = |text: &str| oddities(&parse_csv(text.as_bytes(), "x.csv").unwrap()).join("\n");
        for (text, expected) in [
            ("target,deviation_um\n0,0\n1,0\n", "every deviation is 0 µm"),
            (
                "target,deviation_um\n0,0.001\n1,0.002\n",
                "every deviation is below 0.1 µm",
            ),
            ("target,deviation_um\n0,2500\n1,0\n", "up to 2500 µm"),
            ("target,deviation_um\n5,2\n", "a single target, 5"),
            (
                "target,deviation_um\n0,2\n9000000,3\n",
                "targets are beyond",
            ),
            ("target,deviation\n0,2\n9,3\n", "not stated"),
        ] {
            assert!(said(text).contains(expected), "{text}: {}", said(text));
        }
        assert_eq!(said("target,deviation_um\n0,2\n9,3\n"), "");
    }
}
