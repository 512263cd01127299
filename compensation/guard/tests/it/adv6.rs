//! Limits, slews and ways that change while the correction moves.

use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    BarrierLink, Cause, DirectionMemory, Interlock, Limits, ReadBack, Request, State,
};
use volcomp_vocabulary::{AxisKind, Direction, PerChannel};

use crate::world::{self, MACHINE, PERIOD, SCAN, STEP, World, axes, layout, same_places};

/// A barrier some cycles away, in the middle of the ramp of a correction to 140 µm.
fn in_motion(late: usize, after: u32) -> World {
    let mut world = World::guarded(&Limits {
        read_back_cycles: 2 * late + 2,
        ..world::limits()
    });
    (world.sent_late, world.told_late) = (late, late);
    world.target = Some(axes(0.140, -0.070));
    world.request(Request::Arm);
    world.run(after * PERIOD);
    world
}

/// Other limits with a lower slew: the correction goes on more slowly, and is not lost.
#[test]
fn a_slew_lowered_in_motion_behind_a_slow_way_loses_no_correction() {
    let mut wrong = Vec::new();
    for late in [0, 1, 2, 4, 6] {
        for after in [60, 80, 100, 120] {
            for part in [0.5, 0.2, 0.1, 0.02] {
                let mut world = in_motion(late, after);
                let before = world.applied[0];
                let mut limits = *world.guard.limits();
                for axis in &mut limits.axes {
                    axis.slew_per_s *= part;
                }
                world.guard.set_limits(limits).expect("good limits");
                world.request(Request::Switched);
                let mut least = f64::INFINITY;
                let mut states = Vec::new();
                let mut unsent = 0;
                for _ in 0..500 {
                    let output = world.cycle_after(PERIOD, None);
                    unsent += u32::from(!output.write);
                    least = least.min(world.applied[0]);
                    if states.last() != Some(&output.state) {
                        states.push(output.state);
                    }
                }
                if least < before - 0.005 {
                    wrong.push(format!(
                        "{late} late, after {after}, slew x {part}: {:.0} um to {:.0} um, {unsent} unsent, {states:?}",
                        before * 1e3,
                        least * 1e3
                    ));
                }
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "{} cases:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

/// How far X goes back at most while it is ramped to 140 µm and another way to the same barrier takes over, mm, and by how
/// much its word changes more than the slew allows.
fn goes_back(late: usize, after: u32) -> (f64, f64) {
    let mut world = in_motion(late, after);
    let limits = *world.guard.limits();
    let link = BarrierLink::new(99, MACHINE, layout(), SCAN);
    let mut standby = ReadBack::barrier(link);
    std::mem::swap(&mut world.read_back, &mut standby);
    world.guard.take_path(limits, &same_places()).expect("good");
    let mut word = world.guard.output()[0];
    let mut request = Some(Request::TakeOver);
    let (mut highest, mut back, mut jump) = (world.applied[0], 0.0_f64, 0.0_f64);
    for _ in 0..300 {
        let output = world.cycle_after(PERIOD, request.take());
        if output.write {
            let change = (output.correction[0] - word).abs();
            jump = jump.max(change - 0.5 * PERIOD.as_secs_f64() - STEP);
            word = output.correction[0];
        }
        highest = highest.max(world.applied[0]);
        back = back.max(highest - world.applied[0]);
    }
    assert_eq!(world.run(Duration::from_secs(2)).state, State::Compensating);
    (back, jump)
}

/// What was sent before is on its way to the same barrier; the axis neither goes back nor faster than its slew.
#[test]
fn another_way_to_the_same_barrier_takes_over_in_motion_without_going_back() {
    let mut wrong = Vec::new();
    for late in [0, 1, 2, 4, 6] {
        for after in [60, 80, 100] {
            let (back, jump) = goes_back(late, after);
            if back > 2.0 * STEP + 1e-9 || jump > 1e-9 {
                wrong.push(format!(
                    "{late} late, after {after}: axis back {:.1} um, word {:.1} um beyond slew and step",
                    back * 1e3, jump * 1e3
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The same in the cycle in which a stop is first seen, on the way that takes over.
#[test]
fn a_way_that_takes_over_and_shows_a_stop_moves_no_axis_back() {
    let mut wrong = Vec::new();
    for late in [0, 1, 2, 4, 6] {
        let mut world = in_motion(late, 80);
        let limits = *world.guard.limits();
        let link = BarrierLink::new(99, MACHINE, layout(), SCAN);
        world.read_back = ReadBack::barrier(link);
        world.guard.take_path(limits, &same_places()).expect("good");
        // The control itself does not hold: another path shows the stop.
        world.interlocks.see(
            1,
            Some(Interlock {
                emergency_stop: true,
                ..Interlock::default()
            }),
        );
        let mut highest = world.applied[0];
        let mut back = 0.0_f64;
        world.request(Request::TakeOver);
        for _ in 0..200 {
            world.cycle_after(PERIOD, None);
            highest = highest.max(world.applied[0]);
            back = back.max(highest - world.applied[0]);
        }
        if back > STEP + 1e-9 {
            wrong.push(format!(
                "{late} late: {:.1} um back in the stop",
                back * 1e3
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// X, and A of which X follows the turn: limits are lowered before arming, and the machine moves, so that X follows A a
/// little differently in every cycle. The correction comes in all the same.
#[test]
fn limits_lowered_before_arming_come_in_while_the_machine_moves() {
    let mut limits = world::limits();
    limits.axes[1].kind = AxisKind::Rotary;
    limits.axes[1].limit = 0.0015;
    limits.axes[1].warn = 0.001;
    limits.axes[1].slew_per_s = 0.0005;
    limits.axes[1].resolution = 1e-6;
    limits.test_shift = axes(0.005, 20e-6);
    for moves in [false, true] {
        let mut world = World::new(&limits);
        world.target = Some(axes(0.140, 0.0));
        world.positions = axes(10.0, 0.5);
        world.follow = PerChannel::default();
        world.follow[1] = axes(100.0, 0.0);
        world.request(Request::TakeOver);
        world.run(Duration::from_secs(3));
        assert_eq!(world.guard.state(), State::Compensating);
        let left = world.applied;
        world.request(Request::TakeOver);
        // Left over: the gateway begins anew with what the words hold.
        let mut lower = limits;
        lower.axes[0].limit = 0.030;
        lower.axes[0].warn = 0.030;
        let mut fresh = World::new(&limits);
        fresh.applied = axes(left[0], 200e-6);
        fresh.positions = axes(10.0, 0.5);
        fresh.follow[1] = axes(100.0, 0.0);
        fresh.run(Duration::from_secs(1));
        fresh.guard.set_limits(lower).expect("good");
        fresh.target = Some(axes(0.010, 0.0));
        fresh.request(Request::Arm);
        assert_eq!(fresh.guard.state().name(), "arming");
        for cycle in 0..1000 {
            if moves {
                fresh.positions[1] += 1e-4;
                fresh.positions[0] += 0.01;
                fresh.follow[1] = axes(100.0 + 0.05 * f64::from(cycle), 0.0);
            }
            fresh.cycle_after(PERIOD, None);
        }
        let at = fresh.applied[0];
        assert!(
            at <= 0.030 + 1e-9,
            "moves {moves}: {:.1} um 4 s after, {:?}",
            at * 1e3,
            fresh.guard.state()
        );
    }
}

/// Whatever is done with limits and stops: no fault, no word faster than the slew, no axis that moves in a stop.
#[test]
fn random_changes_of_limits_are_no_fault() {
    let mut wrong = Vec::new();
    for seed in 0..400 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let late = random.random_range(0..5);
        let mut world = in_motion(late, random.random_range(20..150));
        let takes_over = seed % 2 == 1;
        let link = BarrierLink::new(99, MACHINE, layout(), SCAN);
        let mut standby = ReadBack::barrier(link);
        let settle = 2 * late as u32 + 6;
        let (mut word, mut stopped, mut stood) = (world.guard.output()[0], 0_u32, world.applied);
        let mut done = Vec::new();
        let mut written = 0;
        for cycle in 1..3000 {
            let mut request = None;
            let what = random.random_range(0..120);
            match what {
                0 | 1 => {
                    let limit = f64::from(random.random_range(5..150)) * STEP;
                    let mut limits = *world.guard.limits();
                    for axis in &mut limits.axes {
                        (axis.limit, axis.warn) = (limit, limit);
                    }
                    world.guard.set_limits(limits).expect("good");
                    request = Some(Request::Switched);
                }
                2 if !world.emergency_stop => {
                    let e = random.random();
                    world.interlocks.see(
                        1,
                        Some(Interlock {
                            emergency_stop: e,
                            ..Interlock::default()
                        }),
                    );
                }
                3 if world.emergency_stop || world.interlocks.reasons().is_empty() => {
                    // The control is stopped for longer than any other path shows it.
                    world.emergency_stop ^= true;
                    world.interlocks.see(1, Some(Interlock::default()));
                }
                4 => {
                    world.target = Some(axes(
                        random.random_range(-0.2..0.2),
                        random.random_range(-0.2..0.2),
                    ));
                }
                5 if world.interlocks.reasons().is_empty() && !world.emergency_stop => {
                    world.holds ^= true;
                }
                6 => request = Some(Request::Disarm),
                7..10 => request = Some(Request::Arm),
                10 | 11 if takes_over => {
                    let mut limits = *world.guard.limits();
                    let limit = f64::from(random.random_range(5..150)) * STEP;
                    for axis in &mut limits.axes {
                        (axis.limit, axis.warn) = (limit, limit);
                    }
                    if world.interlocks.reasons().is_empty()
                        && !matches!(world.guard.state(), State::Faulted(_))
                    {
                        world.guard.take_path(limits, &same_places()).expect("good");
                        std::mem::swap(&mut world.read_back, &mut standby);
                        request = world.guard.state().is_armed().then_some(Request::TakeOver);
                        word = f64::NAN;
                    }
                }
                _ => {}
            }
            if what < 12 {
                done.push((cycle, what));
            }
            let before = world.applied;
            let output = world.cycle_after(PERIOD, request);
            if matches!(output.state, State::Faulted(Cause::BeyondLimit)) {
                done.reverse();
                done.truncate(8);
                wrong.push(format!(
                    "{seed}, {late} late, cycle {cycle}: beyond, {done:?}"
                ));
                break;
            }
            if output.write {
                let change = (output.correction[0] - word).abs();
                if change > 0.5 * PERIOD.as_secs_f64() * f64::from(cycle - written) + STEP + 1e-9 {
                    done.reverse();
                    done.truncate(8);
                    wrong.push(format!(
                        "{seed}, {late} late, cycle {cycle}: word by {:.1} um, {done:?} {:?}",
                        change * 1e3,
                        output.state
                    ));
                    break;
                }
                word = output.correction[0];
                written = cycle;
            }
            // The other way stands by, and is asked now and then.
            if let Some(barrier) = world.barrier.as_ref().filter(|_| cycle % 8 == 0) {
                let mut words = [0; volcomp_guard::barrier::REPORT_WORDS];
                let length = barrier.report().encode(&mut words);
                let limits = *world.guard.limits();
                standby.hear(
                    world.now,
                    world.now,
                    &volcomp_guard::Told::Report(&words[..length]),
                    &limits,
                );
            }
            stopped = if world.interlocks.reasons().is_empty() {
                0
            } else {
                stopped + 1
            };
            if stopped == settle {
                stood = world.applied;
            }
            if stopped > settle && world.applied != stood && !world.holds {
                done.reverse();
                done.truncate(8);
                wrong.push(format!(
                    "{seed}, {late} late, cycle {cycle}: in the stop {before:?} {:?} {done:?} stopped {stopped} estop {} {:?} word {:?} stood {stood:?} {:?}",
                    world.applied, world.emergency_stop, world.interlocks.reasons(), output.correction, output.state
                ));
                break;
            }
        }
    }
    assert!(wrong.is_empty(), "{}:\n{}", wrong.len(), wrong.join("\n"));
}

/// An axis that goes up and down, two wrong readings in any five: each direction is one in which it went since the last.
#[test]
fn random_turns_with_wrong_readings() {
    let turn = std::f64::consts::TAU;
    for (kind, rolls) in [(0, None), (1, Some(turn))] {
        for seed in 0..20_000_u64 {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut memory = DirectionMemory::default();
            let threshold = 0.01;
            let mut at: f64 = random.random_range(-10.0..10.0);
            let (mut truth, mut changed_at) = (Vec::new(), 0_usize);
            let mut speed: f64 = random.random_range(-0.38..0.38);
            let (mut shown, mut wrong) = (None, [false; 5]);
            let mut log = Vec::new();
            for k in 0..60_u64 {
                if random.random_range(0..15) == 0 {
                    speed = random.random_range(-0.38..0.38);
                }
                at += speed;
                truth.push(at);
                wrong.rotate_right(1);
                wrong[0] = false;
                if wrong.iter().filter(|w| **w).count() < 2 && random.random_range(0..2) == 0 {
                    wrong[0] = true;
                }
                let told = if wrong[0] {
                    if random.random() {
                        random.random_range(-10.0..10.0)
                    } else {
                        at + random.random_range(-3.0..3.0)
                    }
                } else {
                    at
                };
                let told = if kind == 1 {
                    told.rem_euclid(turn)
                } else {
                    told
                };
                log.push((told, wrong[0]));
                let before = shown;
                shown = memory.at(Duration::from_millis(k * 4 + 1), told, threshold, rolls);
                if shown != before {
                    // It went in that direction by the threshold since the readings of the last change.
                    let since = &truth[changed_at.saturating_sub(5)..];
                    let sign = shown.map_or(1.0, Direction::sign);
                    let mut least = f64::INFINITY;
                    let mut went = 0.0_f64;
                    for at in since {
                        least = least.min(at * sign);
                        went = went.max(at * sign - least);
                    }
                    assert!(
                        went > threshold,
                        "seed {seed}, {kind}: {shown:?} {changed_at} {log:?} {truth:?}"
                    );
                    changed_at = truth.len() - 1;
                }
            }
        }
    }
}

/// A correction that is limited, ramped, lowered and raised while the machine moves: X, Y, Z follow A and C by levers. While
/// nothing is behind, the tip is no further off than without correction or than where the ramp began, but for the rounding.
#[test]
fn the_tip_is_never_further_off_than_where_the_ramp_began() {
    use crate::vector::{five, of};
    use volcomp_guard::{Vector, Wanted};
    let mut wrong = Vec::new();
    for seed in 0..300_u64 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut limits = five(if random.random() { 0.0 } else { 0.05 });
        for (i, axis) in limits.axes.iter_mut().enumerate().take(5) {
            axis.resolution = if i < 3 { 1e-5 } else { 1e-8 };
            axis.slew_per_s = if i < 3 { 0.5 } else { 500e-6 };
        }
        let draw = |random: &mut ChaCha8Rng| {
            let mut follow = PerChannel::default();
            let mut l = || random.random_range(-400.0..400.0);
            (follow[3], follow[4]) = (of([l(), l(), l()]), of([l(), l(), l()]));
            let mut s = |size: f64| random.random_range(-size..size);
            Wanted {
                position: of([s(0.2), s(0.2), s(0.2)]),
                rotary: of([0.0, 0.0, 0.0, s(300e-6), s(300e-6)]),
                follow,
            }
        };
        let mut wanted = draw(&mut random);
        let mut vector = Vector::default();
        vector.begin_ramp();
        // How far the tip is off: the linear axes against what belongs to the rotary ones as they are.
        let miss = |wanted: &Wanted, at: &PerChannel<f64>| {
            let mut sum = 0.0;
            for l in 0..3 {
                let follows = wanted.follow[3][l] * at[3] + wanted.follow[4][l] * at[4];
                sum += (at[l] - follows - wanted.position[l]).powi(2);
            }
            sum.sqrt()
        };
        let mut begun = miss(&wanted, &vector.smooth());
        let mut log = Vec::new();
        for cycle in 0..3000 {
            match random.random_range(0..200) {
                0 => {
                    let [linear, rotary] = [
                        random.random_range(0.02..1.0),
                        random.random_range(0.02..1.0),
                    ];
                    for (i, axis) in limits.axes.iter_mut().enumerate().take(5) {
                        axis.limit = if i < 3 {
                            0.15 * linear
                        } else {
                            150e-6 * rotary
                        };
                        axis.warn = axis.limit;
                    }
                    vector.begin_ramp();
                    begun = miss(&wanted, &vector.smooth());
                    log.push((cycle, linear, rotary));
                }
                1 => {
                    wanted = draw(&mut random);
                    vector.begin_ramp();
                    begun = miss(&wanted, &vector.smooth());
                    log.push((cycle, 0.0, 0.0));
                }
                2 => {
                    // Nothing but the linear share of one axis changes slowly.
                    vector = Vector::at(&vector.smooth());
                    vector.begin_ramp();
                    begun = miss(&wanted, &vector.smooth());
                    log.push((cycle, -1.0, -1.0));
                }
                _ => {}
            }
            let followed = vector.follow(&wanted, &limits, 0.004);
            let off = miss(&wanted, &vector.smooth());
            let without = miss(&wanted, &PerChannel::ZERO);
            if followed.behind {
                begun = begun.max(off);
            }
            if !followed.behind && off > begun.max(without) + 1e-4 {
                log.reverse();
                log.truncate(4);
                wrong.push(format!("seed {seed}, cycle {cycle}: {:.1} um, began with {:.1}, without {:.1} {log:?} {followed:?}", off * 1e3, begun * 1e3, without * 1e3));
                break;
            }
        }
    }
    assert!(wrong.is_empty(), "{}:\n{}", wrong.len(), wrong.join("\n"));
}

/// The control holds by a stop that nothing shows, is free again, and then another path shows a stop: the axis goes to the
/// word that was sent on, and stands there. What is known of where it stood is older than that.
#[test]
fn a_stop_that_begins_as_the_control_is_free_again_leads_no_axis_back() {
    let mut wrong = Vec::new();
    for late in [0_usize, 1, 2, 4, 6] {
        let mut most = (0.0_f64, 0);
        for later in 0..(2 * late as u32 + 4) {
            let mut world = in_motion(late, 90);
            world.holds = true;
            world.run(Duration::from_millis(180));
            world.holds = false;
            for _ in 0..later {
                world.cycle_after(PERIOD, None);
            }
            let stop = Interlock {
                emergency_stop: true,
                ..Interlock::default()
            };
            world.interlocks.see(1, Some(stop));
            let begun = world.guard.output()[0];
            // What was on its way when the stop began brings the axis to the last word: after that it stands.
            let mut highest = world.applied[0];
            let mut back = 0.0_f64;
            for _ in 0..200 {
                world.cycle_after(PERIOD, None);
                highest = highest.max(world.applied[0]);
                back = back.max(highest - world.applied[0]);
            }
            if back > most.0 {
                most = (back, later);
            }
            assert!(begun > 0.0);
        }
        if most.0 > STEP + 1e-9 {
            wrong.push(format!(
                "{late} late: {:.1} um back in the stop, which began {} cycles after",
                most.0 * 1e3,
                most.1
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// After a lowered slew nothing is sent for seconds: this is neither ramping in, nor without a reason.
#[test]
fn what_is_shown_after_a_lowered_slew_is_what_is_so() {
    let mut world = in_motion(4, 100);
    let mut limits = *world.guard.limits();
    for axis in &mut limits.axes {
        axis.slew_per_s *= 0.1;
    }
    world.guard.set_limits(limits).expect("good limits");
    world.request(Request::Switched);
    let mut silent = 0;
    for cycle in 0..2500 {
        let output = world.cycle_after(PERIOD, None);
        silent = if output.write { 0 } else { silent + 1 };
        // Half a second without a frame, and zero: neither is this ramping in, nor is there no reason for it.
        let told = output.reasons;
        if silent > 125 && world.applied[0] == 0.0 {
            assert!(
                output.state.name() != "arming",
                "cycle {cycle}: {silent} cycles without a frame, at zero, output {:?}, {:?} {told:?}",
                &output.correction.0[..2],
                output.state
            );
        }
    }
}

/// Words that are read back some cycles late: limits, slews and accelerations are changed, stops begin and end, another way
/// takes over. No fault, no axis that moves in a stop, no word faster than the slew.
#[test]
fn random_changes_of_limits_and_slews_without_a_barrier_are_no_fault() {
    let mut wrong = Vec::new();
    for seed in 0..200_u64 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let late = random.random_range(0..5);
        let mut world = World::new(&Limits {
            read_back_cycles: late + 2,
            ..world::limits()
        });
        world.told_late = late;
        world.target = Some(axes(0.140, -0.070));
        world.request(Request::Arm);
        let mut done = Vec::new();
        let (mut word, mut written) = (world.applied, 0);
        let mut fastest = 0.5;
        for cycle in 1..3000 {
            let mut request = None;
            let what = random.random_range(0..150);
            match what {
                0..3 => {
                    let mut limits = *world.guard.limits();
                    let limit = f64::from(random.random_range(5..150)) * STEP;
                    let slew = [0.5, 0.25, 0.05, 0.01][random.random_range(0..4)];
                    let accel = [20.0, 1.0, f64::INFINITY][random.random_range(0..3)];
                    for axis in &mut limits.axes {
                        (axis.limit, axis.warn) = (limit, limit);
                        (axis.slew_per_s, axis.accel_per_s2) = (slew, accel);
                    }
                    fastest = slew.max(world.guard.limits().axes[0].slew_per_s);
                    world.guard.set_limits(limits).expect("good");
                    request = Some(Request::Switched);
                }
                3 | 4 => {
                    let emergency_stop = random.random();
                    let stop = Interlock {
                        emergency_stop,
                        ..Interlock::default()
                    };
                    world.interlocks.see(1, Some(stop));
                }
                5 => {
                    world.target = Some(axes(
                        random.random_range(-0.2..0.2),
                        random.random_range(-0.2..0.2),
                    ))
                }
                6 => request = Some(Request::Disarm),
                7..10 => request = Some(Request::Arm),
                10 if seed % 2 == 1 && world.interlocks.reasons().is_empty() => {
                    let mut limits = *world.guard.limits();
                    let limit = f64::from(random.random_range(5..150)) * STEP;
                    for axis in &mut limits.axes {
                        (axis.limit, axis.warn) = (limit, limit);
                    }
                    let places = PerChannel::leading([Some(1), Some(0)]);
                    world.guard.take_path(limits, &places).expect("good");
                    world.read_back = ReadBack::plain(Duration::ZERO);
                    world.read_back.take_over(world.now, false);
                    // The other way names the axes the other way round.
                    world.applied = axes(world.applied[1], world.applied[0]);
                    word = axes(word[1], word[0]);
                    request = world.guard.state().is_armed().then_some(Request::TakeOver);
                }
                _ => {}
            }
            if what < 11 {
                done.push((cycle, what));
            }
            let before = world.applied;
            let output = world.cycle_after(PERIOD, request);
            let told = |what: &str| {
                let last: Vec<_> = done.iter().rev().take(6).collect();
                format!(
                    "{seed}, {late} late, cycle {cycle}: {what}, {last:?}, {:?}, {:?}",
                    output.state, output.reasons
                )
            };
            if matches!(output.state, State::Faulted(_)) {
                wrong.push(told("fault"));
                break;
            }
            for i in 0..2 {
                let change = (world.applied[i] - word[i]).abs();
                let most = (fastest * PERIOD.as_secs_f64() * f64::from(cycle - written)).max(STEP)
                    + STEP
                    + 1e-9;
                if change > most {
                    wrong.push(told(&format!("{i} by {:.1} um", change * 1e3)));
                }
            }
            if world.applied != before {
                (word, written) = (world.applied, cycle);
                if !world.interlocks.reasons().is_empty() {
                    wrong.push(told("moves in a stop"));
                }
            }
            if wrong.len() > 10 {
                break;
            }
        }
    }
    assert!(wrong.is_empty(), "{}:\n{}", wrong.len(), wrong.join("\n"));
}
