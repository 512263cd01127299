//! Requirements of ISO 230-2 on a positioning test: number of targets and runs, depending on the kind of axis and its
//! travel.

use volcomp_vocabulary::{AxisKind, AxisName, Direction};

use crate::{Edition, Measurement, TargetUnit, axis_named};

/// Minimum positioning test that the standard requires for an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct RequiredTest {
    /// Description of the axis, such as `linear axes up to 2000 mm`.
    pub axes: &'static str,
    /// Minimum number of targets.
    pub targets: usize,
    /// Minimum number of runs in each direction.
    pub runs: usize,
}

/// Maximum travel for which five runs are required, mm.
const SHORT_MM: f64 = 2000.0;
/// Number of targets per metre for a travel up to 2000 mm.
const TARGETS_PER_M: f64 = 5.0;
/// Mean spacing of the targets for a longer travel, mm.
const LONG_INTERVAL_MM: f64 = 250.0;
const RUNS: usize = 5;
/// Tolerance of a travel that exceeds a limit only by the rounding of its targets, mm or deg, and of a number of
/// targets.
const HAIR: f64 = 1e-6;

/// Minimum test for an axis of this kind with this travel, mm or deg. The editions from 1997 to 2014 have the same
/// requirements.
pub fn required_test(kind: AxisKind, travel: f64) -> RequiredTest {
    // The conversion saturates for large values and NaN.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "small and positive"
    )]
    let whole = |targets: f64| (targets - HAIR).ceil().max(0.0) as usize;
    match kind {
        AxisKind::Linear if travel <= SHORT_MM + HAIR => RequiredTest {
            axes: "linear axes up to 2000 mm",
            targets: whole(TARGETS_PER_M * travel / 1000.0).max(5),
            runs: RUNS,
        },
        AxisKind::Linear => RequiredTest {
            axes: "linear axes over 2000 mm",
            // The number of targets is one more than the number of intervals.
            targets: whole(travel / LONG_INTERVAL_MM).saturating_add(1),
            runs: 1,
        },
        AxisKind::Rotary if travel <= 360.0 + HAIR => RequiredTest {
            axes: "rotary axes up to 360°",
            targets: match travel {
                t if t <= 90.0 + HAIR => 3,
                t if t <= 180.0 + HAIR => 5,
                _ => 8,
            },
            runs: RUNS,
        },
        AxisKind::Rotary => RequiredTest {
            axes: "rotary axes over 360°",
            targets: whole(8.0 * travel / 360.0),
            runs: 1,
        },
    }
}

/// Kind of the axis: from the unit of the targets in the file, or else from the axis that the file names; `None` if the
/// file has neither.
pub fn axis_kind(measurement: &Measurement) -> Option<AxisKind> {
    let named = || measurement.metadata.axis.as_deref().and_then(axis_named);
    let stated = measurement.target_unit.map(TargetUnit::kind);
    stated.or_else(|| named().map(AxisName::kind))
}

/// Messages about fewer targets or runs than the standard requires; empty if there are enough.
pub fn shortfalls(measurement: &Measurement, kind: AxisKind, edition: Edition) -> Vec<String> {
    let targets = measurement.targets();
    let (Some(first), Some(last)) = (targets.first(), targets.last()) else {
        return Vec::new();
    };
    let asked = required_test(kind, last - first);
    let standard = format!("ISO 230-2:{}", edition.year());
    let mut said = Vec::new();
    if targets.len() < asked.targets {
        let unit = kind.coordinate_unit();
        said.push(format!(
            "{} over {} {unit}: {standard} asks for {} at least on {}",
            counted(targets.len(), "target"),
            last - first,
            asked.targets,
            asked.axes
        ));
    }
    let runs = Direction::BOTH.map(|direction| measurement.runs(direction).len());
    let fewest = runs.into_iter().filter(|runs| *runs > 0).min();
    let fewest = fewest.unwrap_or(0);
    if fewest < asked.runs {
        said.push(format!(
            "{} in a direction: {standard} asks for {} in each direction on {}",
            counted(fewest, "run"),
            asked.runs,
            asked.axes
        ));
    }
    if fewest < 2 {
        said.push(if asked.runs == 1 {
            format!(
                "one run in a direction, as {standard} asks for on {}: A and R need at least two and are not stated",
                asked.axes
            )
        } else {
            "A and R need at least two runs in a direction".to_owned()
        });
    }
    if runs.contains(&0) {
        said.push(format!(
            "only one direction was run: {standard} asks for both, and the bidirectional values are not stated"
        ));
    }
    said
}

/// Formats a count with its noun: `1 run`, `2 runs`.
pub(crate) fn counted(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}
