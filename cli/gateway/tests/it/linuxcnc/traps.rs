//! Traps of LinuxCNC's external offsets, each on the running control.
//!
//! An offset is frozen, cleared or cut; the axes of a bridge do not follow its requests; with some settings LinuxCNC
//! must not start. A reversal error is corrected while the axis creeps, stops, and moves back and forth by less than
//! the reversal threshold. A gateway or bridge dies, a second gateway starts, and a network loses, duplicates, delays
//! and reorders datagrams.

use std::{
    net::UdpSocket,
    process::Command,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use rand::{RngExt, SeedableRng};
use serde_json::json;
use volcomp_test_support::rows;

use crate::{
    check::check,
    linuxcnc::{
        MOST, PORT, configuration_of, corrected, corrected_at, gateway, no_jump, offsets, oracle,
        peer::{LinuxCnc, alone},
        start, wait_corrected, wait_zero,
    },
    program::{Program, path},
};

alone!(
    traps:
    a_second_bridge_for_one_port_is_refused_by_name,
    off_and_on_and_an_emergency_stop,
    an_offset_that_is_frozen_cleared_or_cut,
    nothing_is_written_before_the_axes_are_homed,
    settings_that_do_not_fit_start_nothing,
    in_joint_mode_nothing_is_requested,
    an_offset_that_does_not_come_is_an_alarm,
    the_side_of_a_reversal_changes_once_and_only_after_its_way,
    a_gateway_that_dies_leaves_nothing,
    a_network_that_loses_doubles_and_delays_moves_nothing_wrongly,
);

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
    let least =
        |of: fn(&crate::linuxcnc::Cycle) -> f64| cycles.iter().map(of).fold(f64::MAX, f64::min);
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

/// LinuxCNC moves offsets with its own planner, but not in joint mode. An offset requested in joint mode would later
/// take effect as a jump, so the bridge requests none.
fn in_joint_mode_nothing_is_requested() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut control, mut program) = corrected_at("X300 Y40 Z-20", dir.path(), |ini| ini);

    // The output of `check --online`.
    let config = crate::linuxcnc::configuration(dir.path(), PORT);
    let (text, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 0, "{errors}");
    for line in [
        "# protocol = 2\n",
        "# state = \"on, homed\"\n",
        "# hold_ms = 100.0\n",
        "# time_out_ms = 300.0\n",
        "#   { name = \"X\", unit = \"µm\", limit = 30.0, rate_per_s = 2000.0 },\n",
    ] {
        assert!(text.contains(line), "{line}{text}");
    }
    assert!(!text.contains("shift words"), "{text}");

    let held = offsets(&mut control);
    let pin = "volcomp.counts-0";
    let counts = control.pin(pin);
    control.do_it("joint_mode");
    let seen = program.wait(|state| state["reasons"].to_string().contains("alarm"));
    seen.unwrap_or_else(|state| panic!("the mode is not reported: {state}"));
    let (text, _, _) = check(&config, &["--online"]);
    assert!(
        text.contains("on, homed, an offset is lost, not reached, or does not move in this mode"),
        "{text}"
    );
    program.running.kill();
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(offsets(&mut control), held);
    assert_eq!(control.pin(pin), counts);
    assert_eq!(control.pin("volcomp.holds"), 1.0);
    // When LinuxCNC moves offsets again, the barrier removes the correction at its rate.
    let cycles = control.record(|control| {
        control.mdi("G0 X300");
        wait_zero(control);
    });
    no_jump(&cycles, MOST);
}

