//! From state to state, and how fast.

use std::time::Duration;

use volcomp_guard::{
    Cause, Guard, Limits, Quantity, ReadBack, Reasons, Request, State, barrier::Barrier,
};
use volcomp_vocabulary::PerChannel;

use crate::world::{PERIOD, STEP, World, axes, limits};

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn arming_ramps_in_and_disarming_ramps_out() {
    let mut world = World::new(&limits());
    assert_eq!(world.run(SECOND).state, State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
    assert_eq!(world.request(Request::Arm).state.name(), "arming");
    let half = world.run(Duration::from_millis(240));
    assert_eq!(half.state.name(), "arming");
    assert!(
        (0.015..0.022).contains(&world.applied[0]),
        "{}",
        world.applied[0]
    );
    assert_eq!(world.run(SECOND).state, State::Compensating);
    assert!((world.applied[0] - 0.040).abs() < 1e-9);
    assert!((world.applied[1] + 0.020).abs() < 1e-9);
    assert_eq!(world.request(Request::Disarm).state.name(), "ramping-out");
    world.run(Duration::from_millis(240));
    assert!(
        (0.018..0.025).contains(&world.applied[0]),
        "{}",
        world.applied[0]
    );
    let output = world.run(SECOND);
    assert_eq!((output.state, output.write), (State::Disarmed, false));
    assert_eq!(world.applied, PerChannel::ZERO);
}

#[test]
fn a_request_beyond_the_limit_is_clamped_and_reported() {
    let mut world = World::compensating(&limits());
    world.target = Some(axes(0.120, 0.0));
    let warned = world.run(SECOND);
    assert!(warned.reasons.contains(Reasons::WARN) && !warned.reasons.contains(Reasons::LIMITED));
    world.target = Some(axes(0.5, -0.5));
    let limited = world.run(Duration::from_millis(40));
    assert!(
        limited
            .reasons
            .contains(Reasons::LIMITED | Reasons::SLEWING)
    );
    let limited = world.run(2 * SECOND);
    assert!(!limited.reasons.contains(Reasons::SLEWING));
    assert!((world.applied[0] - 0.150).abs() < 1e-9 && (world.applied[1] + 0.150).abs() < 1e-9);
    assert!(limited.held_back > 10);
}

#[test]
fn arming_is_refused_with_reasons() {
    let mut world = World::new(&limits());
    world.forbids = Reasons::AUDIT;
    assert_eq!(world.request(Request::Arm).state, State::Disarmed);
    world.forbids = Reasons::NONE;
    world.referenced = false;
    let refused = world.request(Request::Arm);
    assert_eq!(refused.state, State::Disarmed);
    assert!(refused.reasons.contains(Reasons::NOT_REFERENCED));
    world.referenced = true;
    world.answers = false;
    world.run(SECOND);
    let refused = world.request(Request::Arm);
    assert_eq!(refused.state, State::Disarmed);
    assert!(
        refused
            .reasons
            .contains(Reasons::NO_CONTROLLER | Reasons::POSITIONS_STALE)
    );
    world.answers = true;
    world.run(SECOND);
    // One cycle without an answer, after a good second.
    world.answers = false;
    let refused = world.request(Request::Arm);
    assert_eq!(refused.state, State::Disarmed);
    assert!(refused.reasons.contains(Reasons::NO_CONTROLLER));
    assert!(!refused.reasons.contains(Reasons::POSITIONS_STALE));
    world.answers = true;
    world.run(SECOND);
    world.target = Some(axes(f64::NAN, 0.0));
    let refused = world.request(Request::Arm);
    assert_eq!(refused.state, State::Disarmed);
    assert!(refused.reasons.contains(Reasons::NOT_A_NUMBER));
    assert!(!refused.reasons.contains(Reasons::POSITIONS_STALE));
    world.target = Some(axes(0.01, 0.0));
    world.run(SECOND);
    world.positions[0] = f64::INFINITY;
    let refused = world.request(Request::Arm);
    assert_eq!(refused.state, State::Disarmed);
    assert!(refused.reasons.contains(Reasons::NOT_A_NUMBER));
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
        let mut limits = limits();
        change(&mut limits);
        let refused = Guard::new(limits).expect_err("refused");
        assert_eq!(refused.what, what);
        let y = (1, volcomp_vocabulary::AxisKind::Linear);
        assert_eq!(refused.axis == Some(y), what == Quantity::Limit);
    }
}

