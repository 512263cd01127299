//! The test shift at arming: its verdict for each axis, and no verdict without evidence.

use std::{collections::VecDeque, f64::consts::TAU, time::Duration};

use volcomp_guard::{
    AxisLimits, AxisProof, Limits, MotionHistory, Proof, Reading, Reasons, Request, State, Verdict,
};
use volcomp_vocabulary::{AxisKind, PerChannel};

use AxisProof::{Contained, NotContained, NotProven};

use crate::world::{PERIOD, SECOND, STEP, World, axes, limits, same_places};

const SHIFT: f64 = 5.0 * STEP;
#[derive(Clone, Copy)]
struct Axis {
    contains: bool,
    /// The reported position, independent of the motion.
    frozen: Option<f64>,
    /// Delay of the reported position, cycles.
    lag: usize,
    creep_mm_per_s: f64,
    /// Amplitude of the flicker of one count.
    flicker: f64,
    /// The axis does not move before the proof.
    stood: bool,
    /// Factor of the applied correction if the control uses another unit than configured.
    factor: Option<f64>,
    /// The position wraps after one turn.
    rolls_over: bool,
}

/// A moving axis whose position does not contain the correction.
const PLAIN: Axis = Axis {
    contains: false,
    frozen: None,
    lag: 0,
    creep_mm_per_s: 0.0,
    flicker: 0.0,
    stood: false,
    factor: None,
    rolls_over: false,
};
const CONTAINS: Axis = Axis { contains: true, ..PLAIN };

struct Rig {
    limits: Limits,
    moves: MotionHistory,
    now: Duration,
    machine: [Axis; 2],
    history: VecDeque<[f64; 2]>,
    place: f64,
    output: PerChannel<f64>,
    /// Rate of the device's clock, by which readings are dated, as a multiple of the true rate.
    clock_rate: u32,
}

impl Rig {
    fn new(limits: &Limits, machine: [Axis; 2], from: PerChannel<f64>) -> Self {
        let mut rig = Self {
            limits: Limits { test_shift: PerChannel([SHIFT; 9]), ..*limits },
            moves: MotionHistory::default(),
            now: SECOND,
            machine,
            history: VecDeque::new(),
            place: 10.0,
            output: from,
            clock_rate: 1,
        };
        for cycle in 0..100 {
            rig.place = 10.0 + 0.01 * f64::from(cycle);
            rig.reading();
        }
        rig
    }

    fn reading(&mut self) -> PerChannel<f64> {
        self.now += PERIOD;
        let seconds = self.now.as_secs_f64();
        let now: [f64; 2] = std::array::from_fn(|i| {
            let axis = &self.machine[i];
            let place = if axis.stood { 10.0 } else { self.place };
            let applied = axis.factor.unwrap_or(1.0) * self.output[i];
            let contained = if axis.contains { applied } else { 0.0 };
            let even = (self.now.as_millis() / 24).is_multiple_of(2);
            place
                + contained
                + axis.creep_mm_per_s * seconds
                + if even { axis.flicker } else { 0.0 }
        });
        self.history.push_front(now);
        let positions = axes_of(|i| {
            let axis = &self.machine[i];
            let late = axis.lag.min(self.history.len() - 1);
            let position = axis.frozen.unwrap_or(self.history[late][i]);
            if axis.rolls_over { position.rem_euclid(TAU) } else { position }
        });
        self.moves.update(self.now, &positions, &self.output, &self.limits);
        positions
    }

    /// Runs a proof from the current output; returns the verdict, and minimum and maximum of the first axis's output.
    fn prove(&mut self, most: Duration) -> (Option<Verdict>, [f64; 2]) {
        let (mut proof, from) = (Proof::default(), self.output);
        let mut reached = [f64::INFINITY, f64::NEG_INFINITY];
        let end = self.now + most;
        while self.now < end {
            let positions = self.reading();
            let (now, output) = (self.now, self.output);
            let reading = Reading { taken: now * self.clock_rate, positions };
            let verdict = proof.read(now, &reading, &output, &from, &self.limits, &self.moves);
            if verdict.is_some() {
                return (verdict, reached);
            }
            let goal = proof.goal(&from, &self.limits);
            // At the slew: 2 µm per cycle.
            self.output =
                PerChannel::from_fn(|i| output[i] + (goal[i] - output[i]).clamp(-0.002, 0.002));
            reached = [reached[0].min(self.output[0]), reached[1].max(self.output[0])];
        }
        (None, reached)
    }
}

