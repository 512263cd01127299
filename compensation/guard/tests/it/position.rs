//! A position is accepted only within the travel and within reach of the axis.

use core::time::Duration;

use proptest::prelude::*;
use volcomp_guard::{PositionCheck, PositionFlaw, PositionLimits};

/// 100 m/min in mm/s.
const RAPID: f64 = 100_000.0 / 60.0;
/// 200 rev/min in deg/s; the check does not depend on the unit.
const TURNS: f64 = 1200.0;

const LINEAR: PositionLimits =
    PositionLimits { range: Some([-5.0, 4005.0]), turn: None, speed: RAPID };
const TABLE: PositionLimits = PositionLimits { range: None, turn: Some(360.0), speed: TURNS };
const TILT: PositionLimits =
    PositionLimits { range: Some([-125.0, 125.0]), turn: None, speed: TURNS };

const OK: Result<(), PositionFlaw> = Ok(());
const JUMP: Result<(), PositionFlaw> = Err(PositionFlaw::Jumped);
const OUT: Result<(), PositionFlaw> = Err(PositionFlaw::OutsideTravel);

fn ms(ms: f64) -> Duration {
    Duration::from_secs_f64(ms / 1e3)
}

/// Checks the verdict for each reading: time in ms, position, verdict.
fn reported(
    world: &str,
    limits: &PositionLimits,
    readings: &[(f64, f64, Result<(), PositionFlaw>)],
) {
    let mut check = PositionCheck::default();
    for (at, position, expected) in readings {
        let found = check.judge(limits, *position, ms(*at));
        assert_eq!(found, *expected, "{world}: {position} at {at} ms");
    }
}

/// The reach is speed · (time + 50 ms): 100 mm after 10 ms, and 83.3 mm for a second reading at the same time.
#[test]
fn accepted_positions_of_a_linear_axis() {
    reported(
        "the ends, and no way back from beyond but the way that was gone",
        &LINEAR,
        &[(0.0, -5.0, OK), (10.0, -5.1, OUT), (1e6, 200.0, JUMP), (1e6 + 100.0, 90.0, OK)],
    );
    reported("4 m in 10 ms", &LINEAR, &[(0.0, 2.0, OK), (10.0, 4002.0, JUMP), (20.0, 2.1, OK)]);
    reported(
        "the reach",
        &LINEAR,
        &[(0.0, 0.0, OK), (0.0, 83.2, OK), (0.0, 0.0, OK), (10.0, 100.1, JUMP), (20.0, 99.9, OK)],
    );
    reported(
        "inches",
        &LINEAR,
        &[(0.0, 572.7, OK), (10.0, 22.547, JUMP), (20.0, 22.547, JUMP), (30.0, 572.7, OK)],
    );
    reported("mm where inches are meant", &LINEAR, &[(0.0, 100.0, OK), (10.0, 2540.0, JUMP)]);
    reported(
        "a repeated timestamp, and an earlier one from another path",
        &LINEAR,
        &[(100.0, 50.0, OK), (90.0, 34.0, OK), (100.0, 50.0, OK)],
    );
}

/// A wrong position stays rejected, however long it is reported or the axis is silent, and also if it moves to the last
/// good position. A jump back by the same distance is accepted.
#[test]
fn a_jump_is_never_accepted_after_a_while() {
    let mut check = PositionCheck::default();
    assert_eq!(check.judge(&LINEAR, 100.0, ms(0.0)), OK);
    for reading in 1..100_000 {
        let at = f64::from(reading) * 10.0;
        assert_eq!(check.judge(&LINEAR, 600.0, ms(at)), JUMP, "{at} ms");
    }
    assert_eq!(check.judge(&LINEAR, 600.0, ms(2e6)), JUMP);
    // Positions within 200 mm are within reach of the position 10 ms before the jump.
    for (at, position, expected) in [
        (0.0, 400.0, JUMP),
        (10.0, 310.0, JUMP),
        (20.0, 220.0, JUMP),
        (30.0, 199.9, JUMP),
        (40.0, 110.0, JUMP),
        (50.0, 200.0, JUMP),
        (60.0, 290.0, JUMP),
        (70.0, 380.0, JUMP),
        (80.0, 199.9, JUMP),
        (90.0, 470.0, JUMP),
        (100.0, 560.0, JUMP),
        (110.0, 650.0, JUMP),
        (120.0, 199.9, OK),
        (220.0, 299.0, OK),
    ] {
        assert_eq!(check.judge(&LINEAR, position, ms(3e6 + at)), expected, "{position}");
    }
    // `forget` is called when the guard is armed again.
    assert_eq!(check.judge(&LINEAR, 2000.0, ms(3_000_300.0)), JUMP);
    check.forget();
    assert_eq!(check.judge(&LINEAR, 2000.0, ms(3_000_310.0)), OK);
}