/// For both kinds of axes, at construction and in operation; a value at the ceiling is accepted.
#[test]
fn limits_beyond_the_ceilings_are_refused() {
    use volcomp_vocabulary::AxisKind::{Linear, Rotary};
    let with = |change: &dyn Fn(&mut Limits)| {
        let mut limits = limits();
        change(&mut limits);
        limits
    };
    for (kind, limit, slew) in [(Linear, 2.0, 5.0), (Rotary, 0.002, 0.005)] {
        let of = |limit: f64, slew: f64| {
            with(&|l| {
                for axis in &mut l.axes {
                    (axis.kind, axis.resolution) = (kind, 1e-6);
                    (axis.limit, axis.warn, axis.slew_per_s) = (limit, 0.001, slew);
                }
            })
        };
        let mut guard = Guard::new(of(limit, slew)).expect("at the ceilings");
        for (limits, what, unit) in [
            (of(limit * 1.001, slew), Quantity::Limit, "2002"),
            (of(limit, slew * 1.001), Quantity::Slew, "5005"),
            (of(f64::INFINITY, slew), Quantity::Limit, "inf"),
        ] {
            let refused = Guard::new(limits).expect_err("beyond a ceiling");
            assert_eq!((refused.what, refused.axis), (what, Some((0, kind))));
            assert!(refused.to_string().contains(unit), "{refused}");
            assert_eq!(guard.set_limits(limits), Err(refused));
        }
        assert_eq!(guard.limits(), &of(limit, slew));
    }
    let micros = Duration::from_micros;
    for (limits, what) in [
        (with(&|l| l.period = micros(249)), Quantity::Period),
        (
            with(&|l| (l.period, l.hold) = (micros(100_001), micros(150_000))),
            Quantity::Period,
        ),
        (with(&|l| l.period = Duration::MAX), Quantity::Period),
        (with(&|l| l.hold = micros(200_001)), Quantity::Hold),
    ] {
        assert_eq!(Guard::new(limits).expect_err("refused").what, what);
    }
    for (period, hold) in [(250, 250), (100_000, 200_000)] {
        let at = with(&|l| (l.period, l.hold) = (micros(period), micros(hold)));
        assert!(Guard::new(at).is_ok());
    }
    // An axis does not become one of another kind.
    let mut guard = Guard::new(limits()).expect("good limits");
    let turned = with(&|l| {
        (l.axes[0].kind, l.axes[0].limit, l.axes[0].warn) = (Rotary, 0.002, 0.002);
        l.axes[0].slew_per_s = 0.005;
    });
    let refused = guard.set_limits(turned).expect_err("another kind");
    assert_eq!(refused.what, Quantity::Axes);
}

#[test]
fn limits_lowered_in_operation_are_approached_at_the_slew() {
    let mut world = World::compensating(&limits());
    let mut lower = limits();
    for axis in &mut lower.axes {
        (axis.limit, axis.warn, axis.slew_per_s) = (0.010, 0.010, 0.1);
    }
    world.guard.set_limits(lower).expect("good limits");
    let mut before = world.applied;
    let mut cycles = 0;
    while world.applied[0] > 0.010 + 1e-9 {
        world.run(Duration::ZERO);
        assert!((world.applied[0] - before[0]).abs() <= STEP + 1e-9);
        before = world.applied;
        cycles += 1;
    }
    // 30 um at 100 um/s.
    assert!((70..120).contains(&cycles), "{cycles}");
}