fn axes_of(of: impl Fn(usize) -> f64) -> PerChannel<f64> {
    axes(of(0), of(1))
}

fn proven(machine: [Axis; 2]) -> [AxisProof; 2] {
    let (verdict, _) = Rig::new(&limits(), machine, PerChannel::ZERO).prove(20 * SECOND);
    let axes = verdict.expect("a verdict").axes;
    [axes[0], axes[1]]
}

#[test]
fn each_axis_has_its_own_result() {
    let (plain, contains) = (PLAIN, CONTAINS);
    let stood = Axis { stood: true, ..plain };
    let frozen = Axis { frozen: Some(3.0), contains: true, ..plain };
    assert_eq!(proven([plain, contains]), [NotContained, Contained]);
    assert_eq!(proven([stood, frozen]), [NotProven, NotProven]);
    // A position that follows in both directions contains the correction, even if the axis was at rest before.
    let stood_contains = Axis { stood: true, ..contains };
    assert_eq!(proven([stood_contains, stood]), [Contained, NotProven]);
}

/// If the control's words have another unit, a position that follows in both directions by another factor is a
/// contradiction. A tenth of the shift is below one count of a flickering position and counts as not following.
#[test]
fn a_position_that_follows_by_another_factor_is_a_contradiction() {
    for factor in [2.0, 10.0, 17.45, 0.5, 0.1, -1.0, -3.0] {
        for includes_correction in [false, true] {
            let mut limits = limits();
            for axis in &mut limits.axes {
                axis.includes_correction = includes_correction;
            }
            let wrong = Axis { contains: true, factor: Some(factor), ..PLAIN };
            let machine = [wrong, PLAIN];
            let (verdict, reached) = Rig::new(&limits, machine, PerChannel::ZERO).prove(5 * SECOND);
            let verdict = verdict.expect("after the first attempt");
            let stays = factor == 0.1;
            assert!(!stays || verdict.axes[0] == NotContained);
            assert_eq!(verdict.contradicts[0], includes_correction || !stays);
            assert_eq!(verdict.is_contradiction(), verdict.contradicts[0]);
            assert!(reached.iter().all(|word| word.abs() <= SHIFT + 1e-9));
        }
    }
}

/// A rotary table at zero, which is also one turn: the test shift across the wrap gives the right verdict.
#[test]
fn a_shift_across_the_roll_over_is_found() {
    let mut limits = limits();
    limits.axes[0].kind = AxisKind::Rotary;
    limits.axes[0].includes_correction = true;
    for contains in [true, false] {
        let table = Axis { contains, rolls_over: true, ..PLAIN };
        for past in [-0.004, -0.001, 0.0, 0.001, 0.004] {
            let mut rig = Rig::new(&limits, [table, PLAIN], PerChannel::ZERO);
            rig.place = 2.0 * TAU + past;
            let (verdict, _) = rig.prove(5 * SECOND);
            let verdict = verdict.expect("a verdict");
            let truth = if contains { Contained } else { NotContained };
            assert_eq!(verdict.axes[0], truth, "{past}");
        }
    }
}

/// One write that is not sent, also with the axes at rest, does not prevent the proof from completing.
#[test]
fn one_unsent_write_does_not_block_the_proof() {
    for missed in 0..300 {
        let mut limits = limits();
        limits.test_shift = PerChannel([SHIFT; 9]);
        let mut world = World::new(&limits);
        world.request(Request::Arm);
        for cycle in 0..2500 {
            (world.write_fails, world.sticks) = (cycle == missed, cycle != missed);
            world.run(Duration::ZERO);
            if world.guard.state() == State::Compensating {
                break;
            }
        }
        assert_eq!(world.guard.state(), State::Compensating, "write {missed}");
    }
}

