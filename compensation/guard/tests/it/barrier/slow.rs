//! Controls whose program is slower than configured, or has stopped.

use std::time::Duration;

use volcomp_guard::{
    Limits, Request,
    barrier::{Barrier, Settings},
    vocabulary::PerChannel,
};

use crate::world::{PERIOD, SCAN, World, axes, barrier, limits};

/// Scans of 2.45 ms are accepted for a configured period of 2 ms. The guard assumes zero only after the longer time,
/// when X has reached zero.
#[test]
fn a_slow_control_is_at_zero_when_it_is_assumed_to_be() {
    let limits = Limits { zero_after: Duration::from_secs(3), ..limits() };
    // Timeout in scans, and transit time of the last frame, ms.
    for (time_out_scans, late_ms) in [(1000, 0), (100, 0), (100, 14)] {
        let settings = Settings { time_out_scans, ..barrier().report().settings };
        let barrier = Barrier::resume(settings, barrier().memory()).expect("valid");
        let mut world = World::guarded_by(&limits, barrier, SCAN);
        world.scan_time = Duration::from_micros(2450);
        world.target = Some(axes(0.140, 0.0));
        world.request(Request::Arm);
        world.run(Duration::from_secs(3));
        assert!((world.applied[0] - 0.140).abs() < 1e-9);
        let before = world.mailbox.clone();
        assert!(world.run(Duration::ZERO).write);
        let last = std::mem::replace(&mut world.mailbox, before);
        let sent = world.now;
        let wait = world.read_back.zero_after_last_write(&limits);
        while world.now <= sent + wait.expect("a barrier") {
            world.now += PERIOD;
            world.scan();
            if world.now >= sent + Duration::from_millis(late_ms) {
                world.mailbox.clone_from(&last);
            }
        }
        assert_eq!(world.applied, PerChannel::ZERO, "{time_out_scans} {late_ms}");
    }
}

/// The control's program has stopped but its interface still responds: the repeated report is never new, and the guard
/// sends no frame.
#[test]
fn a_report_with_a_constant_tick_is_never_new() {
    let mut world = World::guarded(&limits());
    world.scan_time = Duration::from_secs(3600);
    for cycle in 0..5400 {
        let request = (cycle >= 400).then_some(Request::Arm);
        let output = world.cycle_after(PERIOD, request);
        assert!(!output.write, "a frame at {:?}", world.now);
    }
}
