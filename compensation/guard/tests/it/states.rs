//! State transitions and their speed, limits, corrections beyond the limit, and corrections of another gateway.

use std::time::Duration;

use volcomp_guard::{
    Cause, Guard, Limits, Quantity, ReadBack, Reasons, Request, State, barrier::Barrier, ceiling,
};
use volcomp_vocabulary::{
    AxisKind::{self, Linear, Rotary},
    PerChannel,
};

use crate::world::{MOST, PERIOD, SECOND, STEP, World, axes, limits};

const BEYOND_LIMIT: State = State::Faulted(Cause::BeyondLimit);
const OTHER_GATEWAY: State = State::Faulted(Cause::OtherGateway);

fn with(change: impl FnOnce(&mut Limits)) -> Limits {
    let mut limits = limits();
    change(&mut limits);
    limits
}

#[test]
fn arming_ramps_in_and_disarming_ramps_out() {
    let half = Duration::from_millis(240);
    let mut world = World::new(&limits());
    world.run_to(SECOND, State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
    assert_eq!(world.request(Request::Arm).state.name(), "arming");
    assert_eq!(world.run(half).state.name(), "arming");
    let x = world.applied[0];
    assert!((0.015..0.022).contains(&x), "{x}");
    let armed = world.run_to(SECOND, State::Compensating);
    world.assert_applied(axes(0.040, -0.020), "armed");
    // The correction is applied as intended, so it is not reported as left over.
    assert!(!armed.reasons.contains(Reasons::CORRECTION_LEFT));
    assert_eq!(world.request(Request::Disarm).state.name(), "ramping-out");
    world.run(half);
    let x = world.applied[0];
    assert!((0.018..0.025).contains(&x), "{x}");
    assert!(!world.run_to(SECOND, State::Disarmed).write);
    assert_eq!(world.applied, PerChannel::ZERO);
}

#[test]
fn a_request_beyond_the_limit_is_clamped_and_reported() {
    let mut world = World::compensating(&limits());
    world.target = Some(axes(0.120, 0.0));
    let warned = world.run(SECOND).reasons;
    assert!(warned.contains(Reasons::WARN) && !warned.contains(Reasons::LIMITED));
    world.target = Some(axes(0.5, -0.5));
    let slewing = world.run(Duration::from_millis(40)).reasons;
    assert!(slewing.contains(Reasons::LIMITED | Reasons::SLEWING));
    let limited = world.run(2 * SECOND);
    assert!(!limited.reasons.contains(Reasons::SLEWING));
    assert!(limited.held_back > 10);
    world.assert_applied(axes(0.150, -0.150), "limited");
}

#[test]
fn arming_is_refused_with_reasons() {
    type Case = (fn(&mut World), Duration, Reasons, Reasons);
    let (none, stale) = (Reasons::NONE, Reasons::POSITIONS_STALE);
    // A cause, its duration before the request, reasons that must be reported, and reasons that must not be reported.
    let cases: [Case; 6] = [
        (|world| world.forbids = Reasons::AUDIT, PERIOD, none, none),
        (|world| world.referenced = false, Duration::ZERO, Reasons::NOT_REFERENCED, none),
        (|world| world.answers = false, SECOND, Reasons::NO_CONTROLLER | stale, none),
        (|world| world.answers = false, Duration::ZERO, Reasons::NO_CONTROLLER, stale),
        (
            |world| world.target = Some(axes(f64::NAN, 0.0)),
            Duration::ZERO,
            Reasons::NOT_A_NUMBER,
            stale,
        ),
        (|world| world.positions[0] = f64::INFINITY, Duration::ZERO, Reasons::NOT_A_NUMBER, none),
    ];
    for (number, (cause, time, given, not_given)) in cases.into_iter().enumerate() {
        let mut world = World::new(&limits());
        world.run(SECOND);
        cause(&mut world);
        if time > Duration::ZERO {
            world.run(time);
        }
        let refused = world.request(Request::Arm);
        assert_eq!(refused.state, State::Disarmed, "case {number}");
        assert!(refused.reasons.contains(given), "case {number}");
        let is_given = !not_given.is_empty() && refused.reasons.contains(not_given);
        assert!(!is_given, "case {number}: {:?}", refused.reasons);
    }
}

#[test]
fn invalid_limits_are_refused() {
    type Case = (fn(&mut Limits), Quantity);
    let cases: [Case; 9] = [
        (|l| l.axes[1].limit = 0.0009, Quantity::Limit),
        (|l| l.axes[0].warn = 0.2, Quantity::Warn),
        (|l| l.axes[0].slew_per_s = f64::NAN, Quantity::Slew),
        (|l| l.axes[0].accel_per_s2 = 0.0, Quantity::Accel),
        (|l| l.axes[0].resolution = 0.0, Quantity::Resolution),
        (|l| l.count = 0, Quantity::Axes),
        (|l| l.hold = Duration::from_millis(1), Quantity::Hold),
        (|l| l.zero_after = PERIOD, Quantity::ZeroAfter),
        (|l| l.test_shift[0] = STEP, Quantity::TestShift),
    ];
    for (change, what) in cases {
        let refused = Guard::new(with(change)).expect_err("refused");
        assert_eq!(refused.what, what);
        assert_eq!(refused.axis == Some((1, Linear)), what == Quantity::Limit);
    }
}

/// Limits above the absolute maximum are rejected for linear and rotary axes, at construction and at runtime; the maximum itself is
/// accepted.
#[test]
fn limits_beyond_the_ceilings_are_refused() {
    let of = |kind: AxisKind, limit: f64, slew: f64| {
        with(|l| {
            for axis in &mut l.axes {
                (axis.kind, axis.resolution) = (kind, 1e-6);
                (axis.limit, axis.warn, axis.slew_per_s) = (limit, 0.001, slew);
            }
        })
    };
    for (kind, limit, slew) in [(Linear, 2.0, 5.0), (Rotary, 0.002, 0.005)] {
        let highest = of(kind, limit, slew);
        let mut guard = Guard::new(highest).expect("at the ceilings");
        for (limits, what, unit) in [
            (of(kind, limit * 1.001, slew), Quantity::Limit, "2002"),
            (of(kind, limit, slew * 1.001), Quantity::Slew, "5005"),
            (of(kind, f64::INFINITY, slew), Quantity::Limit, "inf"),
        ] {
            let refused = Guard::new(limits).expect_err("beyond a ceiling");
            assert_eq!((refused.what, refused.axis), (what, Some((0, kind))));
            assert!(refused.to_string().contains(unit), "{refused}");
            assert_eq!(guard.set_limits(limits), Err(refused));
        }
        assert_eq!(guard.limits(), &highest);
    }
    let micros = Duration::from_micros;
    let times = |period, hold| with(|l| (l.period, l.hold) = (period, hold));
    let hold = limits().hold;
    for (period, hold, refused) in [
        (micros(249), hold, Some(Quantity::Period)),
        (micros(100_001), micros(150_000), Some(Quantity::Period)),
        (Duration::MAX, hold, Some(Quantity::Period)),
        (PERIOD, micros(200_001), Some(Quantity::Hold)),
        (micros(250), micros(250), None),
        (micros(100_000), micros(200_000), None),
    ] {
        let found = Guard::new(times(period, hold)).err();
        assert_eq!(found.map(|error| error.what), refused, "{period:?}");
    }
    // The kind of an axis cannot change.
    let mut guard = Guard::new(limits()).expect("valid");
    let turned = with(|l| {
        (l.axes[0].kind, l.axes[0].limit, l.axes[0].warn) = (Rotary, 0.002, 0.002);
        l.axes[0].slew_per_s = ceiling::SLEW_PER_S_ROTARY.0;
    });
    let refused = guard.set_limits(turned).expect_err("another kind");
    assert_eq!(refused.what, Quantity::Axes);
}

#[test]
fn limits_lowered_in_operation_are_approached_at_the_slew() {
    let mut world = World::compensating(&limits());
    let lower = with(|l| {
        for axis in &mut l.axes {
            (axis.limit, axis.warn, axis.slew_per_s) = (0.010, 0.010, 0.1);
        }
    });
    world.guard.set_limits(lower).expect("valid");
    let mut cycles = 0;
    while world.applied[0] > 0.010 + 1e-9 {
        world.run(Duration::ZERO);
        world.assert_steps(STEP + 1e-9, "lowered");
        cycles += 1;
    }
    // 30 µm at 100 µm/s.
    assert!((70..120).contains(&cycles), "{cycles}");
}

/// Without read-back the output starts after a restart at the stored correction, without a step.
#[test]
fn the_output_starts_at_the_stored_correction() {
    let mut world = World::lines(&limits());
    world.applied = axes(0.030, 0.0);
    let (now, age) = (world.now, Duration::from_secs(3600));
    world.read_back.restore(now, &world.applied, age, &limits());
    let mut world = world.arm_from_here();
    world.run(SECOND);
    assert!((world.applied[0] - 0.040).abs() < 1e-9);
    assert!(world.largest_step < 0.003, "{}", world.largest_step);
}

/// A correction beyond the limit is a fault, and nothing is sent; after an acknowledgement the correction ramps to zero.
#[test]
fn a_correction_beyond_the_limit_ramps_out_after_acknowledgement() {
    let mut world = World::new(&limits());
    world.clear(axes(4.998, 0.0));
    world.run(SECOND);
    let output = world.request(Request::Arm);
    assert_eq!(output.state.name(), "faulted");
    assert!(output.reasons.contains(Reasons::BEYOND_LIMIT));
    assert!(!world.run(SECOND).write);
    assert_eq!(world.applied[0], 4.998);
    world.largest_step = 0.0;
    let output = world.request(Request::Acknowledge);
    assert_eq!(output.state.name(), "ramping-out");
    world.run_to(15 * SECOND, State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
    world.assert_steps(MOST, "ramping out");
}

#[test]
fn setting_the_same_limits_accepts_no_correction() {
    for request in [Request::Arm, Request::Disarm] {
        let mut world = World::new(&limits());
        world.clear(axes(1.5, 0.0));
        world.run(3 * SECOND);
        world.guard.set_limits(limits()).expect("valid");
        world.request(request);
        assert_eq!(world.run(SECOND).state.name(), "faulted");
        assert_eq!(world.applied[0], 1.5, "{request:?}");
    }
}

/// On disarming, three false readings of 1.5 mm cause no step. A real correction beyond the limit stays until an
/// acknowledgement.
#[test]
fn disarming_does_not_ramp_out_a_correction_beyond_the_limit() {
    for (is_real, is_armed, request) in [
        (false, false, Request::Disarm),
        (false, false, Request::End),
        (false, true, Request::Disarm),
        (false, true, Request::End),
        (true, false, Request::Disarm),
        (true, false, Request::End),
        (true, true, Request::Disarm),
        (true, true, Request::End),
    ] {
        let case = format!("real {is_real}, armed {is_armed}, {request:?}");
        let mut world = World::new(&limits());
        if is_armed {
            world = world.arm();
        }
        if is_real {
            world.clear(axes(1.5, 0.0));
        }
        // With an armed guard, the request comes in the cycle of the third reading of 1.5 mm.
        let is_confirmed = |world: &World| {
            let confirmed = world.status().confirmed;
            confirmed.is_some_and(|confirmed| confirmed.values[0] >= 1.0)
        };
        while !is_confirmed(&world) {
            world.now += PERIOD;
            world.false_reading = (!is_real).then(|| axes(1.5, 0.0));
            world.read();
        }
        let before = world.applied;
        world.largest_step = 0.0;
        let state = world.decide(Some(request)).state;
        let expected =
            if is_armed || request == Request::Disarm { BEYOND_LIMIT } else { State::Disarmed };
        assert_eq!(state, expected, "{case}");
        for _ in 0..500 {
            assert!(!world.run(Duration::ZERO).write, "{case}");
        }
        assert_eq!((world.applied, world.largest_step), (before, 0.0), "{case}");
    }
}

/// A second gateway that is disarmed or stopped 100 ms after its start does not ramp out the first gateway's correction.
#[test]
fn disarming_does_not_ramp_out_another_gateways_correction() {
    let mut world = World::new(&limits());
    world.clear(axes(0.020, 0.0));
    world.read_back = ReadBack::plain(2 * SECOND);
    let reasons = world.run(Duration::from_millis(100)).reasons;
    assert!(reasons.contains(Reasons::WATCHING), "{reasons:?}");
    world.request(Request::Disarm);
    world.run_to(4 * SECOND, State::Disarmed);
    // The correction also stays if the other gateway is detected later.
    world.read_back.report_other_gateway(world.now);
    world.request(Request::Disarm);
    world.run(SECOND);
    assert_eq!(world.applied, axes(0.020, 0.0));
    // Without another gateway, stopping keeps the correction, and disarming removes it.
    world.run(8 * SECOND);
    world.request(Request::End);
    world.run_to(SECOND, State::Disarmed);
    assert_eq!(world.applied, axes(0.020, 0.0));
    world.request(Request::Disarm);
    world.run_to(2 * SECOND, State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
}

/// The barrier accepted another owner, a later sequence, or an epoch without frames of this gateway: a fault as long as
/// the other gateway sends.
#[test]
fn a_frame_of_another_gateway_is_a_fault_until_it_is_gone() {
    let frames = [(5, 0, 0), (99, 2, 0), (99, 30_000, 0), (99, 0, 1)];
    for (owner, ahead, epochs) in frames {
        for disarms in [false, true] {
            let mut world = World::guarded(&limits());
            world.request(Request::Arm);
            world.run_to(2 * SECOND, State::Compensating);
            if disarms {
                assert_eq!(world.request(Request::Disarm).state.name(), "ramping-out");
            }
            let barrier = world.barrier.as_mut().expect("a barrier");
            let (settings, mut memory) = (barrier.report().settings, barrier.memory());
            memory.link.owner = owner;
            memory.link.sequence = memory.link.sequence.wrapping_add(ahead);
            memory.link.epoch += epochs;
            *barrier = Barrier::resume(settings, memory).expect("valid");
            let output = world.run_to(PERIOD, OTHER_GATEWAY);
            assert!(output.reasons.contains(Reasons::OTHER_GATEWAY));
            assert!(!output.write, "{owner} {ahead} {epochs}");
            let state = world.request(Request::Acknowledge).state;
            assert_eq!(state, OTHER_GATEWAY, "it is still there");
            // The other gateway falls silent, and the barrier times out.
            world.run_to(2 * SECOND, OTHER_GATEWAY);
            assert_eq!(world.applied, PerChannel::ZERO);
            assert_eq!(world.request(Request::Acknowledge).state, State::Disarmed);
            world.request(Request::Arm);
            world.run_to(2 * SECOND, State::Compensating);
        }
    }
}

/// An acknowledged correction beyond the limit continues to ramp out after a change of path; a larger correction needs
/// another acknowledgement.
#[test]
fn ramping_out_from_beyond_the_limit_continues_after_a_change_of_paths() {
    for found_there in [None, Some(0.500)] {
        let mut world = World::new(&limits());
        world.applied = axes(0.190, 0.0);
        world.run(SECOND);
        assert_eq!(world.request(Request::Arm).state, BEYOND_LIMIT);
        world.request(Request::Acknowledge);
        world.run(5 * PERIOD);
        // The other path has another axis order.
        world.applied = axes(world.applied[1], world.applied[0]);
        let places = PerChannel::leading([Some(1), Some(0)]);
        world.guard.take_path(limits(), &places).expect("valid");
        world.read_back = ReadBack::plain(Duration::ZERO);
        world.applied[1] = found_there.unwrap_or(world.applied[1]);
        let is_out = world.run(5 * SECOND).state == State::Disarmed;
        assert_eq!(is_out, found_there.is_none());
        assert_eq!(world.applied[1], found_there.unwrap_or(0.0));
    }
}