/// A position that follows the shift late, creeps, or flickers by a quarter of the shift gives the right verdict or none.
#[test]
fn slow_creeping_and_flickering_positions() {
    for contains in [false, true] {
        let axis = Axis { contains, ..PLAIN };
        let truth = if contains { Contained } else { NotContained };
        // Timestamps of a fast clock do not make the standstill longer.
        for (lag, clock_rate) in [(1, 1), (5, 1), (25, 1), (60, 1), (60, 20)] {
            let mut rig = Rig::new(&limits(), [Axis { lag, ..axis }, PLAIN], PerChannel::ZERO);
            rig.clock_rate = clock_rate;
            let verdict = rig.prove(20 * SECOND).0.expect("a verdict");
            assert_eq!(verdict.axes[0], truth, "lag {lag}, clock {clock_rate}");
        }
        // A position that is later than the required standstill gives no verdict or the right verdict.
        for lag in [65, 70, 80, 100, 120] {
            let [shown, _] = proven([Axis { lag, ..axis }, PLAIN]);
            let believed = [truth, NotProven];
            assert!(believed.contains(&shown), "lag {lag}: {shown:?}");
        }
        let flicker = Axis { flicker: SHIFT / 4.0, ..axis };
        assert_eq!(proven([flicker, PLAIN])[0], truth);
    }
    // Creep as fast as the slowest response to the shift matches the shift in one direction but not in the other.
    for creep_mm_per_s in [0.002, 0.004, 0.01, 0.015, 0.02, -0.015] {
        let creeps = Axis { creep_mm_per_s, ..PLAIN };
        let mut rig = Rig::new(&limits(), [creeps, PLAIN], PerChannel::ZERO);
        let (verdict, _) = rig.prove(20 * SECOND);
        let shown = verdict.map_or(NotProven, |verdict| verdict.axes[0]);
        assert_ne!(shown, Contained, "{creep_mm_per_s} mm/s");
    }
}

/// The shift goes in both directions and back; near the limit it goes inwards only.
#[test]
fn the_shift_goes_both_ways_and_stays_within_the_limit() {
    let machine = [CONTAINS; 2];
    for (from, expected) in [
        (0.0, [-SHIFT, SHIFT]),
        (0.040, [0.035, 0.045]),
        (-0.040, [-0.045, -0.035]),
        (0.150, [0.145, 0.150]),
        (0.147, [0.142, 0.147]),
        (0.145, [0.140, 0.150]),
        (-0.150, [-0.150, -0.145]),
        // A correction left from a larger limit is reduced first.
        (0.162, [0.145, 0.162]),
    ] {
        let mut rig = Rig::new(&limits(), machine, axes(from, 0.0));
        let (verdict, reached) = rig.prove(5 * SECOND);
        assert_eq!(verdict.expect("a verdict").axes[0], Contained);
        for (found, expected) in reached.iter().zip(expected) {
            assert!((found - expected).abs() < 0.0021, "{from}: {reached:?}");
        }
        assert!(from.abs() > 0.15 || reached.iter().all(|at| at.abs() <= 0.150 + 1e-9));
    }
}

#[test]
fn an_axis_without_a_shift_is_not_proven_and_does_not_block() {
    let mut rig = Rig::new(&limits(), [PLAIN; 2], PerChannel::ZERO);
    rig.limits.test_shift[1] = 0.0;
    let verdict = rig.prove(5 * SECOND).0.expect("a verdict");
    assert_eq!(verdict.axes[..2], [NotContained, NotProven]);
    assert_eq!(verdict.proven[..2], [true, false]);
    assert!(!verdict.is_contradiction());
}

#[test]
fn a_contradiction_names_its_axis() {
    let contains = CONTAINS;
    let mut of_limits = limits();
    of_limits.axes[0].includes_correction = true;
    let mut rig = Rig::new(&of_limits, [contains, contains], PerChannel::ZERO);
    let verdict = rig.prove(5 * SECOND).0.expect("a verdict");
    assert_eq!(verdict.contradicts[..2], [false, true]);
    let mut rig = Rig::new(&of_limits, [PLAIN; 2], PerChannel::ZERO);
    let verdict = rig.prove(5 * SECOND).0.expect("a verdict");
    assert_eq!(verdict.contradicts[..2], [true, false]);
}

#[test]
fn only_motion_of_the_last_ten_seconds_counts() {
    for (wait, expected) in [(8, NotContained), (10, NotProven)] {
        let mut rig = Rig::new(&limits(), [PLAIN; 2], PerChannel::ZERO);
        let end = rig.now + wait * SECOND;
        while rig.now < end {
            rig.reading();
        }
        let verdict = rig.prove(5 * SECOND).0.expect("a verdict");
        assert_eq!(verdict.axes[0], expected, "{wait} s");
    }
}

