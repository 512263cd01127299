//! From state to state, and how fast.

use std::time::Duration;

use volcomp_guard::{Guard, LimitsError, Quantity, Reasons, Request, State};
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
fn a_ramp_takes_twenty_cycles_at_least() {
    let mut world = World::new(&volcomp_guard::Limits {
        ramp: Duration::ZERO,
        ..limits()
    });
    world.request(Request::Arm);
    let mut cycles = 0;
    while world.guard.state() != State::Compensating {
        world.run(Duration::ZERO);
        cycles += 1;
    }
    assert!(cycles >= 19, "{cycles}");
}

#[test]
fn what_is_beyond_the_limit_is_clamped_and_told() {
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
fn a_switch_ramps_to_the_new_target() {
    let mut world = World::compensating(&limits());
    world.target = Some(axes(0.080, 0.0));
    assert_eq!(world.request(Request::Switched).state.name(), "arming");
    world.run(Duration::from_millis(240));
    assert!(
        (0.055..0.065).contains(&world.applied[0]),
        "{}",
        world.applied[0]
    );
    assert_eq!(world.run(SECOND).state, State::Compensating);
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
    world.target = Some(axes(f64::NAN, 0.0));
    let refused = world.request(Request::Arm);
    assert_eq!(refused.state, State::Disarmed);
    assert!(refused.reasons.contains(Reasons::NOT_A_NUMBER));
}

#[test]
fn limits_that_make_no_sense_are_refused() {
    let check = |change: &dyn Fn(&mut volcomp_guard::Limits)| -> LimitsError {
        let mut limits = limits();
        change(&mut limits);
        Guard::new(limits).expect_err("refused")
    };
    assert_eq!(check(&|l| l.axes[1].limit = 0.0).axis, Some(1));
    assert_eq!(check(&|l| l.axes[0].warn = 0.2).what, Quantity::Warn);
    assert_eq!(
        check(&|l| l.axes[0].slew_per_s = f64::NAN).what,
        Quantity::Slew
    );
    assert_eq!(
        check(&|l| l.axes[0].accel_per_s2 = 0.0).what,
        Quantity::Accel
    );
    assert_eq!(
        check(&|l| l.axes[0].resolution = 0.0).what,
        Quantity::Resolution
    );
    assert_eq!(check(&|l| l.count = 0).what, Quantity::Axes);
    assert_eq!(
        check(&|l| l.hold = Duration::from_millis(1)).what,
        Quantity::Hold
    );
    assert_eq!(check(&|l| l.zero_after = PERIOD).what, Quantity::ZeroAfter);
    assert_eq!(check(&|l| l.test_shift[0] = STEP).what, Quantity::TestShift);
}

#[test]
fn limits_lowered_while_it_runs_are_approached() {
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

/// What was applied before a restart, where the controller cannot be asked.
#[test]
fn what_is_remembered_is_where_it_begins() {
    let mut world = World::new(&limits());
    world.tells_applied = false;
    world.applied = axes(0.030, 0.0);
    world.guard.restore(&world.applied);
    world.request(Request::Arm);
    assert!((world.applied[0] - 0.030).abs() < 1.5 * STEP);
    world.run(SECOND);
    assert!((world.applied[0] - 0.040).abs() < 1e-9);
}
