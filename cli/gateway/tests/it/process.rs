//! The program from start to end: signals, restarts, a slow control, a second gateway, failures, and a jump of the wall clock.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    process::Command,
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_gateway::{
    error::Failure,
    machine::{Machine, ServiceStep},
    options::Options as GatewayOptions,
    request::Operation,
    service::Service,
    slot::{Phase, Slot},
};
use volcomp_vocabulary::PerChannel;

use crate::{
    controlled::{configuration, control},
    manual::{self, Gateway},
    program::{PATIENCE, Program, change, path},
};

/// Shifts of X over time during an action.
pub(crate) fn watched(control: &Simulator, act: impl FnOnce() + Send) -> Vec<(Instant, f64)> {
    watched_axis(control, 0, act)
}

/// Shifts of the axis with this index over time during an action.
pub(crate) fn watched_axis(
    control: &Simulator,
    axis: usize,
    act: impl FnOnce() + Send,
) -> Vec<(Instant, f64)> {
    let done = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watch = scope.spawn(|| {
            let mut trace = Vec::new();
            while !done.load(std::sync::atomic::Ordering::Relaxed) {
                let shift = control.world().shifts()[axis];
                trace.push((Instant::now(), shift));
                std::thread::sleep(Duration::from_millis(1));
            }
            trace
        });
        // Catches a panic as well, because the scope waits for the thread.
        let acted = std::panic::catch_unwind(std::panic::AssertUnwindSafe(act));
        done.store(true, std::sync::atomic::Ordering::Relaxed);
        if let Err(why) = acted {
            std::panic::resume_unwind(why);
        }
        watch.join().expect("no panic")
    })
}

/// Checks that in any time window a shift changes by at most the slew, one step, and five late cycles.
pub(crate) fn no_step(trace: &[(Instant, f64)]) {
    for (index, (then, was)) in trace.iter().enumerate() {
        for (now, is) in &trace[index..] {
            let window = now.duration_since(*then);
            if window > Duration::from_millis(200) {
                break;
            }
            let allowed = 0.5 * (window.as_secs_f64() + 0.020) + 0.001;
            assert!(
                (is - was).abs() <= allowed,
                "{was} to {is} mm in {window:?}"
            );
        }
    }
}

/// Kills at several times during ramp and compensation, each with a restart: an output changes per cycle by at most the slew and one
/// step.
#[test]
fn killed_in_the_middle_and_started_again_there_is_no_step() {
    let dir = tempfile::tempdir().expect("writable");
    let config = manual::configuration(dir.path(), "auto_arm = true");
    change(&config, "ramp_s = 0.1", "ramp_s = 0.5");
    let mut gateway = Gateway::start(&config);
    for (state, ms) in [
        ("arming", 100),
        ("arming", 350),
        ("compensating", 0),
        ("compensating", 2500),
    ] {
        gateway.wait_for(state);
        gateway.run(Duration::from_millis(ms));
        assert!(gateway.shifts()[1].abs() > 0.001, "{state}: it corrects");
        gateway = gateway.killed_and_started(&config);
    }
    gateway.wait_for("compensating");
    let rig = gateway.stop();
    assert_eq!(rig.controls.axes.applied(), PerChannel::ZERO, "ramped out");
    let changes = rig.controls.axes.largest_change();
    assert!(
        changes.iter().all(|change| *change <= 0.003 + 1e-9),
        "{changes:?}"
    );
}

/// Responses take longer than a cycle: the gateway corrects, reports overruns, and keeps its one connection.
#[test]
fn a_slow_control_costs_cycles_not_the_connection() {
    let dir = tempfile::tempdir().expect("writable");
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|_| vec![400.0, 150.0, 50.0]);
    let options = Options {
        latency: Duration::from_millis(7),
        ..Options::default()
    };
    let control = Simulator::start("127.0.0.1:0", options, world).expect("loopback");
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    let state = program
        .wait(|state| state["correction_um"]["Y"] == -20.0)
        .expect("it corrects");
    assert!(state["cycle"]["overruns"].as_u64() > Some(10));
    assert!(state["reasons"].to_string().contains("cycle overruns"));
    assert_eq!(control.open_sessions(), 1);
}

