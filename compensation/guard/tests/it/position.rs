//! Accepted and rejected positions of an axis, and its direction of travel.
//!
//! A position is accepted only within the travel and within reach of the axis.

use std::{collections::VecDeque, f64::consts::TAU, time::Duration};

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    AxisLimits, DirectionMemory, PositionCheck, PositionFlaw, PositionLimits, reversal_threshold,
};
use volcomp_vocabulary::{AxisKind, Direction};

use crate::world::{PERIOD, STEP, limits};

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

/// A direction memory that receives one reading per cycle; counts the readings.
#[derive(Default)]
struct Memory {
    memory: DirectionMemory,
    readings: u32,
}

impl Memory {
    fn at(&mut self, position: f64, threshold: f64, turn: Option<f64>) -> Option<Direction> {
        self.readings += 1;
        let taken = PERIOD * self.readings;
        self.memory.at(taken, position, threshold, turn)
    }

    /// Repeats a reading until its position counts.
    fn stays(&mut self, position: f64, threshold: f64, turn: Option<f64>) -> Option<Direction> {
        for _ in 0..4 {
            self.at(position, threshold, turn);
        }
        self.at(position, threshold, turn)
    }
}

#[test]
fn one_wrong_position_causes_no_reversal() {
    let [forward, back] = [Direction::Positive, Direction::Negative];
    for wrong in [-1.0, 1.0, 0.02, -0.02] {
        for (way, direction) in [(0.01, forward), (-0.01, back)] {
            let mut memory = Memory::default();
            let mut position = 10.0;
            for _ in 0..10 {
                position += way;
                memory.at(position, 0.005, None);
            }
            for cycle in 0..100 {
                let reported = if cycle % 3 == 0 { position + wrong } else { position };
                assert_eq!(memory.at(reported, 0.005, None), Some(direction));
                // A repeated reading counts only once.
                for _ in 0..5 {
                    let taken = PERIOD * memory.readings;
                    memory.memory.at(taken, reported, 0.005, None);
                }
            }
            // The first reading of the memory may be the wrong one.
            let mut memory = Memory::default();
            memory.at(position + wrong, 0.005, None);
            for _ in 0..10 {
                assert_eq!(memory.at(position, 0.005, None), None);
            }
        }
    }
}

#[test]
fn it_reverses_only_beyond_the_threshold_from_the_last_extreme() {
    let mut memory = Memory::default();
    let mut at = |position: f64| memory.stays(position, 0.005, None);
    assert_eq!(at(10.0), None);
    assert_eq!(at(10.004), None, "noise");
    assert_eq!(at(10.006), Some(Direction::Positive));
    assert_eq!(at(20.0), Some(Direction::Positive));
    assert_eq!(at(19.996), Some(Direction::Positive), "back by less than the threshold");
    assert_eq!(at(20.001), Some(Direction::Positive), "a new extreme");
    assert_eq!(at(19.997), Some(Direction::Positive));
    assert_eq!(at(f64::NAN), Some(Direction::Positive));
    assert_eq!(at(19.9955), Some(Direction::Negative));
    assert_eq!(at(20.0), Some(Direction::Negative));
    assert_eq!(at(20.0006), Some(Direction::Positive));
}

/// Forward motion through the wrap at 360° is not a reversal; motion back by more than the threshold is a reversal,
/// also across the wrap.
#[test]
fn rolling_over_is_no_reversal() {
    for (step, direction) in [(0.001, Direction::Positive), (-0.7, Direction::Negative)] {
        let mut memory = Memory::default();
        let mut position = 3.0_f64;
        memory.stays(position, 8.7e-6, Some(TAU));
        for _ in 0..20_000 {
            position = (position + step).rem_euclid(TAU);
            assert_eq!(memory.stays(position, 8.7e-6, Some(TAU)), Some(direction));
        }
        // Back by more than the threshold, across the wrap.
        position = (-0.5 * step.signum() * 1e-5_f64).rem_euclid(TAU);
        memory.memory.commanded(position, direction);
        let back = (position - 1e-5 * step.signum()).rem_euclid(TAU);
        assert_eq!(memory.stays(back, 8.7e-6, Some(TAU)), Some(-direction));
    }
}

