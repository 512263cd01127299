//! Limits, slews, paths and stops change at random while the correction moves: no fault, no word faster than the slew, and no motion
//! during a stop.

use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    BarrierLink, Cause, CorrectionReport, Interlock, Limits, ReadBack, Request, State,
    barrier::REPORT_WORDS,
};
use volcomp_vocabulary::PerChannel;

use crate::world::{self, MACHINE, PERIOD, SCAN, SLEW, STEP, World, axes, layout, same_places};

/// Random limits of up to 150 output steps.
fn any_limits(world: &World, random: &mut ChaCha8Rng) -> Limits {
    let mut limits = *world.guard.limits();
    let limit = f64::from(random.random_range(5..150)) * STEP;
    for axis in &mut limits.axes {
        (axis.limit, axis.warn) = (limit, limit);
    }
    limits
}

fn any_target(random: &mut ChaCha8Rng) -> PerChannel<f64> {
    let mut share = || random.random_range(-0.2..0.2);
    axes(share(), share())
}

/// Another path reports whether there is an emergency stop.
fn shows(world: &mut World, emergency_stop: bool) {
    let interlock = Interlock { emergency_stop, ..Interlock::default() };
    world.interlocks.update(1, Some(interlock));
}

fn read_standby(standby: &mut ReadBack, world: &World) {
    let Some(barrier) = &world.barrier else {
        return;
    };
    let mut words = [0; REPORT_WORDS];
    let length = barrier.report().encode(&mut words);
    let reported = CorrectionReport::Barrier(&words[..length]);
    standby.receive(world.now, world.now, &reported, world.guard.limits());
}

/// A barrier with a delay of some cycles, and a second path to it: random changes of limits are not a fault, words keep
/// the slew, and no axis moves in a stop.
#[test]
fn random_changes_of_limits_are_no_fault() {
    // Random seeds, and fixed ones: three in which an axis moved during a stop, one in which a sent correction was a fault.
    for seed in (0..60).chain([81, 237, 320, 1473]) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let late = random.random_range(0..5);
        let mut world = World::ramping(late, random.random_range(20..150));
        let takes_over = seed % 2 == 1;
        let mut standby = ReadBack::barrier(BarrierLink::new(99, MACHINE, layout(), SCAN));
        standby.also_sent(world.read_back.last_frame().expect("it moves"));
        // Words in transit at the start of the stop have arrived.
        let settled = 2 * late + 6;
        let (mut word, mut written) = (Some(world.guard.output()[0]), 0);
        let (mut stopped, mut stood) = (0_usize, world.applied);
        for cycle in 1..3000 {
            let mut request = None;
            let is_clear = world.interlocks.reasons().is_empty();
            match random.random_range(0..120) {
                0 | 1 => {
                    let limits = any_limits(&world, &mut random);
                    world.guard.set_limits(limits).expect("valid");
                    request = Some(Request::Switched);
                }
                2 if !world.emergency_stop => {
                    let emergency_stop = random.random();
                    shows(&mut world, emergency_stop);
                }
                3 if world.emergency_stop || is_clear => {
                    // The control is stopped for longer than another path reports the stop.
                    world.emergency_stop ^= true;
                    shows(&mut world, false);
                }
                4 => world.target = Some(any_target(&mut random)),
                5 if is_clear && !world.emergency_stop => world.holds ^= true,
                6 => request = Some(Request::Disarm),
                7..10 => request = Some(Request::Arm),
                10 | 11 if takes_over => {
                    let limits = any_limits(&world, &mut random);
                    if is_clear && !matches!(world.guard.state(), State::Faulted(_)) {
                        let places = same_places();
                        world.guard.take_path(limits, &places).expect("valid");
                        std::mem::swap(&mut world.read_back, &mut standby);
                        request = world.guard.state().is_armed().then_some(Request::TakeOver);
                        word = None;
                    }
                }
                _ => {}
            }
            let output = world.cycle_after(PERIOD, request);
            if let Some(frame) = world.read_back.last_frame() {
                standby.also_sent(frame);
            }
            let case = format!("seed {seed}, {late} late, cycle {cycle}, {:?}", output.state);
            let beyond = State::Faulted(Cause::BeyondLimit);
            assert_ne!(output.state, beyond, "{case}");
            let other = State::Faulted(Cause::OtherGateway);
            assert_ne!(output.state, other, "{case}: there is one gateway");
            if output.write {
                let now = output.correction[0];
                let change = word.map_or(0.0, |word| (now - word).abs());
                let passed_s = PERIOD.as_secs_f64() * f64::from(cycle - written);
                assert!(change <= SLEW * passed_s + STEP + 1e-9, "{case}: {change}");
                (word, written) = (Some(now), cycle);
            }
            if cycle % 8 == 0 {
                read_standby(&mut standby, &world);
            }
            let is_clear = world.interlocks.reasons().is_empty();
            stopped = if is_clear { 0 } else { stopped + 1 };
            if stopped == settled {
                stood = world.applied;
            }
            if stopped > settled && !world.holds {
                assert_eq!(world.applied, stood, "{case}");
            }
        }
    }
}

