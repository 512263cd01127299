//! Tests of the mean curves of measurements with targets missing in some runs, against closed forms and the normal
//! equations of the two-way layout.

use proptest::prelude::*;
use volcomp_metrology::{
    Direction::{self, Negative, Positive},
    Measurement, Quantity, Reading, ReferenceLine, RunAlignment, evaluate, parse_csv,
    straightness_of,
};

const TARGETS: usize = 11;
const RUNS: [u32; 5] = [0, 1, 2, 3, 4];

fn truth(target: usize, direction: Direction) -> f64 {
    let x = target as f64;
    let reversal = if direction == Positive { 1.5 } else { -1.5 };
    0.2 * x * x - 1.7 * x + (1.3 * x).sin() + reversal * (1.0 + 0.1 * x)
}

/// A measurement in both directions with runs 1, 2, … that have these offsets. It contains the readings for which
/// `holds(run, direction, target)` is true; `more` is added to each reading.
fn measured(
    offsets: &[f64],
    holds: impl Fn(u32, Direction, usize) -> bool,
    more: impl Fn(u32, Direction, usize) -> f64,
) -> Measurement {
    let mut readings = Vec::new();
    for (run, offset) in (1..).zip(offsets) {
        for direction in Direction::BOTH {
            for target in (0..TARGETS).filter(|target| holds(run, direction, *target)) {
                readings.push(Reading {
                    target: 100.0 * target as f64,
                    run,
                    direction,
                    deviation: truth(target, direction) + offset + more(run, direction, target),
                });
            }
        }
    }
    Measurement { readings, ..Measurement::default() }
}

/// Mean curves minus the truth, forward and then backward. All values are equal if no run causes a step.
fn errors(measurement: &Measurement) -> Vec<f64> {
    let of = |direction| {
        let curve = measurement.mean_curve_in(direction).into_iter();
        curve.enumerate().map(move |(target, (_, mean))| mean - truth(target, direction))
    };
    Direction::BOTH.into_iter().flat_map(of).collect()
}