#[test]
fn a_commanded_direction_applies_at_once() {
    let mut memory = Memory::default();
    assert_eq!(memory.memory.commanded(5.0, Direction::Negative), Some(Direction::Negative));
    assert_eq!(memory.stays(5.004, 0.005, None), Some(Direction::Negative));
    assert_eq!(memory.memory.commanded(f64::NAN, Direction::Positive), Some(Direction::Positive));
    assert_eq!(memory.stays(5.0, 0.005, None), Some(Direction::Positive));
    assert_eq!(memory.stays(4.994, 0.005, None), Some(Direction::Negative));
}

fn axis(includes_correction: bool) -> AxisLimits {
    AxisLimits { includes_correction, ..limits().axes[0] }
}

#[test]
fn the_threshold_follows_kind_step_and_lag() {
    let delay = Duration::from_millis(20);
    let close = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-15, "{found}");
    close(reversal_threshold(&axis(false), 0.001, delay), 0.005);
    close(reversal_threshold(&axis(false), 0.031, delay), 0.062);
    // 0.5 mm/s in 20 ms, plus one step of the correction.
    close(reversal_threshold(&axis(true), 0.001, delay), 0.013);
    close(reversal_threshold(&axis(true), 0.0, Duration::ZERO), 0.005);
    close(reversal_threshold(&axis(false), f64::NAN, delay), 0.005);
    let rotary = AxisLimits { kind: AxisKind::Rotary, ..axis(false) };
    close(reversal_threshold(&rotary, 1e-7, delay), 5e-4_f64.to_radians());
}

/// Number of reversals at standstill. The reversal value is 20 µm, and the position contains the correction `lag` cycles after the
/// read-back.
fn turns_at_standstill(lag: usize, threshold: f64) -> u32 {
    let slew = limits().axes[0].slew_per_s * PERIOD.as_secs_f64();
    let mut memory = Memory::default();
    let mut output = 0.0_f64;
    let mut history = VecDeque::from(vec![0.0; lag]);
    let mut turns = 0;
    let mut before = None;
    for cycle in 0..2000_u32 {
        // 1 mm forward, 6 µm back shortly afterwards, then standstill.
        let commanded =
            0.01 * f64::from(cycle.min(100)) - 0.006 * f64::from(cycle.saturating_sub(110).min(1));
        history.push_back(output);
        let contained = history.pop_front().expect("just pushed");
        let reported = ((commanded + contained) / STEP).round() * STEP;
        let direction = memory.at(reported - output, threshold, None);
        turns += u32::from(cycle > 130 && direction != before);
        before = direction;
        let requested = direction.map_or(0.0, |direction| 0.010 * direction.sign());
        let goal = output + (requested - output).clamp(-slew, slew);
        output = (goal / STEP).round() * STEP;
    }
    turns
}

/// A position that contains the correction with a lag of 20 ms causes no reversal at standstill with the calculated
/// threshold. With a threshold of 5 µm the direction would oscillate.
#[test]
fn no_reversal_is_fed_back_at_standstill() {
    assert!(turns_at_standstill(5, 0.005) > 50, "the defect is gone from the test");
    for lag in [0_usize, 2, 5, 8] {
        let delay = PERIOD * u32::try_from(lag).expect("few");
        let threshold = reversal_threshold(&axis(true), STEP, delay);
        assert_eq!(turns_at_standstill(lag, threshold), 0, "lag {lag}");
    }
}

#[test]
fn a_flickering_count_causes_no_reversal() {
    let step = 0.031_25;
    let threshold = reversal_threshold(&axis(false), step, Duration::ZERO);
    let mut memory = Memory::default();
    memory.at(99.0, threshold, None);
    let mut turns = 0;
    let mut before = memory.at(100.0, threshold, None);
    for cycle in 0..4000_u32 {
        let flicker = if (cycle / 60).is_multiple_of(2) { 0.0 } else { step };
        let direction = memory.at(100.0 + flicker, threshold, None);
        turns += u32::from(direction != before);
        before = direction;
    }
    assert_eq!(turns, 0);
}