/// Without its share of the velocity the planner does not move an offset. The missing correction raises an alarm.
fn an_offset_that_does_not_come_is_an_alarm() {
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), |ini| {
        // The component must tolerate that HAL files are read twice.
        let ini = ini.replace("[HAL]\n", "[HAL]\nTWOPASS = ON\n");
        ini.replace("OFFSET_AV_RATIO = 0.02\n", "")
    });
    let program = gateway(dir.path(), PORT);
    control.do_it("up");
    control.mdi("G21 G90 G0 X300 Y40 Z-20");
    let seen = program.wait(|state| state["reasons"].to_string().contains("alarm"));
    seen.unwrap_or_else(|state| panic!("the missing offset is not reported: {state}"));
    // A requested offset that does not take effect is reported continuously.
    control.wait("axis.x.eoffset-request", |asked| asked.abs() > 2e-3);
    std::thread::sleep(Duration::from_secs(2));
    let state = program.state();
    assert!(state["reasons"].to_string().contains("alarm"), "{state}");
    assert_eq!(control.pin("volcomp.holds"), 1.0);
    assert_eq!(offsets(&mut control), [0.0; 3]);
}

/// LinuxCNC does not start with a wrong setting, and its log names the setting.
fn settings_that_do_not_fit_start_nothing() {
    for [from, to, says] in rows(
        r"
LINEAR_UNITS = mm | LINEAR_UNITS = inch | [TRAJ]LINEAR_UNITS: found inch, expected mm
ANGULAR_UNITS = degree\n |  | [TRAJ]ANGULAR_UNITS is missing, expected degree
LIMIT_UM = 30 | LIMIT_UM = 30 # um | [VOLCOMP]LIMIT_UM: found 30 # um, expected a number
LIMIT_UM = 30 | LIMIT_UM = 30\nHOLD_MS = 65636\nTIME_OUT_MS = 65836 | hold_scans (HOLD_MS): found 65636 cycles, expected 1 to 16383
LIMIT_UM = 30 | LIMIT_UM = 40 | limit (LIMIT_UM, LIMIT_MDEG) of axis X: found 40000 counts, expected 1 to 32767
LIMIT_UM = 30 | LIMIT_UM = 30\nKEY_FILE = other.key | other.key cannot be read: No such file or directory
",
    ) {
        let dir = tempfile::tempdir().expect("writable");
        let started = std::panic::catch_unwind(|| {
            LinuxCnc::start(dir.path(), |ini| {
                assert!(ini.contains(from), "{from}");
                ini.replace(from, to)
            })
        });
        assert!(started.is_err(), "it started: {to}");
        let log = std::fs::read_to_string(dir.path().join("linuxcnc.log")).expect("a log");
        assert!(log.contains(says), "{says}: {log}");
    }
}

const MACHINE: &str = r#"
name = "mill"
structure = "w X' b Y Z t"
[axes.X]
travel = [-10.0, 500.0]
[axes.Y]
travel = [-10.0, 400.0]
[axes.Z]
travel = [-300.0, 10.0]
[errors]
EXX = { mean = { poly = [0.0] }, reversal = 3.0 }
"#;

/// Half of the reversal error, mm.
const SIDE: f64 = 1.5e-3;
/// Minimum offset that identifies a side, mm.
const NEARLY: f64 = 1.4e-3;

/// Nominal positions of X at which the side of the reversal error changes, each with the new side: 1 after motion to
/// larger positions, otherwise -1.
fn sides(cycles: &[crate::linuxcnc::Cycle]) -> Vec<(i32, f64)> {
    let mut found: Vec<(i32, f64)> = Vec::new();
    for cycle in cycles {
        let offset = cycle.offset[0];
        let side = i32::from(offset < -NEARLY) - i32::from(offset > NEARLY);
        if side != 0 && found.last().is_none_or(|(last, _)| *last != side) {
            found.push((side, cycle.nominal[0]));
        }
    }
    found
}

