//! The control thread: it tells, takes orders, and ends.

use std::time::{Duration, Instant};

use volcomp_port::Clock;
use volcomp_runtime::{
    ControlPath, Cycle, LimitsRefusal, Model, Order, PathPlan, PathSettings, Realtime, Sensors,
    guard::Request, start,
};

use crate::rig::{PERIOD, control, guard, machine};

#[test]
fn a_thread_arms_and_ends() {
    use volcomp_port::Controller;
    let guard = guard();
    let model = Model::new(&machine(), guard.fading).expect("shipped");
    let control = control([-100.0, 40.0, 200.0, 50.0, 300.0], &Clock::system());
    let described = control.description().clone();
    let plan = PathPlan::new(described, &model, &guard, &PathSettings::default(), PERIOD);
    let plan = plan.expect("fits");
    let limits = plan.limits;
    let path = ControlPath::new(Box::new(control), &plan).expect("fits");
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    let cycle = Cycle::new(
        Box::new(model),
        vec![path],
        guard.hand_back,
        sensors,
        PERIOD,
    );
    let (mut handle, lacking) =
        start(cycle.expect("one path"), Realtime::default()).expect("a thread");
    assert!(lacking.is_empty(), "nothing was asked for: {lacking:?}");
    let end = Instant::now() + Duration::from_secs(20);
    while handle.cycles() < 5 && Instant::now() < end {
        std::thread::sleep(PERIOD);
    }
    assert!(handle.send(Order::Request(Request::Arm)));
    while handle.report().state.name() != "compensating" && Instant::now() < end {
        std::thread::sleep(PERIOD);
    }
    assert_eq!(handle.report().state.name(), "compensating");
    let changes = handle.changes();
    let names: Vec<&str> = changes.iter().map(|change| change.state.name()).collect();
    assert_eq!(names.last(), Some(&"compensating"), "{names:?}");
    assert!(handle.timings().count() > 5);
    // Limits of another period, and of a path that is not there: refused, and told.
    let mut limits = limits;
    assert!(handle.send(Order::Limits(7, Box::new(limits))));
    limits.period = Duration::from_millis(1);
    assert!(handle.send(Order::Limits(0, Box::new(limits))));
    let mut refusals = Vec::new();
    while refusals.len() < 2 && Instant::now() < end {
        refusals.extend(handle.refusals());
        std::thread::sleep(PERIOD);
    }
    assert_eq!(
        refusals,
        [
            LimitsRefusal::NoSuchPath { path: 7, paths: 1 },
            LimitsRefusal::Period {
                path: 0,
                found: Duration::from_millis(1),
                expected: PERIOD
            }
        ]
    );
    handle.stop();
    let cycles = handle.cycles();
    std::thread::sleep(PERIOD * 3);
    assert_eq!(handle.cycles(), cycles, "it has ended");
}
