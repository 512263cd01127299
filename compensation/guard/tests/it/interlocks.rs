//! Several paths: interlocks, and the selection of the active one.

use std::time::Duration;

use volcomp_guard::{
    Choice, Hold, Interlock, Interlocks, Limits, PathHealth, Reasons, Request, Selector, State,
};
use volcomp_vocabulary::PerChannel;

use crate::world::{CLEAR, PERIOD, STOP, World, axes, limits};

#[test]
fn an_interlock_on_one_path_holds_all_until_the_same_path_clears_it() {
    let mut interlocks = Interlocks::default();
    interlocks.update(0, CLEAR);
    interlocks.update(1, STOP);
    assert_eq!(interlocks.reasons(), Reasons::EMERGENCY_STOP);
    // An interlock is not cleared by silence, nor by another path that does not see the stop.
    interlocks.update(0, CLEAR);
    interlocks.update(1, None);
    let reported = interlocks.reasons();
    assert_eq!(reported, Reasons::EMERGENCY_STOP | Reasons::INTERLOCK_UNSEEN);
    interlocks.update(1, CLEAR);
    assert_eq!(interlocks.reasons(), Reasons::NONE);
}

/// For flags older than `hold`, each state that the control can report counts as set; a state that it cannot report was accepted in the
/// configuration.
#[test]
fn old_flags_forbid() {
    let hold = Duration::from_millis(40);
    let all = Interlock { unreferenced: true, alarm: true, emergency_stop: true };
    let clear = Interlock::default();
    let no_alarm = Interlock { alarm: false, ..all };
    assert_eq!(clear.at_age(hold, hold, all), clear);
    assert_eq!(all.at_age(Duration::ZERO, hold, clear), all);
    let old = hold + Duration::from_nanos(1);
    for shown in [all, no_alarm, clear] {
        assert_eq!(clear.at_age(old, hold, shown), shown);
    }
    assert_eq!(all.at_age(old, hold, clear), all, "what it said last stays");
}

#[test]
fn an_acknowledgement_lifts_only_interlocks_of_silent_paths() {
    let mut interlocks = Interlocks::default();
    interlocks.update(0, STOP);
    interlocks.acknowledge();
    assert_eq!(interlocks.reasons(), Reasons::EMERGENCY_STOP, "it still says so");
    interlocks.update(0, None);
    interlocks.acknowledge();
    assert_eq!(interlocks.reasons(), Reasons::NONE);
}

/// Another path reports an emergency stop while the barrier moves and frames and reports are in transit. The axis comes
/// to rest, no late report becomes its next goal, and the correction continues after the stop.
#[test]
fn an_axis_holds_in_a_stop_reported_by_another_path() {
    for late in [0, 1, 2, 4] {
        for at in 60..70 {
            let mut world = World::ramping(late, at);
            world.interlocks.update(1, STOP);
            // Words in transit still arrive and move the axis.
            world.run(20 * PERIOD);
            let stands = world.applied;
            assert!(stands[0] > 0.02, "{stands:?}");
            for _ in 0..100 {
                world.run(PERIOD);
                assert_eq!(world.applied, stands, "{late} cycles late");
            }
            world.interlocks.update(1, CLEAR);
            assert_eq!(world.run(Duration::from_secs(2)).state, State::Compensating);
        }
    }
}

/// In a stop the barrier comes to rest some cycles after the last report: the guard adopts that correction and does not
/// move back.
#[test]
fn the_correction_held_by_a_barrier_in_a_stop_is_adopted() {
    let mut world = World::guarded(&Limits { read_back_cycles: 8, ..limits() });
    (world.report_delay, world.target) = (6, Some(axes(0.140, -0.070)));
    world.request(Request::Arm);
    world.run(60 * PERIOD);
    world.emergency_stop = true;
    world.run(PERIOD);
    let stands = world.applied;
    assert!(!world.run(Duration::from_secs(1)).reasons.contains(Reasons::UNCONFIRMED));
    (world.emergency_stop, world.answers) = (false, true);
    world.interlocks.update(1, STOP);
    world.run(Duration::from_secs(1));
    assert_eq!(world.applied, stands);
}