/// Permitted range of a correction, mm: one step plus the slew from every earlier value.
struct Window {
    lowest: f64,
    highest: f64,
}

impl Window {
    fn about(value: f64) -> Self {
        Self { lowest: value - STEP, highest: value + STEP }
    }

    /// Widens the range by the largest slew; returns how far the new value is outside.
    fn goes(&mut self, slewed: f64, value: f64) -> f64 {
        let (lowest, highest) = (self.lowest - slewed, self.highest + slewed);
        let about = Self::about(value);
        self.lowest = lowest.max(about.lowest);
        self.highest = highest.min(about.highest);
        (lowest - value).max(value - highest)
    }
}

/// Without a barrier, with a late or missing read-back, and with a path that has another axis order: random changes of
/// limits are not a fault.
#[test]
fn random_changes_of_limits_without_a_barrier_are_no_fault() {
    for seed in 0..400_u64 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let late = random.random_range(0..5);
        let mut world = World::new(&Limits { read_back_cycles: late + 2, ..world::limits() });
        world.report_delay = late;
        world.target = Some(axes(0.140, -0.070));
        world.request(Request::Arm);
        let mut windows = [0, 1].map(|i| Window::about(world.applied[i]));
        let mut slew = [SLEW; 2];
        for cycle in 1..2500 {
            let mut request = None;
            match random.random_range(0..150) {
                0..3 => {
                    let mut limits = any_limits(&world, &mut random);
                    let slew_per_s = [0.5, 0.25, 0.05, 0.01][random.random_range(0..4)];
                    let accel_per_s2 = [20.0, 1.0, f64::INFINITY][random.random_range(0..3)];
                    slew[1] = slew_per_s;
                    for axis in &mut limits.axes {
                        (axis.slew_per_s, axis.accel_per_s2) = (slew_per_s, accel_per_s2);
                    }
                    world.guard.set_limits(limits).expect("valid");
                    request = Some(Request::Switched);
                }
                3 | 4 => {
                    let emergency_stop = random.random();
                    shows(&mut world, emergency_stop);
                }
                5 => world.target = Some(any_target(&mut random)),
                6 => request = Some(Request::Disarm),
                7..10 => request = Some(Request::Arm),
                10 if seed % 2 == 1 && world.interlocks.reasons().is_empty() => {
                    let limits = any_limits(&world, &mut random);
                    let places = PerChannel::leading([Some(1), Some(0)]);
                    world.guard.take_path(limits, &places).expect("valid");
                    world.read_back = ReadBack::plain(Duration::ZERO);
                    world.read_back.take_over(world.now, false);
                    world.applied = axes(world.applied[1], world.applied[0]);
                    windows.reverse();
                }
                11 if seed % 3 == 1 => world.answers = false,
                12..16 => world.answers = true,
                _ => {}
            }
            let before = world.applied;
            let output = world.cycle_after(PERIOD, request);
            let case = format!("seed {seed}, {late} late, cycle {cycle}, {:?}", output.state);
            let is_beyond = output.state == State::Faulted(Cause::BeyondLimit);
            assert!(!is_beyond, "{case}");
            // A write decided before the slew was lowered may arrive afterwards.
            let slewed = slew[0].max(slew[1]) * PERIOD.as_secs_f64();
            slew[0] = slew[1];
            for (i, window) in windows.iter_mut().enumerate() {
                let outside = window.goes(slewed, world.applied[i]);
                assert!(outside <= 1e-9, "{case}: axis {i} by {outside} mm");
            }
            if world.applied != before {
                assert!(world.interlocks.reasons().is_empty(), "{case}");
            }
        }
    }
}
