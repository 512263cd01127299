//! A barrier behind a slow path, and controls whose program is slower than configured or has stopped.
//!
//! Limits, path or direction change before the sent corrections are confirmed.

use std::time::Duration;

use volcomp_guard::{
    Limits, Request, State,
    barrier::{Barrier, Settings},
    vocabulary::PerChannel,
};

use crate::world::{PERIOD, SCAN, SLEW, STEP, STOP, World, axes, barrier, limits};

const LATE: [usize; 5] = [0, 1, 2, 4, 6];

/// Observations of X over some cycles, mm.
#[derive(Debug, Default)]
struct Watch {
    word: Option<f64>,
    highest: f64,
    /// Largest backward motion of the axis, and largest excess of a word over the previous word plus slew plus step, mm.
    back: f64,
    jump: f64,
    /// Maximum number of consecutive cycles without a frame.
    unsent: u32,
    silent: u32,
}

impl Watch {
    fn of(world: &World) -> Self {
        Self { word: Some(world.guard.output()[0]), highest: world.applied[0], ..Self::default() }
    }

    /// Runs cycles, the first one with a request.
    fn look(&mut self, world: &mut World, cycles: u32, mut request: Option<Request>) -> State {
        let mut state = world.guard.state();
        for _ in 0..cycles {
            let output = world.cycle_after(PERIOD, request.take());
            self.silent = if output.write { 0 } else { self.silent + 1 };
            self.unsent = self.unsent.max(self.silent);
            let passed_s = PERIOD.as_secs_f64() * f64::from(self.silent + 1);
            if output.write {
                let before = self.word.replace(output.correction[0]);
                let change = before.map_or(0.0, |before| (output.correction[0] - before).abs());
                self.jump = self.jump.max(change - SLEW * passed_s - STEP);
            }
            self.highest = self.highest.max(world.applied[0]);
            self.back = self.back.max(self.highest - world.applied[0]);
            state = output.state;
        }
        state
    }
}

fn with_slew(limits: &Limits, part: f64) -> Limits {
    let mut limits = *limits;
    for axis in &mut limits.axes {
        axis.slew_per_s *= part;
    }
    limits
}

/// The slew is lowered in motion: frames continue in every cycle at the lower rate, since the barrier would time out otherwise.
#[test]
fn a_slew_lowered_in_motion_loses_no_correction() {
    for late in LATE {
        for after in [60, 80, 100, 120] {
            for part in [0.5, 0.2, 0.1, 0.02] {
                let mut world = World::ramping(late, after);
                let lower = with_slew(world.guard.limits(), part);
                world.guard.set_limits(lower).expect("valid");
                let mut watch = Watch::of(&world);
                watch.look(&mut world, 500, Some(Request::Switched));
                let case = format!("{late} late, after {after}, slew x {part}: {watch:?}");
                assert!(watch.back < 1e-9, "{case}");
                assert_eq!(watch.unsent, 0, "{case}");
                // From now on no word is faster than the lower rate, except for words already in transit.
                let word = world.guard.output()[0];
                watch.look(&mut world, 50, None);
                let most = part * SLEW * 50.0 * PERIOD.as_secs_f64() + STEP;
                assert!(world.guard.output()[0] - word <= most + 1e-9, "{case}");
            }
        }
    }
}

/// The request reverses at full rate while the confirmed correction still moves in the old direction: a frame is sent
/// in every cycle.
#[test]
fn a_correction_that_reverses_at_full_rate_is_sent_in_every_cycle() {
    for late in [0, 1, 2, 3, 4, 6] {
        for cycles in [20, 21, 30, 45] {
            let mut world = World::ramping(late, 500);
            let mut limits = *world.guard.limits();
            for axis in &mut limits.axes {
                axis.accel_per_s2 = f64::INFINITY;
            }
            world.guard.set_limits(limits).expect("valid");
            let mut watch = Watch::of(&world);
            for turn in 0..4 {
                world.target = Some(axes(if turn % 2 == 0 { -0.140 } else { 0.140 }, 0.0));
                watch.look(&mut world, cycles, None);
            }
            let case = format!("{late} late, {cycles}: {watch:?}");
            assert_eq!(watch.unsent, 0, "{case}");
            assert!(watch.jump <= 1e-9, "{case}");
        }
    }
}

/// Another path to the same barrier takes over while words are in transit: the axis does not reverse, and the words
/// keep their rate.
#[test]
fn another_path_to_the_same_barrier_takes_over_in_motion() {
    for late in LATE {
        for after in [60, 80, 100] {
            // With changed limits, also shortly after a slew was lowered.
            for (before, then) in [(1.0, 1.0), (1.0, 0.1), (0.1, 0.1)] {
                let mut world = World::ramping(late, after);
                let limits = *world.guard.limits();
                let mut watch = Watch::of(&world);
                if before < 1.0 {
                    let lower = with_slew(&limits, before);
                    world.guard.set_limits(lower).expect("valid");
                    watch.look(&mut world, 1, Some(Request::Switched));
                }
                world.take_other_path(&with_slew(&limits, then));
                watch.look(&mut world, 300, Some(Request::TakeOver));
                let case = format!("{late} late, after {after}, {before} {then}: {watch:?}");
                assert!(watch.back <= 1e-9 && watch.jump <= 1e-9, "{case}");
                world.guard.set_limits(limits).expect("valid");
                let state = world.run(Duration::from_secs(2)).state;
                assert_eq!(state, State::Compensating, "{case}");
            }
        }
    }
}