/// The confirmed correction lags the sent one. At the start of a stop it must not replace the word, because the axis
/// would move back by 18 µm. The words keep the slew in every time window, and the axis never reverses.
#[test]
fn neither_word_nor_axis_moves_back_when_a_stop_begins() {
    let slew = limits().axes[0].slew_per_s;
    for late in [0, 2, 4, 6] {
        // Either the control holds, or only another path reports the stop: briefly, or until the position of the axis
        // is known.
        for (holds, cycles) in [(true, 4), (true, 80), (false, 4), (false, 80)] {
            let mut world = World::ramping(late, 60);
            let mut words = Vec::new();
            let mut furthest = 0.0_f64;
            for cycle in 0..400 {
                let stopped = (10..10 + cycles).contains(&cycle);
                world.emergency_stop = holds && stopped;
                world.interlocks.update(1, if stopped { STOP } else { CLEAR });
                let output = world.run(Duration::ZERO);
                let applied = world.applied[0];
                assert!(applied >= furthest, "{late} {cycles}: {applied} after {furthest}");
                furthest = applied;
                if output.write {
                    words.push((world.now.as_secs_f64(), output.correction[0]));
                }
                if holds && stopped && cycle > 80 {
                    let stands = (output.correction[0] - applied).abs();
                    assert!(stands < 1e-9, "{late}: the word is {stands} mm off");
                }
            }
            for (i, (then, before)) in words.iter().enumerate() {
                for (now, word) in &words[i..] {
                    let most = slew * (now - then) + limits().axes[0].resolution;
                    let moved = (word - before).abs();
                    assert!(moved <= most + 1e-9, "{late} {cycles}: {moved} of {most}");
                }
            }
            assert_eq!(world.guard.state(), State::Compensating);
            assert!((furthest - 0.140).abs() < 1e-9);
        }
    }
}

/// A barrier with a delay of `late` cycles that holds for an emergency stop in the middle of a ramp.
fn stopped(late: usize) -> World {
    let mut world = World::ramping(late, 100);
    world.emergency_stop = true;
    world.run(Duration::from_secs(1));
    assert_eq!(world.guard.state(), State::Holding(Hold::Interlocked));
    world
}

/// In a stop the word goes to the held correction and stays there when limits are lowered; the axis does not move.
#[test]
fn limits_lowered_in_a_stop_do_not_move_the_word() {
    let mut world = stopped(4);
    let stands = world.applied;
    let off = |word: PerChannel<f64>| (word[0] - stands[0]).abs();
    assert!(off(world.run(PERIOD).correction) < 1e-9);
    world.lower_limits(0.030);
    for _ in 0..250 {
        assert!(off(world.run(Duration::ZERO).correction) < 1e-9);
        assert_eq!(world.applied, stands);
    }
}

/// Limits are lowered while the word moves to the held correction: the axis stays, and the correction continues after the stop.
#[test]
fn limits_lowered_as_a_stop_begins_do_not_move_the_word() {
    for cycles in 0..40 {
        let mut world = World::ramping(4, 100);
        world.emergency_stop = true;
        world.run(cycles * PERIOD);
        world.lower_limits(0.030);
        let stands = world.applied;
        let word = world.run(Duration::from_secs(1)).correction;
        assert_eq!(world.applied, stands);
        assert!((word[0] - stands[0]).abs() < 1e-9, "{cycles}: {}", word[0]);
        world.emergency_stop = false;
        assert_eq!(world.run(Duration::from_secs(2)).state, State::Compensating);
        assert!((world.applied[0] - 0.030).abs() < 1e-9);
    }
}

/// Limits are lowered in a stop, and the control is released while another path still reports the stop: no axis moves.
#[test]
fn limits_lowered_in_a_stop_reported_by_another_path_move_no_axis() {
    let mut world = stopped(2);
    world.interlocks.update(1, STOP);
    world.emergency_stop = false;
    world.run(Duration::from_millis(200));
    let stands = world.applied;
    world.lower_limits(0.030);
    for _ in 0..750 {
        world.run(Duration::ZERO);
        assert_eq!(world.applied, stands);
    }
    assert_eq!(world.guard.state(), State::Holding(Hold::Interlocked));
}

