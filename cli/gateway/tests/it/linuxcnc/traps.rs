//! Traps of LinuxCNC's external offsets, each on the running control.

use std::time::Duration;

use serde_json::json;

use super::{
    MOST, PORT, alone::alone, corrected_at, gateway, no_jump, offsets, oracle, peer::LinuxCnc,
    wait_corrected, wait_zero,
};

alone!(traps: a_second_bridge_for_one_port_is_refused_by_name, off_and_on_and_an_emergency_stop, an_offset_that_is_frozen_cleared_or_cut, nothing_is_written_before_the_axes_are_homed);

/// LinuxCNC loses counts that change while the machine is off, and at power-on absorbs the offset into the nominal
/// position. The bridge reports the absorbed part, and motion stays within its rate.
fn off_and_on_and_an_emergency_stop() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut control, program) = corrected_at("X50 Y40 Z-20", dir.path(), |ini| ini);

    for stop in ["off", "estop"] {
        let held = offsets(&mut control);
        let counts = "volcomp.counts-0";
        let counted = control.pin(counts);
        let motor = control.pin("joint.0.motor-pos-cmd");
        // The gateway writes nothing while the machine is off, for longer than every timeout.
        let cycles = control.record(|control| {
            control.do_it(stop);
            std::thread::sleep(Duration::from_secs(2));
        });
        no_jump(&cycles, 1e-6);
        assert_eq!(control.pin(counts), counted);
        let state = program.state();
        assert_ne!(state["state"], "compensating", "{state}");
        // The motor is at rest, so its offset is now part of the position.
        let shown = "volcomp.absorbed-0";
        let lost = control.pin(shown);
        control.do_it("on");
        let absorbed = control.wait(shown, |now| now != lost) - lost;
        assert!((absorbed - held[0]).abs() < 2e-6, "{absorbed} mm, {held:?}");
        let cycles = control.record(|control| {
            wait_corrected(control, &program);
        });
        // A motion that cannot be prevented is limited to the rate, and reported.
        no_jump(&cycles, MOST);
        assert!(control.log().contains("has lost an offset"), "{}", control.log());
        let now = control.pin("joint.0.motor-pos-cmd");
        let moved = now - motor;
        assert!((moved - held[0]).abs() < 1e-3, "{moved} mm");
        // The nominal position has moved; positions are read without the offset.
        let nominal = control.pin("axis.x.pos-cmd");
        let expected = nominal + oracle([nominal, 0.0, 0.0])[0];
        assert!((now - expected).abs() < 3e-6, "{now} mm, {expected} mm");
        // The next move to a programmed position restores the full correction.
        control.mdi("G0 X50 Y40 Z-20");
        wait_corrected(&mut control, &program);
    }
}