/// systemd gets ready, watchdog and stopping notifications. The gateway raises its soft limit of file descriptors, usually 1024.
#[test]
fn the_service_manager_is_notified() {
    let dir = tempfile::tempdir().expect("writable");
    let socket = dir.path().join("notify");
    let listener = std::os::unix::net::UnixDatagram::bind(&socket).expect("writable");
    listener.set_read_timeout(Some(PATIENCE)).expect("a time");
    let mut shell = Command::new("sh");
    let program = env!("CARGO_BIN_EXE_volcomp-gateway");
    shell.args(["-c", "ulimit -S -n 256; exec \"$0\" \"$@\"", program]);
    shell
        .env("NOTIFY_SOCKET", &socket)
        .env("WATCHDOG_USEC", "400000");
    let mut program = Program::spawn(shell, dir.path(), &["--simulate"]);
    let received = || {
        let mut buffer = [0; 256];
        let count = listener.recv(&mut buffer).expect("a word");
        String::from_utf8_lossy(&buffer[..count]).into_owned()
    };
    assert!(received().contains("READY=1"));
    for _ in 0..5 {
        assert!(received().contains("WATCHDOG=1"));
    }
    let limits = std::fs::read_to_string(format!("/proc/{}/limits", program.running.id()));
    let limits = limits.expect("it runs");
    let files = limits
        .lines()
        .find_map(|line| line.strip_prefix("Max open files"));
    let files: Vec<&str> = files.expect("a line").split_whitespace().collect();
    assert!(files[0] == files[1] && files[0] != "256", "{files:?}");
    program.signal("TERM");
    while !received().contains("STOPPING=1") {}
    assert_eq!(program.end(), Some(0));
}

/// The reason why a gateway does not start, with its dashboard at this address.
fn does_not_start(config: PathBuf, listen: &str) -> String {
    let listen = listen.parse().expect("an address");
    let turn = &mut |_: &mut Service| panic!("it has started");
    let failure = failed_at(listen, config, &Arc::default(), turn);
    assert_eq!(failure.status, 1, "{failure:?}");
    failure.what
}

/// Another program uses the dashboard's port: the gateway exits with status 1, and the message names the address.
#[test]
fn a_port_that_is_taken_ends_it_with_status_1() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("loopback");
    let address = taken.local_addr().expect("bound").to_string();
    let dir = tempfile::tempdir().expect("writable");
    let config = manual::configuration(dir.path(), "auto_arm = true");
    let why = does_not_start(config, &address);
    assert!(why.contains(&format!("dashboard {address}")), "{why}");
}

/// On one computer the second gateway is refused by the lock of the control, for any spelling of its address, and by the lock of the
/// folder. On another computer it detects the changing heartbeat, and arming gets status 409.
#[test]
fn two_gateways_on_one_controller() {
    let dir = tempfile::tempdir().expect("writable");
    let world = World::new(&['X', 'Y', 'Z']);
    let control = Simulator::start("0.0.0.0:0", Options::default(), world).expect("loopback");
    let at = |folder: &std::path::Path, host: &str, more: &str| {
        let config = configuration(folder, &control, more);
        change(&config, "focas://0.0.0.0", &format!("focas://{host}"));
        config
    };
    let config = at(dir.path(), "127.0.0.1", "auto_arm = true");
    let first = Program::start(dir.path(), &["--config", path(&config)]);
    first.wait_for("compensating");
    let other = tempfile::tempdir().expect("writable");
    for spelling in ["127.0.0.1", "localhost", "LocalHost", "[::1]", "0.0.0.0"] {
        let why = does_not_start(at(other.path(), spelling, ""), "127.0.0.1:0");
        assert!(
            why.contains("another gateway on this computer"),
            "{spelling}: {why}"
        );
    }
    let text = std::fs::read_to_string(&config).expect("written");
    let in_folder = dir.path().join("other.toml");
    std::fs::write(
        &in_folder,
        text.replace("focas://127.0.0.1", "focas://127.0.0.3"),
    )
    .expect("writable");
    let why = does_not_start(in_folder, "127.0.0.1:0");
    assert!(why.contains("[audit] dir: another gateway"), "{why}");
    let config = at(other.path(), "127.0.0.2", "");
    let second = Program::start(other.path(), &["--config", path(&config)]);
    second
        .wait(|state| state["cycle"]["count"].as_u64() > Some(100))
        .expect("it runs");
    let refused = second.post("/api/arm", "");
    assert_eq!(refused.status, 409);
    assert!(refused.body.contains("another gateway"), "{}", refused.body);
    first.wait_for("compensating");
}