/// After a stop in which limits were lowered, the correction is reduced at the guard's slew, not at the barrier's rate.
#[test]
fn after_a_stop_in_which_limits_were_lowered_the_axis_moves_by_the_slew() {
    // Largest excess of the axis motion over the slew in any time window, mm.
    let goes_beyond = |late, limit| {
        let mut world = stopped(late);
        world.lower_limits(limit);
        world.run(Duration::from_secs(1));
        world.emergency_stop = false;
        let mut seen = vec![world.applied[0]];
        for _ in 0..400 {
            world.run(Duration::ZERO);
            seen.push(world.applied[0]);
        }
        let slewed = limits().axes[0].slew_per_s * PERIOD.as_secs_f64();
        let mut most = 0.0_f64;
        for (i, from) in seen.iter().enumerate() {
            for (cycles, to) in seen[i..].iter().enumerate() {
                most = most.max((to - from).abs() - slewed * cycles as f64);
            }
        }
        most
    };
    // One step for rounding, and one step because the barrier moves at its own rate within a cycle.
    for (late, limit) in [(4, 0.150), (0, 0.030), (2, 0.030), (4, 0.030)] {
        let beyond = goes_beyond(late, limit);
        assert!(beyond <= 0.002 + 1e-9, "{late}, to {limit}: {beyond}");
    }
}

/// Limits are lowered in the cycle in which another path reports a stop: the axis does not move back.
#[test]
fn limits_lowered_as_a_stop_begins_do_not_reverse_an_axis() {
    for late in [0, 2, 4, 6] {
        let mut world = World::ramping(late, 100);
        world.interlocks.update(1, STOP);
        world.lower_limits(0.030);
        let mut furthest = 0.0_f64;
        for _ in 0..300 {
            world.run(Duration::ZERO);
            furthest = furthest.max(world.applied[0]);
            assert_eq!(world.applied[0], furthest, "{late} cycles late");
        }
        assert!(furthest > 0.100, "{furthest}");
    }
}

/// A control with a delay of `late` cycles that holds X in the middle of a ramp for a reason that no path reports, for
/// long enough to count as stationary.
fn held_by_itself(late: usize) -> World {
    let mut world = World::ramping(late, 90);
    world.holds = true;
    world.run(Duration::from_millis(180));
    assert!(world.guard.output()[0] > world.applied[0], "{late} late");
    world
}

/// Largest reversal of X within these cycles, mm.
fn goes_back(world: &mut World, cycles: u32) -> f64 {
    let (mut highest, mut back) = (world.applied[0], 0.0_f64);
    for _ in 0..cycles {
        world.run(Duration::ZERO);
        highest = highest.max(world.applied[0]);
        back = back.max(highest - world.applied[0]);
    }
    back
}

/// The control is released, then another path reports a stop: the axis goes to the last sent word, not back to the older held correction.
#[test]
fn a_stop_that_begins_as_the_control_is_released_does_not_reverse_an_axis() {
    for late in [0_usize, 1, 2, 4, 6] {
        for cycles in 0..2 * late + 4 {
            let mut world = held_by_itself(late);
            world.holds = false;
            for _ in 0..cycles {
                world.run(Duration::ZERO);
            }
            world.interlocks.update(1, STOP);
            let back = goes_back(&mut world, 200);
            assert!(back <= 1e-9, "{late} late, after {cycles}: {back}");
        }
    }
}

/// The control is held during a stop of another path: the word goes to the held correction, even beyond a lowered limit, so that the
/// release moves no axis.
#[test]
fn a_control_released_in_a_stop_does_not_move() {
    for late in [0, 1, 2, 4, 6] {
        for limit in [0.150, 0.030] {
            let mut world = held_by_itself(late);
            world.interlocks.update(1, STOP);
            let stood = world.applied;
            world.run(Duration::from_millis(40));
            world.lower_limits(limit);
            world.run(Duration::from_millis(400));
            let case = format!("{late} late, {limit}");
            assert!((world.guard.output()[0] - stood[0]).abs() < 1e-9, "{case}");
            world.holds = false;
            world.run(Duration::from_millis(400));
            assert_eq!(world.applied, stood, "{case}");
        }
    }
}