/// An axis at 0.1 mm/min moves 7 nm per cycle of 4 ms, about as much as its position flickers. Within the threshold there is no reversal,
/// beyond it exactly one.
#[test]
fn a_creeping_axis_reverses_once_beyond_the_threshold() {
    let per_cycle = 0.1 / 60.0 * PERIOD.as_secs_f64();
    let threshold = reversal_threshold(&axis(false), 1e-6, Duration::ZERO);
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let (mut memory, mut position) = (Memory::default(), 100.0);
    let mut turns: Vec<(Direction, f64)> = Vec::new();
    // The extremes are 100.009 and 99.996; targets less than 5 µm from the last extreme cause no reversal.
    for target in [100.009, 100.0045, 100.0085, 99.996, 99.996, 100.0, 99.9965, 100.004] {
        let begun = position;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "some thousands"
        )]
        let cycles = ((target - begun) / per_cycle).abs().ceil().max(300.0) as u32;
        for cycle in 1..=cycles {
            position = begun + (target - begun) * f64::from(cycle) / f64::from(cycles);
            let flicker = random.random_range(-3e-6..3e-6);
            if let Some(direction) = memory.at(position + flicker, threshold, None)
                && turns.last().is_none_or(|(last, _)| *last != direction)
            {
                turns.push((direction, position));
            }
        }
    }
    let expected = [
        (Direction::Positive, 100.0 + threshold),
        (Direction::Negative, 100.009 - threshold),
        (Direction::Positive, 99.996 + threshold),
    ];
    assert_eq!(turns.len(), expected.len(), "{turns:?}");
    for ((direction, at), (expected, beyond)) in turns.iter().zip(expected) {
        assert_eq!(*direction, expected);
        // The detection is later by the flicker and by the readings that must agree: five before the first extreme,
        // three at each reversal.
        assert!((at - beyond).abs() < 6e-5, "{at} mm, {beyond} mm");
    }
}

/// After thousands of revolutions the direction equals that of a memory that starts one turn before the end.
#[test]
fn many_turns_do_not_change_the_direction() {
    const THRESHOLD: f64 = 0.005;
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for sign in [1.0, -1.0] {
        let mut rolled = Memory::default();
        let mut position = 0.0_f64;
        let reported = |position: f64| position.rem_euclid(TAU);
        for _ in 0..100_000 {
            position += sign * TAU / 20.0;
            rolled.at(reported(position), THRESHOLD, Some(TAU));
        }
        let mut fresh = Memory::default();
        for k in (0..20).rev() {
            let before = position - sign * TAU / 20.0 * f64::from(k);
            fresh.at(reported(before), THRESHOLD, Some(TAU));
        }
        let mut turns = 0;
        let mut last = None;
        for _ in 0..10_000 {
            position += rng.random_range(-0.004..0.004);
            let at = reported(position);
            let direction = rolled.at(at, THRESHOLD, Some(TAU));
            assert_eq!(direction, fresh.at(at, THRESHOLD, Some(TAU)), "at {at}");
            turns += usize::from(last.replace(direction) != Some(direction));
        }
        assert!(turns > 20, "it turned {turns} times");
    }
}

/// Up to two wrong readings in five delay the first direction but never invert it, also half a turn away from the first position.
#[test]
fn the_first_direction_is_right_half_a_turn_away() {
    let reported = [0.0, 210.0, 40.0, 0.0, 80.0, 100.0, 120.0, 240.0, 260.0, 180.0];
    for (sign, direction) in [(1.0, Direction::Positive), (-1.0, Direction::Negative)] {
        let mut memory = Memory::default();
        let mut seen = None;
        // 20° per reading; readings 2, 4, 8 and 9 are wrong.
        for position in reported.into_iter().chain((10..20).map(|k| 20.0 * f64::from(k))) {
            let position = (sign * position).rem_euclid(360.0).to_radians();
            let found = memory.at(position, 0.005, Some(TAU));
            assert!(found.is_none() || found == Some(direction), "{found:?}");
            seen = found;
        }
        assert_eq!(seen, Some(direction));
    }
}

