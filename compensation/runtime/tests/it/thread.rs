//! The control thread, a cycle without allocation, and the example for integrators.

use std::time::{Duration, Instant};

use assert_no_alloc::assert_no_alloc;
use volcomp_port::{
    Clock,
    inject::{HangSwitch, Hanging},
};
use volcomp_runtime::{
    Handle, Model, Order, OrderRefusal, Pulse, Realtime, Replacement,
    guard::{Limits, Request},
    start,
};

use crate::rig::{PERIOD, Rig, alone, control, cycle_of, guard, machine, path_of};

#[path = "../../examples/embed.rs"]
mod example;

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
    let end = Instant::now() + Duration::from_secs(20);
    while handle.cycles() < until && Instant::now() < end {
        std::thread::sleep(PERIOD);
    }
    assert!(handle.cycles() >= until, "no cycles");
}

#[test]
fn a_request_to_arm_expires_while_the_thread_hangs() {
    let (mut handle, _, hangs) = running();
    let pulse = handle.pulse();
    assert_eq!(pulse.silence(), None);
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
    assert!(handle.send(Order::Request(Request::Arm)));
    after_cycles(&mut handle, 20);
    assert!(handle.report().state.is_armed(), "a new request is executed");
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
    assert!(handle.send(Order::Request(Request::Arm)));
    after_cycles(&mut handle, 5);
    assert!(handle.report().state.is_armed());
    switch.disarm();
    after_cycles(&mut handle, 3);
    assert!(!handle.report().state.is_armed());
    // The end of the program disarms as well.
    after_cycles(&mut handle, 200);
    assert!(handle.send(Order::Request(Request::Arm)));
    after_cycles(&mut handle, 5);
    assert!(handle.report().state.is_armed());
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
    assert!(handle.stop_within(Duration::from_secs(20)));
}

#[test]
fn a_thread_arms_and_ends() {
    let (mut handle, limits, _) = running();
    let end = Instant::now() + Duration::from_secs(20);
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