/// The control is released while the word moves to the held correction: the axis goes to the word, and both stay.
#[test]
fn a_control_released_early_in_a_stop_goes_to_the_word() {
    for late in [0, 1, 2, 4, 6] {
        for after in (0..200).step_by(12) {
            let mut world = held_by_itself(late);
            world.interlocks.update(1, STOP);
            world.run(Duration::from_millis(after));
            world.holds = false;
            // Runs until the release is reported and all words sent before the release have arrived.
            for _ in 0..4 * late + 20 {
                world.run(Duration::ZERO);
            }
            let (word, at) = (world.guard.output(), world.applied);
            assert_eq!(word[0], at[0], "{late} late, after {after} ms");
            world.run(Duration::from_millis(400));
            assert_eq!(world.applied, at, "{late} late, after {after} ms");
            assert_eq!(world.guard.output(), word, "{late} late, after {after} ms");
        }
    }
}

/// A stop that chatters while a correction beyond a lowered limit is reduced: without a barrier the reduction stays within the slew.
#[test]
fn a_chattering_stop_does_not_speed_up_the_return_within_a_limit() {
    let mut limits = limits();
    limits.axes.iter_mut().for_each(|axis| {
        axis.slew_per_s = 0.005;
        axis.accel_per_s2 = f64::INFINITY;
    });
    let mut world = World::new(&limits);
    world.target = Some(axes(0.100, 0.0));
    world.request(Request::Arm);
    world.run(Duration::from_secs(25));
    let from = world.applied[0];
    assert!((from - 0.100).abs() < 0.002, "{from}");
    world.lower_limits(0.010);
    world.target = Some(axes(0.0, 0.0));
    let begun = world.now;
    world.request(Request::Switched);
    for cycle in 0..100 {
        let interlock = Interlock { emergency_stop: cycle % 2 == 0, ..Interlock::default() };
        world.interlocks.update(1, Some(interlock));
        world.cycle_after(PERIOD, None);
    }
    let passed_s = world.now.saturating_sub(begun).as_secs_f64();
    let (way, most) = (from - world.applied[0], 0.005 * passed_s + 0.001 + 1e-9);
    assert!(way <= most, "{way} mm in {passed_s} s, {most} allowed");
}

const UP: PathHealth = PathHealth { usable: true, ready: true };
const DOWN: PathHealth = PathHealth { usable: false, ready: false };
/// The path responds, but the correction left by the previous path is unknown.
const UNKNOWN: PathHealth = PathHealth { usable: true, ready: false };

/// Time (s), health of both paths, and the choice: active, preferred, switched, blocked.
type Step = (u64, [PathHealth; 2], (usize, usize, bool, bool));

#[test]
fn the_next_path_takes_over_and_hands_back_with_hysteresis() {
    let goes_down: [Step; 9] = [
        (1, [UP, UP], (0, 0, false, false)),
        (2, [DOWN, UP], (1, 1, true, false)),
        (3, [DOWN, UP], (1, 1, false, false)),
        // One second of usability is too short.
        (4, [UP, UP], (1, 1, false, false)),
        (5, [UP, UP], (1, 1, false, false)),
        // A dropout restarts the hand-back time.
        (5, [DOWN, UP], (1, 1, false, false)),
        (6, [UP, UP], (1, 1, false, false)),
        (8, [UP, UP], (0, 0, true, false)),
        (9, [UP, UP], (0, 0, false, false)),
    ];
    let is_unknown: [Step; 2] =
        [(1, [DOWN, UNKNOWN], (0, 1, false, true)), (2, [DOWN, UP], (1, 1, true, false))];
    let all_down: [Step; 1] = [(1, [DOWN, DOWN], (0, 0, false, false))];
    for steps in [&goes_down[..], &is_unknown, &all_down] {
        let mut selector = Selector::new(Duration::from_secs(2));
        for (second, health, (active, preferred, switched, blocked)) in steps {
            let expected = Choice {
                active: *active,
                preferred: *preferred,
                switched: *switched,
                blocked: *blocked,
            };
            let found = selector.choose(Duration::from_secs(*second), health);
            assert_eq!(found, expected, "second {second} of {steps:?}");
        }
    }
}