#[test]
fn a_second_signal_leaves_at_once() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    change(&config, "ramp_s = 0.1", "ramp_s = 60\nstop_s = 60");
    let mut program = Program::start(dir.path(), &["--config", path(&config)]);
    program
        .wait(|state| {
            state["correction_um"]["X"]
                .as_f64()
                .is_some_and(|um| um < -1.0)
        })
        .expect("it ramps in");
    program.signal("TERM");
    std::thread::sleep(Duration::from_millis(300));
    assert!(
        program.running.try_wait().expect("ours").is_none(),
        "it ramps out"
    );
    program.signal("TERM");
    let begun = Instant::now();
    assert_eq!(program.end(), Some(0));
    assert!(begun.elapsed() < Duration::from_secs(2));
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    assert!(audit.contains("\"what\":\"stopped\"") && audit.contains("\"left_um\""));
}

/// A gateway that never corrected leaves a correction found at its start alone when it stops, since that may be another gateway's.
#[test]
fn stopping_leaves_a_found_correction_alone() {
    let (_dir, config, mut gateway) = manual::started("");
    let mut found = PerChannel::ZERO;
    found[0] = 0.020;
    gateway.rig.overwrite(&found);
    gateway.wait_until_says("a correction is applied");
    gateway.watch();
    let rig = gateway.stop();
    assert_eq!(rig.controls.axes.applied(), found);
    let mut gateway = Gateway::again(rig, &config);
    gateway.wait_until_says("a correction is applied");
    gateway.watch();
    assert_eq!(gateway.ask(Operation::Disarm).0, 200);
    gateway.wait("ramped out", |state| state["correction_um"]["X"] == 0.0);
    assert_eq!(gateway.shifts(), PerChannel::ZERO);
}

/// SIGHUP reloads the files. A change above `confirm_um` waits for the hash, also over HTTP.
#[test]
fn sighup_reloads_and_http_confirms() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let machine = dir.path().join("machine.toml");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let corrects = |um: f64| {
        let is_it = |state: &serde_json::Value| state["correction_um"]["Y"] == um;
        program.wait(is_it).expect("what is applied follows");
    };
    corrects(-20.0);
    change(&machine, "EYX = 20.0", "EYX = 25.0");
    program.signal("HUP");
    corrects(-25.0);
    change(&machine, "EYX = 25.0", "EYX = 100.0");
    let asked = program.post("/api/reload", "");
    assert_eq!(asked.status, 409, "{}", asked.body);
    let other = program.post("/api/reload", "{\"confirm\": \"sha256:00\"}");
    assert_eq!(other.status, 409, "{}", other.body);
    let body = format!("{{\"confirm\": {}}}", asked.json()["model"]);
    let confirmed = program.post("/api/reload", &body);
    assert_eq!(confirmed.status, 200, "{}", confirmed.body);
    corrects(-100.0);
}

pub(crate) fn failed(config: PathBuf, slot: &Arc<Slot>, turn: ServiceStep<'_>) -> Failure {
    failed_at(([127, 0, 0, 1], 0).into(), config, slot, turn)
}

pub(crate) fn failed_at(
    listen: SocketAddr,
    config: PathBuf,
    slot: &Arc<Slot>,
    turn: ServiceStep<'_>,
) -> Failure {
    let machine = Machine {
        options: GatewayOptions {
            config: Some(config),
            listen: Some(listen),
            ..GatewayOptions::default()
        },
        proven_within: Duration::from_secs(4),
    };
    machine.run(machine.plan().expect("right"), slot, turn);
    let Phase::Failed(failure) = slot.phase() else {
        panic!("it has not failed");
    };
    failure
}