/// For every request in the cycle of the take-over, the state is `arming` until the ramp is complete, then `compensating`.
#[test]
fn another_path_starts_with_a_ramp_for_every_request() {
    let requested_at =
        [None, Some(Request::Acknowledge), Some(Request::Arm), Some(Request::Switched)];
    for request in requested_at {
        let mut world = World::guarded(&limits()).arm();
        let limits = *world.guard.limits();
        world.take_other_path(&limits);
        let output = world.cycle_after(PERIOD, request);
        assert_eq!(output.state.name(), "arming", "{request:?}");
        let output = world.run(Duration::from_secs(2));
        assert_eq!(output.state, State::Compensating, "{request:?}");
    }
}

/// A path takes over in the cycle in which another path first reports a stop that the control does not make: the axis
/// does not reverse.
#[test]
fn a_path_that_takes_over_in_a_stop_does_not_reverse_an_axis() {
    for late in LATE {
        let mut world = World::ramping(late, 80);
        let limits = *world.guard.limits();
        world.take_other_path(&limits);
        world.interlocks.update(1, STOP);
        let mut watch = Watch::of(&world);
        watch.look(&mut world, 200, Some(Request::TakeOver));
        assert!(watch.back <= 1e-9, "{late} late: {watch:?}");
    }
}

/// Long after the last words were sent, none of them is in transit: a path that takes over starts at the confirmed
/// correction.
#[test]
fn words_sent_long_before_a_take_over_are_not_carried_over() {
    for late in LATE {
        let mut world = World::ramping(late, 80);
        let limits = *world.guard.limits();
        // The control accepts no frame and does not move.
        world.sticks = false;
        world.holds = true;
        world.run(Duration::from_millis(20));
        world.answers = false;
        world.run(Duration::from_millis(120));
        world.take_other_path(&limits);
        (world.answers, world.sticks, world.holds) = (true, true, false);
        let stood = world.applied[0];
        assert!(world.guard.output()[0] > stood, "{late} late");
        world.request(Request::TakeOver);
        let word = world.guard.output()[0];
        assert!(word <= stood + STEP + 1e-9, "{late} late: {word} {stood}");
    }
}

/// Words of a path without a barrier cannot arrive at a barrier: the output starts at the correction that the barrier applies.
#[test]
fn a_barrier_takes_over_at_what_it_applies() {
    let mut world = World::compensating(&limits());
    assert!(world.guard.output()[0] > 10.0 * STEP);
    (world.barrier, world.applied) = (Some(barrier()), PerChannel::ZERO);
    world.take_other_path(&limits());
    let mut output = world.request(Request::TakeOver);
    while !output.write {
        output = world.run(Duration::ZERO);
    }
    let word = output.correction[0];
    assert!(word <= 2.0 * STEP + 1e-9, "{word}");
}

/// In a late cycle a frame fails. In the next, short cycle its word is farther away than the rate permits: at most five
/// frames are omitted until the word is reachable.
#[test]
fn the_correction_continues_after_a_failed_frame_of_a_late_cycle() {
    for late in LATE {
        let mut world = World::ramping(late, 80);
        let mut watch = Watch::of(&world);
        let word = world.guard.output()[0];
        world.write_fails = true;
        world.cycle_after(5 * PERIOD, None);
        world.write_fails = false;
        assert_eq!(world.guard.output()[0], word, "{late} late");
        world.cycle_after(Duration::from_micros(250), None);
        watch.look(&mut world, 6, None);
        // At most as many cycles as the late cycle lasted.
        assert!(watch.unsent <= 5, "{late} late: {watch:?}");
        assert!(world.guard.output()[0] >= word, "{late} late");
        watch.look(&mut world, 300, None);
        assert!(watch.back <= 1e-9, "{late} late: {watch:?}");
        let state = world.run(Duration::from_secs(1)).state;
        assert_eq!(state, State::Compensating, "{late} late");
    }
}

/// Scans of 2.45 ms are accepted for a configured period of 2 ms. The guard assumes zero only after the longer time,
/// when X has reached zero.
#[test]
fn a_slow_control_is_at_zero_when_it_is_assumed_to_be() {
    let limits = Limits { zero_after: Duration::from_secs(3), ..limits() };
    // Timeout in scans, and transit time of the last frame, ms.
    for (time_out_scans, late_ms) in [(1000, 0), (100, 0), (100, 14)] {
        let settings = Settings { time_out_scans, ..barrier().report().settings };
        let barrier = Barrier::resume(settings, barrier().memory()).expect("valid");
        let mut world = World::guarded_by(&limits, barrier, SCAN);
        world.scan_time = Duration::from_micros(2450);
        world.target = Some(axes(0.140, 0.0));
        world.request(Request::Arm);
        world.run(Duration::from_secs(3));
        assert!((world.applied[0] - 0.140).abs() < 1e-9);
        let before = world.mailbox.clone();
        assert!(world.run(Duration::ZERO).write);
        let last = std::mem::replace(&mut world.mailbox, before);
        let sent = world.now;
        let wait = world.read_back.zero_after_last_write(&limits);
        while world.now <= sent + wait.expect("a barrier") {
            world.now += PERIOD;
            world.scan();
            if world.now >= sent + Duration::from_millis(late_ms) {
                world.mailbox.clone_from(&last);
            }
        }
        assert_eq!(world.applied, PerChannel::ZERO, "{time_out_scans} {late_ms}");
    }
}

/// The control's program has stopped but its interface still responds: the repeated report is never new, and the guard
/// sends no frame.
#[test]
fn a_report_with_a_constant_tick_is_never_new() {
    let mut world = World::guarded(&limits());
    world.scan_time = Duration::from_secs(3600);
    for cycle in 0..5400 {
        let request = (cycle >= 400).then_some(Request::Arm);
        let output = world.cycle_after(PERIOD, request);
        assert!(!output.write, "a frame at {:?}", world.now);
    }
}