/// The applied correction does not count as motion of the axis, whether positions contain it or not.
#[test]
fn a_correction_is_no_motion_of_the_axis() {
    for contains in [false, true] {
        let axis = Axis { contains, stood: true, ..PLAIN };
        let mut rig = Rig::new(&limits(), [axis; 2], PerChannel::ZERO);
        for cycle in 0..500 {
            rig.output[0] = 0.1 * (f64::from(cycle) * 0.05).sin();
            rig.reading();
        }
        assert!(!rig.moves.moved_recently(rig.now, 0));
        assert!(!rig.moves.moved_recently(rig.now, 1));
        rig.machine[0].stood = false;
        rig.reading();
        assert!(rig.moves.moved_recently(rig.now, 0));
        assert!(!rig.moves.moved_recently(rig.now + 11 * SECOND, 0));
        assert!(!rig.moves.moved_recently(rig.now, 99));
    }
}

/// A constant position with fresh timestamps is not proof that the position excludes the correction: the axis is not proven.
#[test]
fn a_frozen_position_is_reported_as_not_proven() {
    let mut world = World::new(&Limits { test_shift: PerChannel([SHIFT; 9]), ..limits() });
    world.really_includes = true;
    let frozen = world.positions;
    world.request(Request::Arm);
    let mut last = None;
    for _ in 0..800 {
        // The reported position is constant, whatever correction is applied.
        world.positions = PerChannel::from_fn(|i| frozen[i] - world.applied[i]);
        last = Some(world.run(Duration::ZERO));
    }
    let last = last.expect("cycles");
    assert!(last.reasons.contains(Reasons::NOT_PROVEN), "{:?}", last.state);
    assert_eq!(world.guard.verdict().proven[..2], [false, false]);
}

/// Positions of another path have another zero. The difference does not count as motion: a frozen position stays
/// unproven after a change of path.
#[test]
fn a_frozen_position_proves_nothing_after_a_change_of_paths() {
    let limits = Limits { test_shift: PerChannel([SHIFT; 9]), ..limits() };
    let mut world = World::new(&limits);
    world.positions = axes(100.0, 100.0);
    world.run(SECOND);
    world.guard.take_path(limits, &same_places()).expect("valid");
    world.positions = axes(100.2, 100.2);
    world.run(PERIOD);
    world.request(Request::Arm);
    assert_eq!(world.run(3 * SECOND).state, State::Compensating);
    assert_eq!(world.guard.verdict().axes[..2], [NotProven; 2]);
}

const COUNT_RAD: f64 = 17.453_292_519_943_295e-6;

/// X and a rotary table. A test shift of 5 µm on X rotates the table by four counts of 0.001°.
fn with_table(includes_correction: bool) -> Limits {
    let mut limits = limits();
    limits.axes[1] = AxisLimits {
        kind: AxisKind::Rotary,
        limit: 400e-6,
        warn: 400e-6,
        slew_per_s: 2e-3,
        resolution: COUNT_RAD,
        ..limits.axes[0]
    };
    limits.test_shift = axes(SHIFT, 4.0 * COUNT_RAD);
    for axis in &mut limits.axes {
        axis.includes_correction = includes_correction;
    }
    limits
}

/// Arms a machine whose table rotates under a tool `lever_mm` off its centre; returns the largest tip error (mm) and table rotation (rad)
/// during the proof.
fn proves(world: &mut World, lever_mm: f64) -> [f64; 2] {
    (world.target, world.follow[1][0]) = (Some(PerChannel::ZERO), lever_mm);
    world.run(PERIOD);
    world.positions = axes(1.0, 1.0);
    world.run(PERIOD);
    world.request(Request::Arm);
    let (mut off, mut turned) = (0.0_f64, 0.0_f64);
    for _ in 0..2000 {
        if world.run(Duration::ZERO).state == State::Compensating {
            break;
        }
        off = off.max((world.applied[0] - lever_mm * world.applied[1]).abs());
        turned = turned.max(world.applied[1].abs());
    }
    assert_eq!(world.guard.state(), State::Compensating);
    [off, turned]
}

/// X and a table are shifted together under a tool 400 mm off the table's centre, so that the tip stays within 5 µm. A separate shift of
/// the table would move the tip by 33 µm.
#[test]
fn the_tip_stays_while_a_rotary_axis_is_shifted() {
    for includes_correction in [true, false] {
        let mut world = World::new(&with_table(includes_correction));
        world.really_includes = includes_correction;
        let [off, turned] = proves(&mut world, 400.0);
        // The shift of X, or half a step each of the table and of X.
        assert!(off < SHIFT + 1e-9, "{off}");
        assert!((turned - 4.0 * COUNT_RAD).abs() < 1e-9, "{turned}");
        let truth = if includes_correction { Contained } else { NotContained };
        assert_eq!(world.guard.verdict().axes[..2], [truth; 2]);
        let output = world.run(PERIOD);
        assert!(!output.reasons.contains(Reasons::NOT_PROVEN));
    }
}