fn range(values: &[f64]) -> f64 {
    let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest - values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Without noise, the mean curve of each direction is the truth plus the same constant, whichever readings are missing.
#[test]
fn runs_that_lack_targets_make_no_step_and_no_reversal() {
    type Holds = fn(u32, Direction, usize) -> bool;
    let layouts: [(&str, &[f64], Holds); 8] = [
        ("a single missing reading", &[3.0, 40.0], |run, way, target| {
            (run, way, target) != (2, Positive, 4)
        }),
        ("the second run stops half-way", &[0.0, 40.0], |run, way, target| {
            run == 1 || (way == Positive && target <= 5)
        }),
        ("it stops on its way back", &[-7.0, 40.0], |run, way, target| {
            run == 1 || way == Positive || target >= 5
        }),
        ("the first run starts late", &[55.0, -4.0, 9.0], |run, _, target| run > 1 || target >= 7),
        ("a run that has no way back", &[1.0, -2.0, 40.0], |run, way, _| {
            run < 3 || way == Positive
        }),
        ("one run both ways, two backward only", &[60.0, -5.0, 20.0], |run, way, _| {
            run == 1 || way == Negative
        }),
        ("a single reading in a run", &[12.0, -30.0], |run, way, target| {
            run == 1 || (way == Positive && target == 3)
        }),
        ("a chain of runs", &[12.0, -30.0, 5.0], |run, way, target| {
            way == Positive || target.abs_diff(5 * run as usize - 5) <= 3
        }),
    ];
    for (name, offsets, holds) in layouts {
        let measurement = measured(offsets, holds, |_, _, _| 0.0);
        assert!(range(&errors(&measurement)) < 1e-9, "{name}");
        let both = measurement.mean_curve();
        let mean = |at: usize| Direction::BOTH.map(|way| truth(at, way)).iter().sum::<f64>() / 2.0;
        let left: Vec<f64> =
            (both.iter()).enumerate().map(|(target, (_, value))| value - mean(target)).collect();
        assert!(range(&left) < 1e-9, "{name}");
        assert!(measurement.scatter_of_mean(RunAlignment::Offset).is_none(), "{name}");
    }
}

/// The second of two runs stops early. The offset between the runs is then the mean difference at their common targets.
#[test]
fn two_runs_follow_the_closed_form() {
    let noise = |run: u32, _, target: usize| (f64::from(run) * 7.1 + target as f64 * 2.3).sin();
    let holds = |run, way, target| way == Positive && (run == 1 || target <= 5);
    let measurement = measured(&[0.0, 40.0], holds, noise);
    let read = |run: u32, target: usize| {
        truth(target, Positive) + 40.0 * f64::from(run - 1) + noise(run, Positive, target)
    };
    let between = (0..=5).map(|at| read(2, at) - read(1, at)).sum::<f64>() / 6.0;
    for (target, (_, mean)) in measurement.mean_curve_in(Positive).iter().enumerate() {
        let expected = match target {
            0..=5 => f64::midpoint(read(1, target), read(2, target)),
            _ => read(1, target) + between / 2.0,
        };
        assert!((mean - expected).abs() < 1e-9, "{target}: {mean} {expected}");
    }
    // ISO 230-2 uses the readings without alignment.
    let iso = evaluate(&measurement).unwrap();
    assert_eq!(iso.targets[5].forward.unwrap().mean, f64::midpoint(read(1, 5), read(2, 5)));
    assert_eq!(iso.targets[6].forward.unwrap().mean, read(1, 6));
}

/// Forward and backward passes have separate zeros. Neither mean curve has a step, and the reversal value is that of
/// the readings.
#[test]
fn passes_with_zeros_of_their_own_make_no_step() {
    let own = |run, way, _| f64::from(run) * if way == Positive { 20.0 } else { -35.0 };
    let stops = |run, way, target| run != 2 || way == Positive || target >= 6;
    let measurement = measured(&[0.0; 3], stops, own);
    let found = errors(&measurement);
    let (forward, backward) = found.split_at(TARGETS);
    assert!(range(forward) < 1e-9 && range(backward) < 1e-9);
    // The mean zeros are 40 µm forward and −70 µm backward.
    assert!((forward[0] - backward[0] - 110.0).abs() < 1e-9);
    // If passes are numbered consecutively, so that no run has both directions, the readings are not changed.
    let mut one_by_one = measured(&[5.0, 9.0], |_, _, _| true, own);
    for reading in &mut one_by_one.readings {
        reading.run = 2 * reading.run - u32::from(reading.direction == Positive);
    }
    assert_eq!(one_by_one.incomplete_runs(), None);
}

/// The offset of a run that drifts is not constant. Where this run ends, a step remains: half of its drift over the
/// common targets.
#[test]
fn a_drift_leaves_only_its_own_part_of_the_step() {
    let drift = |run: u32, _, target: usize| if run == 2 { 0.4 * target as f64 } else { 0.0 };
    let holds = |run, way, target| way == Positive && (run == 1 || target <= 5);
    let found = errors(&measured(&[0.0, 40.0], holds, drift));
    let step = found[5] - found[6];
    assert!((step - 0.5 * (0.4 * 2.5)).abs() < 1e-9, "{step}");
}

/// The scatter of incomplete runs is that of the readings about the common curve; steps between runs do not contribute.
#[test]
fn the_scatter_has_no_step_in_it() {
    let noise =
        |run: u32, _, target: usize| (f64::from(run * run) * 3.7 + target as f64 * 5.9).sin();
    let complete = measured(&[0.0; 4], |_, _, _| true, noise);
    for alignment in [RunAlignment::Offset, RunAlignment::Line] {
        let expected = complete.scatter_of_mean(alignment).unwrap().deviation;
        let holds = |run, way, target| run != 2 || (way == Positive && target <= 5);
        let found = measured(&[0.0, 40.0, -3.0, 8.0], holds, noise);
        let scatter = found.scatter_of_mean(alignment).unwrap();
        assert!((0.7..1.4).contains(&(scatter.deviation / expected)), "{scatter:?} {expected}");
        // Degrees of freedom: readings − targets − parameters per run · (runs − 1), forward and backward.
        let parameters = if alignment == RunAlignment::Offset { 1.0 } else { 2.0 };
        let expected = (39.0 - 11.0 - 3.0 * parameters) + (33.0 - 11.0 - 2.0 * parameters);
        assert_eq!(scatter.freedom, expected);
    }
}

/// A straightness reference is realigned before each run, so that each run has its own offset and slope. If targets are
/// missing in some runs, the mean curves of both directions are the truth plus a common line.
#[test]
fn runs_of_a_straightness_that_lack_targets_make_no_step() {
    let slopes = [0.0, 0.09, -0.05];
    let line = |run: u32, _, target: usize| slopes[run as usize - 1] * (100 * target) as f64;
    let holds = |run, way, target| match run {
        1 => true,
        2 => way == Positive && target <= 5,
        _ => target >= 3,
    };
    let mut measurement = measured(&[0.0, 40.0, -12.0], holds, line);
    let at = |measurement: &Measurement| -> Vec<(f64, f64)> {
        let errors = errors(measurement).into_iter().enumerate();
        let place = |index: usize| 100.0 * (index % TARGETS) as f64;
        errors.map(|(index, error)| (place(index), error)).collect()
    };
    let left = |measurement: &Measurement| {
        let errors = at(measurement);
        let line = ReferenceLine::least_squares(&errors).unwrap();
        range(&line.removed_from(&errors).iter().map(|of| of.1).collect::<Vec<_>>())
    };
    // Aligned only by offsets, as for positioning deviations, the runs cause steps.
    assert!(left(&measurement) > 5.0);
    measurement.quantity = Some(Quantity::Straightness);
    assert!(left(&measurement) < 1e-9, "{}", left(&measurement));
    assert_eq!(
        measurement.incomplete_runs().unwrap().scatter().unwrap().freedom,
        (25.0 - 11.0 - 4.0) + (19.0 - 11.0 - 2.0)
    );
    // The same applies if the file does not state the quantity.
    measurement.quantity = None;
    let complete = straightness_of(&measured(&[0.0], |_, _, _| true, |_, _, _| 0.0)).unwrap();
    let found = straightness_of(&measurement).unwrap();
    for (a, b) in found.about.iter().zip(&complete.about) {
        assert!((a.error_um - b.error_um).abs() < 1e-9, "{a:?} {b:?}");
    }
    let [a, b] = [&found, &complete].map(|of| of.reversal_um.unwrap());
    assert!((a - b).abs() < 1e-9, "{a} {b}");
}

/// Straightness passes have scattering slopes and separate numbers in the two directions, and a target is missing in
/// the last forward pass. The uncertainty of the slope is that of independent means of the slopes in the two
/// directions, s/2 · √(1/n₁ + 1/n₂), with n₁ + n₂ − 2 degrees of freedom.
#[test]
fn the_slope_of_passes_with_separate_numbers_has_a_mean_in_each_direction() {
    let slopes = [30.0, -50.0, 20.0, 0.0, -10.0, 10.0];
    for backward in [3, 2, 1] {
        let slope = |run: u32| match run {
            1..=3 => slopes[run as usize - 1],
            _ if backward == 1 => 0.0,
            4 if backward == 2 => -10.0,
            5 if backward == 2 => 10.0,
            _ => slopes[run as usize - 1],
        };
        let line = |run: u32, _, target: usize| 1e-3 * slope(run) * (100 * target) as f64;
        let number = 3 + backward;
        for lacking in [false, true] {
            let holds = |run: u32, way, target: usize| {
                (run <= 3) == (way == Positive)
                    && run <= number
                    && !(lacking && run == 3 && target == TARGETS - 1)
            };
            let found = straightness_of(&measured(&[0.0; 6], holds, line)).unwrap();
            let found = found.slope_uncertainty.unwrap();
            // Σ(slope − mean)² is 3800 for the forward passes, and 200 for two or three backward passes.
            let squares = if backward > 1 { 4000.0 } else { 3800.0 };
            let n = f64::from(backward);
            assert_eq!(found.degrees, 1.0 + n, "{lacking} {backward}");
            let pooled: f64 = squares / (1.0 + n);
            let of_each = [1900.0, if backward > 1 { 200.0 / (n - 1.0) } else { 1900.0 }];
            let expected = if lacking {
                (of_each[0] / 3.0 + of_each[1] / n).sqrt() / 2.0
            } else {
                (pooled * (1.0 / 3.0 + 1.0 / n)).sqrt() / 2.0
            };
            let ratio = found.standard_urad / expected;
            assert!((0.9..1.1).contains(&ratio), "{lacking} {backward}: {ratio}");
        }
    }
}

/// A long guideway is measured in many short runs, each of which overlaps the next. The lines of the runs are
/// determined through all overlaps, and the profile keeps its shape, apart from a line common to all runs.
#[test]
fn a_long_chain_of_short_runs_keeps_the_profile() {
    const RUNS: u32 = 200;
    let shape = |target: usize| 3.0 * (0.37 * target as f64).sin();
    let runs = 1..=RUNS;
    let readings = runs.flat_map(|run| {
        let line = move |x: f64| 20.0 * f64::from(run).sin() + 0.01 * f64::from(3 * run).cos() * x;
        let first = 10 * (run as usize - 1);
        (first..first + 20).map(move |target| {
            let x = 100.0 * target as f64;
            Reading { target: x, run, direction: Positive, deviation: shape(target) + line(x) }
        })
    });
    let measurement = Measurement { readings: readings.collect(), ..Measurement::default() };
    let found = straightness_of(&measurement).unwrap().profile;
    let truth: Vec<(f64, f64)> =
        (0..found.len()).map(|target| (100.0 * target as f64, shape(target))).collect();
    let [found, truth] = [found, truth].map(|profile| {
        let line = ReferenceLine::least_squares(&profile).unwrap();
        line.removed_from(&profile)
    });
    for ((target, found), (_, truth)) in found.iter().zip(&truth) {
        assert!((found - truth).abs() < 1e-3, "{target}: {found} {truth}");
    }
}

/// With two common targets, nothing checks the slope of a run; with a single common target, the slope is unknown. Both
/// cases are rejected.
#[test]
fn runs_of_a_straightness_without_slope_are_refused() {
    for last in [0, 1] {
        let holds = |run, way, target| way == Positive && (run == 1 || target <= last);
        let refused = straightness_of(&measured(&[0.0, 40.0], holds, |_, _, _| 0.0));
        insta::allow_duplicates! {
            insta::assert_snapshot!(refused.unwrap_err(), @": run 2 +: found fewer than three targets in common with the other runs, expected three: where not all runs hold all targets, the offset and the slope of each run of a straightness come from its common targets; leave the run out or complete it");
        }
    }
    let complete = |_, way, target| way == Positive && target <= 1;
    assert!(straightness_of(&measured(&[0.0, 40.0], complete, |_, _, _| 0.0)).is_ok());
}

#[test]
fn runs_without_a_common_target_are_noted() {
    let notes = |rows: &str| {
        let text = format!("target,run,direction,deviation\n{rows}");
        let measurement = parse_csv(text.as_bytes(), "x.csv").unwrap();
        let plain = measurement.mean_curve_in(Positive);
        (measurement.notes.join("\n"), plain)
    };
    let (apart, curve) = notes("0,1,+,1\n10,1,+,2\n20,2,+,40\n30,2,+,41\n");
    insta::assert_snapshot!(apart, @r"
    run 1 + holds 2 of 4 targets
    run 2 + holds 2 of 4 targets
    not all runs hold all targets: for curves the runs are aligned at common targets, by their offsets and for straightness also by their slopes; ISO 230-2 uses the readings as they are
    runs 1, 2 + have no common target, not even through other runs: their offsets are unknown, so the curve may have a false step between their targets
    ");
    assert_eq!(curve, [(0.0, 1.0), (10.0, 2.0), (20.0, 40.0), (30.0, 41.0)]);
    let each: Vec<String> = (1..=40).map(|k| format!("{k},{k},+,1\n")).collect();
    insta::assert_snapshot!(notes(&each.concat()).0.lines().last().unwrap(), @"runs 1, 2, 3 and 37 more + have no common target, not even through other runs: their offsets are unknown, so the curve may have a false step between their targets");
    let (late, _) = notes("0,1,+,1\n10,1,+,2\n20,1,+,3\n10,2,+,40\n20,2,+,41\n");
    insta::assert_snapshot!(late, @r"
    run 2 + holds 2 of 3 targets
    not all runs hold all targets: for curves the runs are aligned at common targets, by their offsets and for straightness also by their slopes; ISO 230-2 uses the readings as they are
    ");
}

/// Readings of up to five runs over seven targets in both directions; each reading may be missing.
fn layout() -> impl Strategy<Value = Measurement> {
    let cell = (0.0..1.0_f64, -50.0..50.0_f64);
    (prop::collection::vec(cell, 2 * 5 * 7), 0.0..0.6_f64).prop_map(|(cells, missing)| {
        let mut readings = Vec::new();
        for (index, (chance, deviation)) in cells.into_iter().enumerate() {
            let (target, run) = ((index / 10) as f64, RUNS[index % 5]);
            let direction = Direction::BOTH[index / 5 % 2];
            // The readings at the first target are never missing; they connect all runs.
            if chance >= missing || target == 0.0 {
                readings.push(Reading { target, run, direction, deviation });
            }
        }
        Measurement { readings, ..Measurement::default() }
    })
}

proptest! {
    /// A constant that is added to all readings of a run shifts the whole curve by a constant; reversal value and
    /// scatter do not change.
    #[test]
    fn offsets_of_runs_do_not_change_the_curve(measurement in layout(), run in 0..5_u32, offset in -1e3..1e3_f64) {
        let mut moved = measurement.clone();
        for reading in moved.readings.iter_mut().filter(|r| r.run == run) {
            reading.deviation += offset;
        }
        let mut by = Vec::new();
        for direction in Direction::BOTH {
            let [before, after] = [&measurement, &moved].map(|m| m.mean_curve_in(direction));
            by.extend(after.iter().zip(&before).map(|(a, b)| a.1 - b.1));
        }
        prop_assert!(range(&by) < 1e-9, "{by:?}");
        for alignment in [RunAlignment::Offset, RunAlignment::Line] {
            let [before, after] = [&measurement, &moved].map(|m| m.scatter_of_mean(alignment).map(|s| s.deviation));
            let same = before.zip(after).is_none_or(|(a, b)| (a - b).abs() < 1e-9);
            prop_assert!(same && before.is_some() == after.is_some(), "{before:?} {after:?}");
        }
    }

    /// The two-way table (reading = target + run), completed by least squares, has no residuals at missing readings,
    /// and its means are the curve plus a constant.
    #[test]
    fn the_curve_solves_the_normal_equations(mut measurement in layout(), is_straightness: bool) {
        measurement.quantity = is_straightness.then_some(Quantity::Straightness);
        let has_slope = is_straightness && measurement.check_lines_of_runs().is_ok();
        for direction in Direction::BOTH {
            let curve = measurement.mean_curve_in(direction);
            let at = |target: f64| curve.iter().position(|of| of.0 == target).unwrap();
            let about = |of: &dyn Fn(&Reading) -> f64, run: u32| -> Vec<(f64, f64)> {
                let readings = measurement.readings.iter().filter(|r| r.direction == direction && r.run == run);
                readings.map(|r| (r.target, of(r))).collect()
            };
            let mut sums = vec![(0.0, 0.0); curve.len()];
            for run in RUNS {
                let own = about(&|r| r.deviation - curve[at(r.target)].1, run);
                let line = ReferenceLine::least_squares(&own).ok().filter(|_| has_slope).unwrap_or_else(|| ReferenceLine {
                    slope_um_per_mm: 0.0,
                    intercept_um: own.iter().map(|of| of.1).sum::<f64>() / own.len() as f64,
                });
                for (target, left) in line.removed_from(&own) {
                    let (sum, count) = &mut sums[at(target)];
                    *sum += left;
                    *count += 1.0;
                }
            }
            let left = sums.iter().zip(&curve).map(|((sum, count), (target, _))| (*target, sum / count));
            let left: Vec<(f64, f64)> = left.collect();
            let common = ReferenceLine::least_squares(&left).ok().filter(|_| has_slope);
            let left = common.map_or(left.clone(), |line| line.removed_from(&left));
            let left: Vec<f64> = left.iter().map(|of| of.1).collect();
            prop_assert!(range(&left) < 1e-8, "{left:?}");
        }
    }

    #[test]
    fn complete_runs_stay_as_they_are(deviations in prop::collection::vec(-1e3..1e3_f64, 2 * TARGETS * 3)) {
        let noise = |run: u32, way: Direction, target: usize| deviations[(run as usize - 1) * 2 * TARGETS + way as usize * TARGETS + target];
        let measurement = measured(&[0.0, 17.0, -4.0], |_, _, _| true, noise);
        prop_assert_eq!(measurement.incomplete_runs(), None);
        for direction in Direction::BOTH {
            for (target, mean) in measurement.mean_curve_in(direction) {
                prop_assert_eq!(mean, measurement.mean_at(target, direction).unwrap());
            }
        }
    }
}
