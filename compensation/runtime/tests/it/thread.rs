//! The control thread: it tells, takes orders, and ends.

use std::time::{Duration, Instant};

use volcomp_port::Clock;
use volcomp_runtime::{
    ControlPath, Cycle, Model, Order, PathPlan, PathSettings, Realtime, Sensors, guard::Request,
    start,
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
    let path = ControlPath::new(Box::new(control), &plan.expect("fits")).expect("fits");
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    let cycle = Cycle::new(
        Box::new(model),
        vec![path],
        guard.hand_back,
        sensors,
        PERIOD,
    );
    let (mut handle, lacking) =
        start(cycle.expect("one path"), PERIOD, Realtime::default()).expect("a thread");
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
    handle.stop();
    let cycles = handle.cycles();
    std::thread::sleep(PERIOD * 3);
    assert_eq!(handle.cycles(), cycles, "it has ended");
}