/// With at most two wrong readings in any five, the axis has moved by more than the threshold in each reported
/// direction.
#[test]
fn with_two_wrong_readings_in_five_every_direction_is_a_real_one() {
    const THRESHOLD: f64 = 5.0;
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for turn in [None, Some(360.0)] {
        let mut turns = 0;
        for run in 0..8000 {
            let mut memory = Memory::default();
            let [mut position, mut speed] = [0.0_f64; 2];
            let (mut wrong, mut ways) = (Vec::new(), Vec::new());
            let (mut since, mut last) = (0, None);
            for k in 0..60_usize {
                if rng.random_range(0..8) == 0 {
                    speed = [-20.0, -3.0, -1.0, 0.0, 1.0, 3.0, 20.0][rng.random_range(0..7)];
                }
                position += speed;
                ways.push(position);
                let is_wrong = wrong.iter().rev().take(4).filter(|is| **is).count() < 2
                    && rng.random_range(0..3) == 0;
                wrong.push(is_wrong);
                let error = [-170.0, -60.0, -7.0, 6.0, 30.0, 100.0][rng.random_range(0..6)];
                let reported = position + if is_wrong { error } else { 0.0 };
                let reported = turn.map_or(reported, |turn| reported.rem_euclid(turn));
                let found = memory.at(reported, THRESHOLD, turn);
                if found == last {
                    continue;
                }
                let sign = found.expect("kept").sign();
                // Farthest position in this direction since the last reversal.
                let (mut went, mut least) = (0.0_f64, f64::INFINITY);
                for way in ways[since..].iter().map(|way| way * sign) {
                    least = least.min(way);
                    went = went.max(way - least);
                }
                assert!(
                    went > THRESHOLD,
                    "{turn:?}, run {run}, reading {k}: {last:?} {found:?} after {went}"
                );
                // The extreme is among the last readings.
                (last, since) = (found, k.saturating_sub(4));
                turns += 1;
            }
        }
        assert!(turns > 8000, "{turns}");
    }
}

/// Positions with arbitrary errors, at most two in any five consecutive readings.
fn wrong_readings() -> impl Strategy<Value = Vec<Option<f64>>> {
    let wrong =
        prop_oneof![-0.05..0.05_f64, -4.0..4.0_f64, Just(1e6), Just(-1e6), Just(1.0), Just(-1.0)];
    prop::collection::vec(prop::option::weighted(0.6, wrong), 60..200).prop_map(|mut readings| {
        for i in 0..readings.len() {
            let before = &readings[i.saturating_sub(4)..i];
            if before.iter().flatten().count() >= 2 {
                readings[i] = None;
            }
        }
        readings
    })
}

proptest! {
    /// At most two wrong readings in any five, too many for a median of three, cause no reversal. Four right readings
    /// report a real reversal.
    #[test]
    fn two_wrong_readings_in_five_cause_no_reversal(
        wrong in wrong_readings(),
        ways in prop::collection::vec(prop_oneof![Just(0.0), 0.0..0.02_f64, Just(0.35)], 200),
        sign in prop_oneof![Just(1.0), Just(-1.0)],
        rolls_over in any::<bool>(),
    ) {
        let turn = rolls_over.then_some(TAU);
        let reported = |position: f64| turn.map_or(position, |turn| position.rem_euclid(turn));
        let direction = Direction::of(sign);
        let mut memory = Memory::default();
        let mut position = 3.0;
        let mut went = 0.0;
        for (wrong, way) in wrong.iter().zip(&ways) {
            // Less than a quarter turn in four readings.
            position += way * sign;
            went += way;
            let found = memory.at(reported(position + wrong.unwrap_or(0.0)), 0.005, turn);
            prop_assert!(found.is_none() || found == direction, "{found:?} at {position}");
        }
        // The direction is known at this point. A reversal must be detected by the fourth right reading.
        for _ in 0..8 {
            position += 0.01 * sign;
            memory.at(reported(position), 0.005, turn);
        }
        prop_assert_eq!(memory.memory.at(Duration::ZERO, f64::NAN, 0.005, turn), direction, "{}", went);
        let mut readings = 0;
        loop {
            position -= 0.01 * sign;
            readings += 1;
            let found = memory.at(reported(position), 0.005, turn);
            if found != direction {
                prop_assert_eq!(found, Direction::of(-sign));
                break;
            }
            prop_assert!(readings < 5, "a way back is not seen");
        }
    }

    #[test]
    fn a_reversal_is_found_among_wrong_readings(wrong in wrong_readings(), step in 0.001..0.5_f64) {
        let mut memory = Memory::default();
        for k in 0..20 {
            memory.at(f64::from(k) * step, 0.005, None);
        }
        prop_assume!(memory.memory.at(Duration::ZERO, f64::NAN, 0.005, None).is_some());
        let needed = 0.005 / step + 12.0;
        for (k, wrong) in (1..).zip(&wrong) {
            let position = (19.0 - f64::from(k)) * step;
            let found = memory.at(position + wrong.unwrap_or(0.0), 0.005, None);
            let turned = found == Some(Direction::Negative);
            prop_assert!(turned || f64::from(k) < needed, "{k} readings");
        }
    }
}