/// X moves from 300 to 0 mm and back at 20 m/min; meanwhile its position is 200 mm too high, as after a preset. The
/// wrong position is never accepted, even when it passes the last accepted position, after a silence, or after a single
/// nonsensical reading. The right position is accepted when the error ends.
#[test]
fn a_constant_error_is_not_believed_as_the_axis_moves() {
    let mut check = PositionCheck::default();
    let true_x = |at: f64| (300.0 - at / 3.0).abs();
    for cycle in 0..=450 {
        let at = f64::from(cycle) * 4.0;
        let (reported, expected) = match cycle {
            0 | 450 => (true_x(at), OK),
            150 => (3000.0, JUMP),
            155..175 => continue,
            _ => (true_x(at) + 200.0, JUMP),
        };
        assert_eq!(check.judge(&LINEAR, reported, ms(at)), expected, "{at} ms");
    }
}

/// X moves from 300 mm at 20 m/min. Its position is first 200 mm too high. Then the error changes, so that the wrong
/// position equals the last accepted position. The second error (−200 or −300 mm) exceeds the permitted distance of
/// both jumps, which is 187 mm for the second reading at a cycle of 4 ms. The true position is accepted.
#[test]
fn another_error_is_not_believed() {
    for (second, cycles, expected) in [(-300.0, 225, JUMP), (-200.0, 150, JUMP), (0.0, 10, OK)] {
        let mut check = PositionCheck::default();
        assert_eq!(check.judge(&LINEAR, 300.0, ms(0.0)), OK);
        for cycle in 1..cycles + 100 {
            let at = f64::from(cycle) * 4.0;
            let error = if cycle < cycles { 200.0 } else { second };
            let found = check.judge(&LINEAR, 300.0 + at / 3.0 + error, ms(at));
            let expected = if cycle < cycles { JUMP } else { expected };
            assert_eq!(found, expected, "{second} mm, {at} ms");
        }
    }
}

/// X moves from 600 mm to 0, to 1000 mm and on at 20 m/min, so that each wrong position passes the last accepted
/// position. Errors that alternate, for one reading of 4 ms or for several, are never accepted.
#[test]
fn alternating_errors_are_not_believed() {
    for errors in [
        &[200.0, 320.0][..],
        &[-200.0, -320.0],
        &[200.0, 200.0, 320.0, 320.0],
        &[200.0, 200.0, 200.0, 320.0, 320.0, 320.0],
        &[200.0, 320.0, 320.0],
        &[200.0, 320.0, 440.0],
        &[200.0, 200.0, -200.0, -200.0],
        &[200.0, -150.0, -320.0, -150.0],
    ] {
        let mut check = PositionCheck::default();
        for cycle in 0..5000_u32 {
            let error = if cycle == 0 { 0.0 } else { errors[cycle as usize % errors.len()] };
            let way = f64::from(cycle) * 4.0 / 3.0;
            let true_x = ((400.0 + way) % 2000.0 - 1000.0).abs();
            let found = check.judge(&LINEAR, true_x + error, ms(f64::from(cycle) * 4.0));
            assert_eq!(found.is_ok(), cycle == 0, "{errors:?}: {cycle}");
        }
    }
}

#[test]
fn wrong_readings_are_forgotten_once_the_position_is_back() {
    reported(
        "one wrong reading, one of them repeated, then a silence",
        &LINEAR,
        &[
            (0.0, 300.0, OK),
            (10.0, 0.0, JUMP),
            (10.0, 0.0, JUMP),
            (1000.0, 310.0, OK),
            (1010.0, 0.0, JUMP),
            (1020.0, 300.0, OK),
        ],
    );
    reported(
        "motion far beyond the travel, as to a tool changer, and back",
        &LINEAR,
        &[
            (0.0, 0.0, OK),
            (100.0, -100.0, OUT),
            (200.0, -200.0, OUT),
            (300.0, -300.0, OUT),
            (400.0, -200.0, OUT),
            (500.0, -100.0, OUT),
            (600.0, 0.0, OK),
        ],
    );
    for wrong in [50.0, 500.0] {
        reported(
            "one wrong reading while the axis is beyond the travel",
            &LINEAR,
            &[
                (0.0, 0.0, OK),
                (100.0, -100.0, OUT),
                (200.0, -200.0, OUT),
                (300.0, -300.0, OUT),
                (310.0, wrong, JUMP),
                (320.0, -300.0, OUT),
                (420.0, -200.0, OUT),
                (520.0, -100.0, OUT),
                (620.0, 0.0, OK),
            ],
        );
    }
    reported(
        "a constant error that begins while the axis is beyond the travel",
        &LINEAR,
        &[
            (0.0, 0.0, OK),
            (100.0, -100.0, OUT),
            (200.0, -200.0, OUT),
            (300.0, -300.0, OUT),
            (310.0, 200.0, JUMP),
            (320.0, 190.0, JUMP),
            (400.0, 60.0, JUMP),
            (410.0, 0.0, JUMP),
        ],
    );
    reported(
        "a jump beyond the travel, and motion back",
        &LINEAR,
        &[
            (0.0, 0.0, OK),
            (10.0, -200.0, OUT),
            (20.0, -190.0, OUT),
            (100.0, -100.0, OUT),
            (200.0, 0.0, JUMP),
        ],
    );
    reported(
        "a table with two wrong readings, and one with a constant error",
        &TABLE,
        &[
            (0.0, 350.0, OK),
            (10.0, 170.0, JUMP),
            (20.0, 170.0, JUMP),
            (30.0, 355.0, OK),
            (40.0, 175.0, JUMP),
            (50.0, 185.0, JUMP),
            (100.0, 265.0, JUMP),
            (150.0, 350.0, JUMP),
        ],
    );
}