/// Without read-back, after a restart.
#[test]
fn the_output_starts_at_the_stored_correction() {
    let mut world = World::lines(&limits());
    world.applied = axes(0.030, 0.0);
    world.read_back.restore(
        world.now,
        &world.applied,
        Duration::from_secs(3600),
        &limits(),
    );
    let mut world = world.arm_from_here();
    world.run(SECOND);
    assert!((world.applied[0] - 0.040).abs() < 1e-9);
    assert!(world.largest_step < 0.003, "{}", world.largest_step);
}

/// Nothing is sent before.
#[test]
fn a_correction_beyond_the_limit_ramps_out_after_acknowledgement() {
    let mut world = World::new(&limits());
    world.clear(axes(4.998, 0.0));
    world.run(SECOND);
    let told = world.request(Request::Arm);
    assert_eq!(told.state.name(), "faulted");
    assert!(told.reasons.contains(Reasons::BEYOND_LIMIT));
    assert!(!world.run(SECOND).write);
    assert_eq!(world.applied[0], 4.998);
    world.largest_step = 0.0;
    assert_eq!(
        world.request(Request::Acknowledge).state.name(),
        "ramping-out"
    );
    world.run(15 * SECOND);
    assert_eq!(world.guard.state(), State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
    assert!(world.largest_step <= 0.002 + 1e-9, "{}", world.largest_step);
}

/// A reload used to make an unknown correction beyond the limit acceptable; arming or disarming then ramped it out.
#[test]
fn setting_the_same_limits_accepts_no_correction() {
    for request in [Request::Arm, Request::Disarm] {
        let mut world = World::new(&limits());
        world.clear(axes(1.5, 0.0));
        world.run(3 * SECOND);
        world.guard.set_limits(limits()).expect("good limits");
        world.request(request);
        world.run(SECOND);
        assert_eq!(world.applied[0], 1.5, "{request:?}");
        assert_eq!(world.guard.state().name(), "faulted");
    }
}

/// With three false readings it used to be a step of 1.5 mm, and a real correction was ramped out without acknowledgement.
#[test]
fn disarming_does_not_ramp_out_a_correction_beyond_the_limit() {
    let lies = |world: &mut World| world.lie = Some(axes(1.5, 0.0));
    let holds = |world: &mut World| world.clear(axes(1.5, 0.0));
    let told: [&dyn Fn(&mut World); 2] = [&lies, &holds];
    let requests = [
        (false, Request::Disarm),
        (false, Request::End),
        (true, Request::Disarm),
        (true, Request::End),
    ];
    for (tell, (armed, request)) in told
        .into_iter()
        .flat_map(|tell| requests.map(|request| (tell, request)))
    {
        let mut world = World::new(&limits());
        if armed {
            world = world.arm();
        }
        tell(&mut world);
        // Armed, the request comes in the cycle in which the third of these readings does.
        while world
            .known()
            .confirmed
            .is_none_or(|found| found.values[0] < 1.0)
        {
            world.now += PERIOD;
            world.lie = world.lie.map(|_| axes(1.5, 0.0));
            world.hear();
        }
        let before = world.applied;
        world.largest_step = 0.0;
        let told = world.decide(Some(request));
        let expected = if armed || request == Request::Disarm {
            State::Faulted(Cause::BeyondLimit)
        } else {
            State::Disarmed
        };
        assert_eq!(told.state, expected, "{armed}, {request:?}");
        for _ in 0..500 {
            let out = world.run(Duration::ZERO);
            assert!(!out.write, "{armed}: {:?}", out.reasons);
        }
        assert_eq!((world.applied, world.largest_step), (before, 0.0));
    }
}

/// A second gateway, disarmed or ended 100 ms after its start, used to ramp out the correction of the first.
#[test]
fn disarming_does_not_ramp_out_another_gateways_correction() {
    let mut world = World::new(&limits());
    world.clear(axes(0.020, 0.0));
    world.read_back = ReadBack::plain(2 * SECOND);
    let told = world.run(Duration::from_millis(100));
    assert!(told.reasons.contains(Reasons::WATCHING), "{told:?}");
    world.request(Request::Disarm);
    assert_eq!(world.run(4 * SECOND).state, State::Disarmed);
    // Also where it is seen later.
    world.read_back.report_other_gateway(world.now);
    world.request(Request::Disarm);
    world.run(SECOND);
    assert_eq!(world.applied, axes(0.020, 0.0));
    // Nothing moves it and nobody is seen: the end of the program leaves it, a person leads it out.
    world.run(8 * SECOND);
    world.request(Request::End);
    assert_eq!(world.run(SECOND).state, State::Disarmed);
    assert_eq!(world.applied, axes(0.020, 0.0));
    world.request(Request::Disarm);
    assert_eq!(world.run(2 * SECOND).state, State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
}

/// The barrier accepted another owner, a later sequence, or an epoch without own frames.
#[test]
fn a_frame_of_another_gateway_is_a_fault_until_it_is_gone() {
    for (owner, ahead, epochs) in [(5, 0, 0), (99, 2, 0), (99, 30_000, 0), (99, 0, 1)] {
        for disarms in [false, true] {
            let mut world = World::guarded(&limits());
            world.request(Request::Arm);
            assert_eq!(world.run(2 * SECOND).state, State::Compensating);
            if disarms {
                assert_eq!(world.request(Request::Disarm).state.name(), "ramping-out");
            }
            let barrier = world.barrier.as_mut().expect("a barrier");
            let (settings, mut memory) = (barrier.report().settings, barrier.memory());
            memory.link.owner = owner;
            memory.link.sequence = memory.link.sequence.wrapping_add(ahead);
            memory.link.epoch += epochs;
            *barrier = Barrier::resume(settings, memory).expect("good settings");
            let seen = world.run(PERIOD);
            assert_eq!(
                seen.state,
                State::Faulted(Cause::OtherGateway),
                "{owner} {ahead} {epochs}"
            );
            assert!(seen.reasons.contains(Reasons::OTHER_GATEWAY));
            assert!(!seen.write, "who reads another's does not send");
            let kept = world.request(Request::Acknowledge).state;
            assert_eq!(
                kept,
                State::Faulted(Cause::OtherGateway),
                "it is still there"
            );
            // The other one falls silent: the barrier goes to zero by itself.
            let gone = world.run(2 * SECOND);
            assert_eq!(gone.state, State::Faulted(Cause::OtherGateway));
            assert_eq!(world.applied, PerChannel::ZERO);
            assert_eq!(world.request(Request::Acknowledge).state, State::Disarmed);
            world.request(Request::Arm);
            assert_eq!(world.run(2 * SECOND).state, State::Compensating);
        }
    }
}

/// An acknowledged correction beyond the limit used to fault again on the other path.
#[test]
fn ramping_out_from_beyond_the_limit_continues_after_a_change_of_paths() {
    for found_there in [None, Some(0.500)] {
        let mut world = World::new(&limits());
        world.applied = axes(0.190, 0.0);
        world.run(SECOND);
        assert_eq!(
            world.request(Request::Arm).state,
            State::Faulted(Cause::BeyondLimit)
        );
        world.request(Request::Acknowledge);
        world.run(5 * PERIOD);
        // The other path has its axes in another order.
        world.applied = axes(world.applied[1], world.applied[0]);
        let places = PerChannel::leading([Some(1), Some(0)]);
        world
            .guard
            .take_path(limits(), &places)
            .expect("good limits");
        world.read_back = ReadBack::plain(Duration::ZERO);
        world.applied[1] = found_there.unwrap_or(world.applied[1]);
        let led_out = world.run(5 * SECOND).state == State::Disarmed;
        // More than was let out is looked at again.
        assert_eq!(led_out, found_there.is_none());
        assert_eq!(world.applied[1], found_there.unwrap_or(0.0));
    }
}