/// Another program freezes or clears an offset, or a soft limit cuts an offset. Each case is reported, and the
/// correction returns.
fn an_offset_that_is_frozen_cleared_or_cut() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut control, program) = corrected_at("X50 Y40 Z-20", dir.path(), |ini| ini);

    // The offset is cleared: the bridge reports it, and the correction ramps in again.
    let shown = "volcomp.absorbed-0";
    let lost = control.pin(shown);
    control.hal(&["setp", "axis.x.eoffset-clear", "1"]);
    control.wait(shown, |now| now != lost);
    control.hal(&["setp", "axis.x.eoffset-clear", "0"]);
    wait_corrected(&mut control, &program);

    // The offset is frozen, after its pin was disconnected from the bridge, which drives the pin.
    control.hal(&["unlinkp", "axis.x.eoffset-enable"]);
    control.hal(&["setp", "axis.x.eoffset-enable", "0"]);
    let frozen = offsets(&mut control)[0];
    control.mdi("G0 X80");
    let seen = program.wait(|state| state["state"] != "compensating");
    seen.unwrap_or_else(|state| panic!("the frozen offset is not reported: {state}"));
    assert_eq!(offsets(&mut control)[0], frozen);
    control.hal(&["net", "volcomp-enable", "axis.x.eoffset-enable"]);
    wait_corrected(&mut control, &program);

    // A soft limit cuts the offset. This raises an alarm, which ends when the axis leaves the limit.
    control.mdi("G0 X-9.9995 Y40 Z-20");
    let state = program.wait(|state| state["reasons"].to_string().contains("alarm"));
    state.unwrap_or_else(|state| panic!("it is not reported: {state}"));
    control.mdi("G0 X50 Y40");
    wait_corrected(&mut control, &program);

    // An arc exceeds the limits by 0.2 mm between its ends. LinuxCNC accepts the arc and absorbs the excess into the
    // offset. The gateway reports this meanwhile, and no deviation remains.
    control.mdi("G0 X-9.9");
    wait_corrected(&mut control, &program);
    let shown = "volcomp.absorbed-0";
    let lost = control.pin(shown);
    let cycles = control.record(|control| {
        control.ask("begin_mdi", &json!({ "text": "G17 G2 X-9.9 Y60 R250 F240" }));
        let state = program.wait(|state| state["reasons"].to_string().contains("alarm"));
        state.unwrap_or_else(|state| panic!("it is not reported: {state}"));
        control.do_it("idle");
        control.mdi("G0 X50 Y40");
    });
    let least = |of: fn(&super::Cycle) -> f64| cycles.iter().map(of).fold(f64::MAX, f64::min);
    let (nominal, motor) = (least(|cycle| cycle.nominal[0]), least(|cycle| cycle.motor[0]));
    assert!(nominal < -10.05, "the arc stays within the limits: {nominal} mm");
    assert!(motor > -10.0 - 1e-3, "the motor left the limits: {motor} mm");
    wait_corrected(&mut control, &program);
    // A cut offset does not count as lost, because nothing was absorbed into the position.
    let taken = control.pin(shown) - lost;
    assert_eq!(taken, 0.0, "mm that the bridge takes for lost");
}

/// LinuxCNC does not start with two bridges on one port, and its log names the port.
fn a_second_bridge_for_one_port_is_refused_by_name() {
    let _taken = std::net::UdpSocket::bind(("127.0.0.1", PORT)).expect("free");
    let dir = tempfile::tempdir().expect("writable");
    let started = std::panic::catch_unwind(|| LinuxCnc::start(dir.path(), |ini| ini));
    assert!(started.is_err(), "LinuxCNC started without its bridge");
    let log = std::fs::read_to_string(dir.path().join("linuxcnc.log")).expect("a log");
    assert!(log.contains("UDP port 127.0.0.1:47001: Address already in use"), "{log}");
}

/// A machine that is on but not homed gets no correction. After homing it gets the full correction.
fn nothing_is_written_before_the_axes_are_homed() {
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), |ini| ini);
    let program = gateway(dir.path(), PORT);
    control.do_it("on");
    // The gateway receives the bridge's reports, and would correct X0 by 2 µm.
    let seen = program.wait(|state| state["reasons"].to_string().contains("not referenced"));
    seen.unwrap_or_else(|state| panic!("it is not reported: {state}"));
    let counts = "volcomp.counts-0";
    let cycles = control.record(|_| std::thread::sleep(Duration::from_secs(1)));
    assert!(cycles.len() > 100, "{} cycles", cycles.len());
    assert!(cycles.iter().all(|cycle| cycle.offset == [0.0; 3]));
    assert_eq!(control.pin(counts), 0.0);
    assert_eq!(control.pin("volcomp.holds"), 1.0);
    control.do_it("up");
    wait_corrected(&mut control, &program);
    // No correction was requested while LinuxCNC would have absorbed the correction into the position.
    let shown = "volcomp.absorbed-0";
    assert_eq!(control.pin(shown), 0.0);
    let said = control.ask("said", &json!({}));
    assert_eq!(said, json!([]), "LinuxCNC complains");
    drop(program);
    wait_zero(&mut control);
}