fn the_side_of_a_reversal_changes_once_and_only_after_its_way() {
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), |ini| ini);
    let config = configuration_of(dir.path(), PORT, MACHINE);
    let program = start(dir.path(), &config);
    control.do_it("up");
    program.wait_for("compensating");
    control.mdi("G21 G90 G1 F600 X40");
    control.mdi("X50");
    control.wait("axis.x.eoffset", |has| (has + SIDE).abs() < 3e-6);

    // 0.2 mm/min is 3.3 nm per cycle. A reversal is detected 5 µm from the extreme position: here at 50.003 and then at
    // 49.996.
    let cycles = control.record(|control| {
        for line in [
            "G1 F0.2 X50.003",
            "G4 P0.5",
            "X49.999",
            "G4 P0.5",
            "X50.002",
            "X49.996",
            "G4 P0.5",
            "X50",
            "X49.998",
            "X50.003",
            "G4 P0.5",
        ] {
            control.mdi(line);
        }
    });
    let found = sides(&cycles);
    let order: Vec<i32> = found.iter().map(|(side, _)| *side).collect();
    assert_eq!(order, [1, -1, 1], "{found:?}");
    // Several readings must agree, and the offset moves at its own rate.
    for ((_, at), expected) in found[1..].iter().zip([49.998, 50.001]) {
        assert!((at - expected).abs() < 1e-4, "{at} mm, {expected} mm");
    }
    // The offset moves from side to side monotonically.
    let offsets = || cycles.iter().map(|cycle| cycle.offset[0]);
    let moved: f64 = offsets().zip(offsets().skip(1)).map(|(a, b)| (b - a).abs()).sum();
    assert!((moved - 4.0 * SIDE).abs() < 2e-5, "{moved} mm");
}

fn a_gateway_that_dies_leaves_nothing() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut control, mut program) = corrected_at("X50 Y40 Z-20", dir.path(), |ini| {
        assert!(ini.contains("AXES = XYZ\n"));
        ini.replace("AXES = XYZ\n", "")
    });
    let epoch = control.pin("volcomp.epoch");
    // The disk hangs. Only the writer of the epoch file waits for the disk.
    let hangs = dir.path().join("volcomp.epoch.new");
    let made = Command::new("mkfifo").arg(&hangs).status();
    assert!(made.expect("a program of the system").success());

    // After a kill of the gateway the barrier times out, ramps to zero, and increments the epoch.
    let cycles = control.record(|control| {
        program.running.kill();
        wait_zero(control);
    });
    no_jump(&cycles, MOST);
    assert!(control.pin("volcomp.epoch") > epoch);
    assert_eq!(control.pin("volcomp.owner"), 0.0);
    drop(program);

    let program = gateway(dir.path(), PORT);
    let cycles = control.record(|control| wait_corrected(control, &program));
    no_jump(&cycles, MOST);
    // The disk responds again.
    let both = std::fs::File::options().read(true).write(true).open(&hangs);
    std::fs::remove_file(&hangs).expect("ours");
    drop(both.expect("a pipe"));
    let epoch = control.pin("volcomp.epoch");
    let kept = || std::fs::read_to_string(dir.path().join("volcomp.epoch")).unwrap_or_default();
    control.wait("volcomp.epoch", |now| now == epoch && kept().trim() == epoch.to_string());

    // A second gateway with its own folders moves no axis.
    let other = tempfile::tempdir().expect("writable");
    // The second gateway needs another address, because a second gateway on this computer is refused at the same
    // address.
    let mut relay = Relay::start(47_101, PORT);
    let config = crate::linuxcnc::configuration(other.path(), 47_101);
    let second = Program::start(other.path(), &["--config", path(&config)]);
    let cycles = control.record(|control| {
        let seen = second.wait(|state| state["reasons"].to_string().contains("gateway"));
        seen.unwrap_or_else(|state| panic!("it does not see the first one: {state}"));
        control.mdi("G1 F600 X90");
    });
    corrected("with a second gateway", &cycles);
    drop(second);
    relay.end();
}

/// A relay between gateway and bridge that loses, duplicates, delays and reorders datagrams.
struct Relay {
    stop: Arc<AtomicBool>,
    bad: Arc<AtomicBool>,
    thread: Option<JoinHandle<[u64; 2]>>,
}

