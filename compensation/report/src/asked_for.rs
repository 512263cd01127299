//! How many targets and runs ISO 230-2 asks for. The numbers were not compared with the text of the standard here.

use volcomp_metrology::Measurement;
use volcomp_vocabulary::{AxisKind, Direction};

/// Linear axes up to this travel are tested with many runs, mm.
const SHORT_AXIS_MM: f64 = 2000.0;
/// Runs in each direction on linear axes up to 2 m and on rotary axes.
const RUNS: usize = 5;
/// Targets on each metre of a linear axis, and at the least.
const TARGETS: f64 = 5.0;
/// The longest interval between targets on longer linear axes, mm.
const INTERVAL_MM: f64 = 250.0;

/// What a positioning test has less than ISO 230-2 asks for, in a sentence; `None` where it has enough.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a range over a step is a small number, and one that is none becomes 0"
)]
pub(crate) fn fewer_than_asked_for(measurement: &Measurement, kind: AxisKind) -> Option<String> {
    let targets = measurement.targets();
    let (first, last) = (*targets.first()?, *targets.last()?);
    let range = last - first;
    let (asked_targets, asked_runs) = match kind {
        AxisKind::Linear if range <= SHORT_AXIS_MM => (
            (TARGETS * range / 1000.0).ceil().max(TARGETS) as usize,
            RUNS,
        ),
        AxisKind::Linear => ((range / INTERVAL_MM).ceil() as usize + 1, 1),
        AxisKind::Rotary if range <= 90.0 => (3, RUNS),
        AxisKind::Rotary if range <= 180.0 => (5, RUNS),
        AxisKind::Rotary => (8, RUNS),
    };
    let runs = Direction::BOTH.map(|direction| measurement.runs(direction).len());
    let mut lacks = Vec::new();
    if targets.len() < asked_targets {
        lacks.push(format!(
            "{} targets, expected {asked_targets} over this range",
            targets.len()
        ));
    }
    match runs {
        [0, n] | [n, 0] => {
            let are = if n == 1 {
                "1 run in one direction".to_owned()
            } else {
                format!("{n} runs in one direction")
            };
            lacks.push(format!("{are} only, expected {asked_runs} in each"));
        }
        [forward, backward] if forward.min(backward) < asked_runs => {
            lacks.push(format!(
                "{forward} runs forward and {backward} backward, expected {asked_runs} in each"
            ));
        }
        _ => {}
    }
    (!lacks.is_empty()).then(|| format!("fewer than ISO 230-2 asks for: {}", lacks.join("; ")))
}

#[cfg(test)]
mod tests {
    use volcomp_metrology::Reading;

    use super::*;

    fn test(targets: usize, step: f64, runs: u32, both: bool) -> Measurement {
        let mut readings = Vec::new();
        for run in 1..=runs {
            for direction in Direction::BOTH.into_iter().take(if both { 2 } else { 1 }) {
                readings.extend((0..targets).map(|i| Reading {
                    target: i as f64 * step,
                    run,
                    direction,
                    deviation: 0.0,
                }));
            }
        }
        Measurement {
            readings,
            ..Measurement::default()
        }
    }

    #[test]
    fn a_whole_test_has_enough() {
        assert_eq!(
            fewer_than_asked_for(&test(5, 100.0, 5, true), AxisKind::Linear),
            None
        );
        assert_eq!(
            fewer_than_asked_for(&test(13, 250.0, 1, true), AxisKind::Linear),
            None
        );
        assert_eq!(
            fewer_than_asked_for(&test(8, 45.0, 5, true), AxisKind::Rotary),
            None
        );
    }

    #[test]
    fn what_lacks_is_said() {
        let said = |m: &Measurement, kind| fewer_than_asked_for(m, kind).expect("too few");
        let few = said(&test(3, 100.0, 3, true), AxisKind::Linear);
        assert_eq!(
            few,
            "fewer than ISO 230-2 asks for: 3 targets, expected 5 over this range; 3 runs forward and 3 backward, expected 5 in each"
        );
        let one = said(&test(9, 100.0, 1, false), AxisKind::Linear);
        assert!(
            one.ends_with("1 run in one direction only, expected 5 in each"),
            "{one}"
        );
    }
}