/// Readings count towards the proof only while the applied correction is confirmed and a correction is requested.
/// Otherwise the proof waits.
#[test]
fn a_disturbed_proof_waits() {
    let limits = Limits { test_shift: PerChannel([SHIFT; 9]), ..limits() };
    let arming = || {
        let mut world = World::new(&limits);
        world.positions = axes(1.0, 1.0);
        world.run(PERIOD);
        world.request(Request::Arm);
        world
    };
    let is_proven = |world: &World| world.guard.verdict().proven[..2] == [true, true];
    let mut world = arming();
    let mut cycles = 0;
    while !is_proven(&world) {
        world.run(Duration::ZERO);
        cycles += 1;
        assert!(cycles < 2000);
    }
    for is_confirmed in [false, true] {
        let mut world = arming();
        // The disturbance starts 120 ms before the end. After 50 ms it interrupts the proof; after 500 ms the arming
        // ends.
        world.run((cycles - 30) * PERIOD);
        world.hides_correction = !is_confirmed;
        let target = world.target.take_if(|_| is_confirmed);
        world.run(100 * PERIOD);
        assert!(!is_proven(&world), "{is_confirmed}");
        (world.hides_correction, world.target) = (false, world.target.or(target));
        world.run(2 * SECOND);
        assert_eq!(world.guard.state(), State::Compensating);
        assert!(is_proven(&world), "{is_confirmed}");
    }
}

/// If the limits of the linear axes do not permit following, the rotary axis is not shifted, and is reported as not
/// proven.
#[test]
fn a_rotary_axis_that_cannot_be_followed_is_not_shifted() {
    let mut world = World::new(&with_table(false));
    let [_, turned] = proves(&mut world, 3000.0);
    assert!(turned == 0.0);
    assert_eq!(world.guard.verdict().axes[..2], [NotContained, NotProven]);
    let output = world.run(PERIOD);
    assert!(output.reasons.contains(Reasons::NOT_PROVEN));
}

/// Positions arrive every 1 ms to 2 s, each one interval old: the verdict is right, and a wrong `includes_correction`
/// is a fault. At 1.5 s or more, "not proven" is permitted if positions exclude the correction.
#[test]
fn slow_positions_prove_what_they_contain() {
    let ms = Duration::from_millis;
    for every in [1, 4, 20, 60, 100, 300, 1000, 1500, 2000] {
        for (really, said) in [(true, true), (false, false), (true, false), (false, true)] {
            let mut limits = Limits {
                period: ms(every.clamp(1, 10)),
                hold: 5 * SECOND,
                zero_after: 5 * SECOND,
                only_thermal: true,
                test_shift: PerChannel([SHIFT; 9]),
                ..limits()
            };
            for axis in &mut limits.axes {
                axis.includes_correction = said;
            }
            let mut world = World::new(&limits);
            world.positions_every = Some(ms(every));
            world.really_includes = really;
            let mut run = |time: Duration, request| {
                let end = world.now + time;
                let mut output = world.cycle_after(limits.period, request);
                while world.now < end && output.state != State::Compensating {
                    output = world.cycle_after(limits.period, None);
                }
                world.positions = axes(1.0, -1.0);
                (output, world.guard.verdict().axes)
            };
            run(3 * ms(every), None);
            run(3 * ms(every), None);
            let (output, shown) = run(60 * SECOND, Some(Request::Arm));
            let truth = if really { Contained } else { NotContained };
            // Five readings at this interval take longer than a position counts as alive.
            if every >= 1500 && !really {
                assert!([truth, NotProven].contains(&shown[0]), "{shown:?}");
                assert_eq!(output.state, State::Compensating);
                continue;
            }
            assert_eq!(shown[..2], [truth; 2], "{every} ms, {:?}", output.state);
            let faulted = matches!(output.state, State::Faulted(_));
            assert_eq!(faulted, really != said, "{every} ms: {:?}", output.state);
            let contradicts = output.reasons.contains(Reasons::CONTRADICTION);
            assert!(contradicts == faulted && !output.reasons.contains(Reasons::NOT_PROVEN));
            assert!(!faulted || world.applied == PerChannel::ZERO);
        }
    }
}