/// A jump spread over several readings by a filter: the allowance of 50 ms counts once, and is restored while the axis is at rest.
#[test]
fn repeated_small_jumps_reach_no_farther_than_one() {
    let step = RAPID * 0.030;
    reported(
        "each step has 10 ms of the 30 ms that it takes",
        &LINEAR,
        &[
            (0.0, 0.0, OK),
            (10.0, step, OK),
            (20.0, 2.0 * step, OK),
            (30.0, 3.0 * step, JUMP),
            (40.0, 2.0 * step, OK),
            (80.0, 2.0 * step, OK),
            (90.0, 3.0 * step, OK),
        ],
    );
}

#[test]
fn an_alternating_position_is_accepted_at_one_place() {
    let mut check = PositionCheck::default();
    for reading in 0..1000 {
        let there = reading % 2 == 1;
        let (position, expected) = if there { (900.0, JUMP) } else { (300.0, OK) };
        let at = f64::from(reading) * 4.0;
        assert_eq!(check.judge(&LINEAR, position, ms(at)), expected, "{at} ms");
    }
}

#[test]
fn accepted_positions_of_a_rotary_axis() {
    reported(
        "a table that rolls over",
        &TABLE,
        &[(0.0, 350.0, OK), (10.0, 2.0, OK), (20.0, -350.0, OK), (30.0, 3610.0, OK)],
    );
    reported(
        "half a turn at once",
        &TABLE,
        &[(0.0, 0.0, OK), (10.0, 180.0, JUMP), (20.0, 71.9, OK)],
    );
    reported(
        "an axis that does not go round",
        &TILT,
        &[(0.0, 120.0, OK), (10.0, -120.0, JUMP), (20.0, 480.0, OUT), (30.0, 119.0, OK)],
    );
}

proptest! {
    /// An axis at maximum speed is accepted with any cycle time, silences, and timestamps wrong by up to 25 ms.
    #[test]
    fn an_axis_at_maximum_speed_is_accepted(
        steps in prop::collection::vec((1_u32..=100, -1.0..=1.0_f64, -25.0..=25.0_f64), 1..200),
        silence in 0_u32..3000,
    ) {
        let mut check = PositionCheck::default();
        let (mut at, mut before) = (1000.0, 0.0);
        for (index, (cycle, speed, late)) in steps.iter().enumerate() {
            let passed = f64::from(*cycle) + if index % 10 == 9 { f64::from(silence) } else { 0.0 };
            let goes = (RAPID * speed * passed / 1e3).clamp(-before, 4000.0 - before);
            at += passed;
            // The position at an earlier or later time during the motion, at the same speed.
            let reported = (before + goes * (1.0 + late / passed)).clamp(
                (before + goes - RAPID * 0.025).max(0.0),
                (before + goes + RAPID * 0.025).min(4000.0),
            );
            before += goes;
            prop_assert_eq!(check.judge(&LINEAR, reported, ms(at)), OK);
        }
    }

    #[test]
    fn a_table_at_maximum_speed_is_accepted(
        begins in 0.0..360.0_f64, cycle in 1_u32..100, clockwise in any::<bool>(),
    ) {
        let mut check = PositionCheck::default();
        let sign = if clockwise { 1.0 } else { -1.0 };
        for reading in 0..100 {
            let at = f64::from(reading * cycle);
            let position = (begins + sign * TURNS * at / 1e3).rem_euclid(360.0);
            prop_assert_eq!(check.judge(&TABLE, position, ms(at)), OK);
        }
    }
}
