//! A separate thread reads a standby path and never delays the cycle.

use std::time::{Duration, Instant};

use assert_no_alloc::assert_no_alloc;
use volcomp_port::{
    Clock,
    inject::{Faults, Faulty, HangSwitch, Hanging, Injection, Remote},
};
use volcomp_runtime::{
    Cycle, CycleInput, Handle, Model, Order, Realtime, Report,
    guard::{Reasons, Request},
    start,
};

use crate::{
    rig::{PERIOD, alone, control, cycle_of, guard, machine, path_of},
    thread::after_cycles,
};

/// Two paths to one machine; the first can be disconnected, the second can hang.
struct TwoWays {
    cycle: Cycle,
    first: Remote,
    second: HangSwitch,
}

fn two_ways() -> TwoWays {
    let guard = guard();
    let model = Model::new(&machine(), guard.fading).expect("shipped");
    let place = [-100.0, 40.0, 200.0, 50.0, 300.0];
    let first = control(place, &Clock::system());
    let second = first.another().expect("few ways");
    let second_hangs = HangSwitch::default();
    let first = Faulty::new(first, Faults::default(), 1);
    let remote = first.remote();
    let second = Hanging::new(second, &second_hangs);
    let paths = vec![
        path_of(first, &model, &guard, &alone()).0,
        path_of(second, &model, &guard, &alone()).0,
    ];
    TwoWays {
        cycle: cycle_of(model, &guard, paths).expect("two paths"),
        first: remote,
        second: second_hangs,
    }
}

fn cut(first: &Remote, calls: u32) {
    assert!(first.inject(Injection::Disconnect { calls }));
}

fn until(handle: &mut Handle, what: &str, holds: impl Fn(&Report) -> bool) -> Report {
    let end = Instant::now() + Duration::from_secs(30);
    while Instant::now() < end {
        let report = *handle.report();
        if holds(&report) {
            return report;
        }
        std::thread::sleep(PERIOD);
    }
    panic!("not {what}: {:?}", handle.report());
}

#[test]
fn a_hanging_standby_delays_no_cycle_and_takes_over_later() {
    let TwoWays { cycle, first, second } = two_ways();
    let (mut handle, _) = start(cycle, Realtime::default()).expect("a thread");
    let hears = |report: &Report| report.paths[1].answered.is_some() && report.correction_known;
    until(&mut handle, "read", hears);
    assert!(handle.send(Order::Request(Request::Arm)));
    let compensates = |report: &Report| report.state.name() == "compensating";
    until(&mut handle, "compensating", compensates);
    // The cycle continues while an exchange with the standby path hangs.
    second.set(true);
    let before = handle.cycles();
    let silent = |report: &Report| report.reasons.contains(Reasons::STANDBY_SILENT);
    let report = until(&mut handle, "silent", silent);
    assert!(handle.cycles() - before > 100, "{}", handle.cycles());
    assert_eq!((report.state.name(), report.active), ("compensating", 0));
    let [corrects, hangs] = [0, 1].map(|path| report.paths[path].answered.expect("it did"));
    assert!(hangs > Duration::from_secs(1) && corrects < hangs);
    // A path that does not answer cannot take over.
    cut(&first, u32::MAX);
    let lost = |report: &Report| !compensates(report);
    let report = until(&mut handle, "lost", lost);
    assert_eq!(report.active, 0);
    let before = handle.cycles();
    after_cycles(&mut handle, 100);
    assert!(handle.cycles() - before >= 100);
    assert_eq!(handle.report().active, 0);
    // The second path answers again, and takes over.
    second.set(false);
    let taken = |report: &Report| report.active == 1 && compensates(report);
    let report = until(&mut handle, "taken over", taken);
    assert!(report.reasons.contains(Reasons::FALLBACK));
    // The first path answers again, and takes over again.
    cut(&first, 0);
    let back = |report: &Report| report.active == 0 && compensates(report);
    let report = until(&mut handle, "handed back", back);
    assert!(!report.reasons.contains(Reasons::FALLBACK));
}

/// A take-over allocates nothing, including the transfer of controller and readings.
#[test]
fn taking_over_allocates_nothing() {
    let TwoWays { mut cycle, first, .. } = two_ways();
    cycle.start_standby_threads().expect("threads");
    let mut run = |cycles: u32, request: Option<Request>| {
        let mut input = CycleInput { request, ..CycleInput::default() };
        for _ in 0..cycles {
            assert_no_alloc(|| {
                cycle.run(Instant::now(), &input, &mut || Duration::ZERO);
            });
            input.request = None;
            std::thread::sleep(PERIOD);
        }
        *cycle.report()
    };
    run(100, None);
    let report = run(200, Some(Request::Arm));
    assert_eq!((report.state.name(), report.active), ("compensating", 0));
    cut(&first, 300);
    assert_eq!(run(150, None).active, 1);
    // The cut still affects some readings of the thread, which reads every 100 ms.
    cut(&first, 0);
    let report = run(1000, None);
    assert_eq!((report.state.name(), report.active), ("compensating", 0));
}
