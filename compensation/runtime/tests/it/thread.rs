//! The control thread, and the thread that reads a standby path and never delays the cycle.
//!
//! A cycle does not allocate. The example for integrators runs.

#[path = "../../examples/embed.rs"]
mod example;

use std::time::{Duration, Instant};

use assert_no_alloc::assert_no_alloc;
use volcomp_port::{
    Clock,
    inject::{Faults, Faulty, HangSwitch, Hanging, Injection, Remote},
};
use volcomp_runtime::{
    Cycle, CycleInput, Handle, Model, Order, OrderRefusal, Pulse, Realtime, Replacement, Report,
    guard::{Limits, Reasons, Request},
    start,
};

use crate::rig::{PERIOD, Rig, alone, control, cycle_of, guard, machine, path_of};

/// Timeout of all waits; long enough for a busy computer.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A running thread, the limits of its path, and the switch that makes its controller hang.
fn running() -> (Handle, Limits, HangSwitch) {
    let guard = guard();
    let model = Model::new(&machine(), guard.fading).expect("shipped");
    let hangs = HangSwitch::default();
    let place = [-100.0, 40.0, 200.0, 50.0, 300.0];
    let control = Hanging::new(control(place, &Clock::system()), &hangs);
    let (path, limits) = path_of(control, &model, &guard, &alone());
    let cycle = cycle_of(model, &guard, vec![path]).expect("one path");
    let (mut handle, lacking) = start(cycle, Realtime::default()).expect("a thread");
    assert!(lacking.is_empty(), "{lacking:?}");
    after_cycles(&mut handle, 5);
    (handle, limits, hangs)
}

pub(crate) fn after_cycles(handle: &mut Handle, more: u64) {
    let until = handle.cycles() + more;
    let end = Instant::now() + TIMEOUT;
    while handle.cycles() < until && Instant::now() < end {
        std::thread::sleep(PERIOD);
    }
    assert!(handle.cycles() >= until, "no cycles");
}

/// Requests to arm until it is armed: a request expires if the thread is suspended for a second.
fn arms(handle: &mut Handle) {
    volcomp_test_support::until("it is armed", TIMEOUT, || {
        assert!(handle.send(Order::Request(Request::Arm)));
        after_cycles(handle, 5);
        handle.report().state.is_armed()
    });
}

#[test]
fn a_request_to_arm_expires_while_the_thread_hangs() {
    let (mut handle, _, hangs) = running();
    let pulse = handle.pulse();
    volcomp_test_support::until("it cycles", TIMEOUT, || pulse.silence().is_none());
    hangs.set(true);
    std::thread::sleep(Pulse::JITTER * 2);
    let silence = pulse.silence().expect("no cycle for 200 ms");
    assert!(silence >= Pulse::JITTER);
    let until = Instant::now() + Duration::from_millis(50);
    let disarms = handle.disarm_switch().count();
    assert!(handle.send_by(Order::Request(Request::Arm), until, disarms));
    std::thread::sleep(Duration::from_millis(100));
    hangs.set(false);
    after_cycles(&mut handle, 20);
    assert_eq!(handle.report().state.name(), "disarmed");
    assert_eq!(handle.changes(), []);
    // A new request is executed.
    arms(&mut handle);
}

/// Disarming needs no room in the full queue, and no earlier request arms afterwards.
#[test]
fn disarming_overtakes_queued_orders() {
    let (mut handle, _, hangs) = running();
    let switch = handle.disarm_switch();
    let before = switch.count();
    hangs.set(true);
    std::thread::sleep(PERIOD * 3);
    while handle.room() > 0 {
        assert!(handle.send(Order::Request(Request::Arm)));
    }
    assert!(!handle.send(Order::Request(Request::Disarm)), "no room");
    switch.disarm();
    hangs.set(false);
    after_cycles(&mut handle, 100);
    assert_eq!(handle.report().state.name(), "disarmed");
    // A request to arm from before the disarm order may be sent after it, because arming waits for the disk.
    let until = Instant::now() + Duration::from_secs(20);
    assert!(handle.send_by(Order::Request(Request::Arm), until, before));
    after_cycles(&mut handle, 5);
    assert_eq!(handle.report().state.name(), "disarmed");
    arms(&mut handle);
    switch.disarm();
    after_cycles(&mut handle, 3);
    assert!(!handle.report().state.is_armed());
    // The end of the program disarms as well.
    after_cycles(&mut handle, 200);
    arms(&mut handle);
    switch.end();
    after_cycles(&mut handle, 3);
    assert!(!handle.report().state.is_armed());
}

#[test]
fn stopping_a_hanging_thread_times_out() {
    let (mut handle, _, hangs) = running();
    hangs.set(true);
    std::thread::sleep(PERIOD * 3);
    assert!(!handle.stop_within(Duration::from_millis(50)));
    hangs.set(false);
    let (mut handle, _, _) = running();
    assert!(handle.stop_within(TIMEOUT));
}

#[test]
fn a_thread_arms_and_ends() {
    let (mut handle, limits, _) = running();
    let end = Instant::now() + TIMEOUT;
    assert!(handle.send(Order::Request(Request::Arm)));
    while handle.report().state.name() != "compensating" && Instant::now() < end {
        std::thread::sleep(PERIOD);
    }
    assert_eq!(handle.report().state.name(), "compensating");
    let changes = handle.changes();
    let names: Vec<&str> = changes.iter().map(|change| change.state.name()).collect();
    assert_eq!(names.last(), Some(&"compensating"), "{names:?}");
    assert!(handle.timings().count() > 5);
    // Limits for another period or for a missing path are rejected.
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
            OrderRefusal::NoSuchPath { path: 7, paths: 1 },
            OrderRefusal::Period { path: 0, found: Duration::from_millis(1), expected: PERIOD }
        ]
    );
    handle.stop();
    let cycles = handle.cycles();
    std::thread::sleep(PERIOD * 3);
    assert_eq!(handle.cycles(), cycles, "it has ended");
}

#[test]
fn a_cycle_allocates_nothing() {
    let mut rig = Rig::at([-100.0, 40.0, 200.0, 50.0, 300.0]);
    let model = Model::new(&machine(), guard().fading).expect("shipped");
    let mut replacement = Replacement::new(Box::new(model), &[]);
    assert_no_alloc(|| {
        rig.run(20);
        rig.step(Some(Request::Arm));
        rig.run(300);
        rig.cycle.swap_model(&mut replacement).expect("the same axes");
        rig.step(Some(Request::Switched));
        rig.run(300);
        rig.step(Some(Request::Disarm));
        rig.run(300);
    });
    assert_eq!(rig.cycle.report().state.name(), "disarmed");
}

#[test]
fn the_example_runs_and_is_short() {
    example::main().expect("it runs");
    let lines = include_str!("../../examples/embed.rs").lines().count();
    assert!(lines <= 60, "found {lines} lines");
}

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
    let end = Instant::now() + TIMEOUT;
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
    let silent =
        |report: &Report| report.reasons.contains(Reasons::STANDBY_SILENT) && compensates(report);
    let report = until(&mut handle, "silent", silent);
    assert!(handle.cycles() - before > 100, "{}", handle.cycles());
    assert_eq!(report.active, 0);
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