/// If the control thread ends unexpectedly, the program fails with status 1.
#[test]
fn a_machine_without_its_control_thread_has_failed() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "");
    let mut turns = 0;
    let mut turn = |service: &mut Service| {
        service.poll();
        turns += 1;
        if turns == 20 {
            // A stop request ends a failed service immediately.
            service.stop(&mut || true);
        }
    };
    let failure = failed(config, &Arc::default(), &mut turn);
    assert_eq!(turns, 20, "it is noticed at once");
    assert_eq!(failure.status, 1);
    let reported = "the control thread has ended unexpectedly";
    assert!(failure.what.contains(reported), "{}", failure.what);
}

/// A panic injected into the service ramps the correction out and ends the program with status 1.
#[test]
fn a_fault_of_the_program_ramps_the_correction_out() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let slot = Arc::default();
    let mut largest = 0.0_f64;
    let mut turn = |service: &mut Service| {
        largest = largest.max(control.world().shifts()[0].abs());
        let Phase::Running(live) = Slot::phase(&slot) else {
            panic!("it runs");
        };
        let compensates = live.published.latest().state.name() == "compensating";
        assert!(!(compensates && largest > 0.015), "injected");
        service.poll();
    };
    let failure = failed(config, &slot, &mut turn);
    assert_eq!(failure.status, 1);
    assert!(failure.what.contains("a fault of the program"));
    assert!(largest > 0.015, "it never corrected");
    assert_eq!(control.world().shifts(), [0.0; 3]);
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log"));
    assert!(audit.expect("a log").contains("\"what\":\"failed\""));
}

const FAKETIME: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1";

#[test]
fn a_wall_clock_that_jumps_changes_nothing_but_the_dates() {
    if !Path::new(FAKETIME).exists() {
        volcomp_test_support::peers::not_run("faketime");
        return;
    }
    let dir = tempfile::tempdir().expect("writable");
    let stamp = dir.path().join("stamp");
    std::fs::write(&stamp, "+0").expect("writable");
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command
        .env("LD_PRELOAD", FAKETIME)
        .env("FAKETIME_TIMESTAMP_FILE", &stamp)
        .env("FAKETIME_NO_CACHE", "1")
        .env("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let arguments = ["--config", path(&config)];
    let mut program = Program::spawn(command, dir.path(), &arguments);
    program.wait_for("compensating");
    for jump in ["-10d", "+3650d", "+0"] {
        let before = program.state()["cycle"]["count"].as_u64().expect("a count");
        std::fs::write(&stamp, jump).expect("writable");
        // On a busy computer it may hold briefly, regardless of the clock.
        let went_on = program.wait(|state| {
            state["cycle"]["count"].as_u64() > Some(before + 100)
                && state["state"] == "compensating"
        });
        went_on.unwrap_or_else(|state| panic!("{jump}: {state}"));
        // The dates in the log jump, but its order does not change.
        assert_eq!(program.post("/api/disarm", "").status, 200);
        program.wait_for("disarmed");
        program.must_arm();
        program.wait_for("compensating");
    }
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    let text = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    let records: Vec<serde_json::Value> = text
        .lines()
        .filter_map(|line| serde_json::from_str(line.split_once(' ')?.1).ok())
        .collect();
    let years: std::collections::BTreeSet<String> = records
        .iter()
        .filter_map(|r| Some(r["time"].as_str()?.get(..4)?.to_owned()))
        .collect();
    assert!(years.len() >= 2, "the clock did jump: {years:?}");
    let steadily = |pair: &[serde_json::Value]| {
        pair[0]["monotonic_s"].as_f64() <= pair[1]["monotonic_s"].as_f64()
            && pair[0]["seq"].as_u64() < pair[1]["seq"].as_u64()
    };
    assert!(records.windows(2).all(steadily));
}