impl Relay {
    fn start(from: u16, to: u16) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let bad = Arc::new(AtomicBool::new(false));
        let near = UdpSocket::bind(("127.0.0.1", from)).expect("free");
        let far = UdpSocket::bind("127.0.0.1:0").expect("loopback");
        far.connect(("127.0.0.1", to)).expect("loopback");
        for socket in [&near, &far] {
            socket.set_nonblocking(true).expect("a socket");
        }
        let (stopped, worse) = (Arc::clone(&stop), Arc::clone(&bad));
        let thread = std::thread::spawn(move || {
            let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
            let mut waiting: Vec<(Instant, bool, Vec<u8>)> = Vec::new();
            let mut peer = None;
            let mut counts = [0; 2];
            while !stopped.load(Ordering::Relaxed) {
                let mut came = Vec::new();
                let mut bytes = [0; 600];
                while let Ok((length, sender)) = near.recv_from(&mut bytes) {
                    peer = Some(sender);
                    came.push((true, bytes[..length].to_vec()));
                }
                while let Ok(length) = far.recv(&mut bytes) {
                    came.push((false, bytes[..length].to_vec()));
                }
                for (outwards, bytes) in came {
                    counts[0] += 1;
                    let is_bad = worse.load(Ordering::Relaxed);
                    if is_bad && random.random_bool(0.1) {
                        continue;
                    }
                    let copies = if is_bad && random.random_bool(0.1) { 2 } else { 1 };
                    for _ in 0..copies {
                        // One frame in ten is so late that other frames overtake it. One frame in a hundred is so late
                        // that very many frames overtake it.
                        let ms = match random.random_range(0..100) {
                            0 if is_bad => random.random_range(100..2000),
                            1..10 if is_bad => random.random_range(1..12),
                            _ => 0,
                        };
                        let at = Instant::now() + Duration::from_millis(ms);
                        waiting.push((at, outwards, bytes.clone()));
                        counts[1] += u64::from(ms > 0 || copies > 1);
                    }
                }
                let now = Instant::now();
                waiting.retain(|(at, outwards, bytes)| {
                    if *at > now {
                        return true;
                    }
                    let _ = match (outwards, peer) {
                        (true, _) => far.send(bytes),
                        (false, Some(peer)) => near.send_to(bytes, peer),
                        (false, None) => Ok(0),
                    };
                    false
                });
                std::thread::sleep(Duration::from_micros(200));
            }
            counts
        });
        Self { stop, bad, thread: Some(thread) }
    }

    /// Returns the number of received datagrams, and the number of duplicated or delayed ones.
    fn end(&mut self) -> [u64; 2] {
        self.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take().expect("ended once");
        thread.join().expect("no panic")
    }
}

fn a_network_that_loses_doubles_and_delays_moves_nothing_wrongly() {
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), |ini| ini);
    let mut relay = Relay::start(47_100, PORT);
    let program = gateway(dir.path(), 47_100);
    control.do_it("up");
    control.mdi("G21 G90 G0 X20 Y10 Z-5");
    wait_corrected(&mut control, &program);
    relay.bad.store(true, Ordering::Relaxed);
    let cycles = control.record(|control| control.mdi("G1 F600 X50 Y30 Z-20"));
    no_jump(&cycles, MOST);
    // Late frames prevent nanometre accuracy. The error is bounded by the motion in a few cycles.
    let found = crate::linuxcnc::residuals(&cycles);
    let [median, most] = [50, 99].map(|of| crate::linuxcnc::part(&found, of));
    println!("a bad network: residual {median:.2} nm median, {most:.1} nm p99");
    assert!(median < 20.0, "{median} nm");
    relay.bad.store(false, Ordering::Relaxed);
    program.wait_for("compensating");
    wait_corrected(&mut control, &program);
    let counts = relay.end();
    assert!(counts[0] > 5000 && counts[1] > 300, "{counts:?}");
    // Without frames the barrier ramps to zero after its timeout.
    wait_zero(&mut control);
}
