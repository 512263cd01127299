use std::{collections::VecDeque, f64::consts::TAU, time::Duration};

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{AxisLimits, DirectionMemory, reversal_threshold};
use volcomp_vocabulary::{AxisKind, Direction};

use crate::world::{PERIOD, STEP, limits};

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
