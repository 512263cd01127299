//! The whole process: signals, restarts, slow controls, a second gateway, and failures.

use std::{net::SocketAddr, path::PathBuf, process::Command, sync::Arc, time::Duration};

use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_gateway::{
    error::Failure,
    machine::{Machine, Phase, ServiceStep, Slot},
    options::Options as GatewayOptions,
    request::Operation,
    service::Service,
};
use volcomp_vocabulary::PerChannel;

use crate::{
    manual::{self, Gateway, configuration, control, controlled_configuration, no_step},
    program::{PATIENCE, Program, change, path},
    standing::SmallDisk,
};

/// The gateway is killed at several moments of the ramp and of compensating, and started again. No output changes by
/// more than the slew in a cycle and one step.
#[test]
fn killed_in_the_middle_and_started_again_there_is_no_step() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    change(&config, "ramp_s = 0.1", "ramp_s = 0.5");
    let mut gateway = Gateway::start(&config);
    for (state, ms) in
        [("arming", 100), ("arming", 350), ("compensating", 0), ("compensating", 2500)]
    {
        gateway.wait_for(state);
        gateway.run(Duration::from_millis(ms));
        assert!(gateway.shifts()[1].abs() > 0.001, "{state}: it corrects");
        gateway = gateway.killed_and_started(&config);
    }
    gateway.wait_for("compensating");
    let rig = gateway.stop();
    assert_eq!(rig.controls.axes.applied(), PerChannel::ZERO, "ramped out");
    no_step(&rig);
}

/// The built-in simulation notifies its service manager that it is ready, that cycles run, and that it stops. It raises
/// the limit of file descriptors, whose usual soft value is 1024, as far as permitted.
#[test]
fn the_simulation_lives_and_the_service_manager_is_notified() {
    let dir = tempfile::tempdir().expect("writable");
    let socket = dir.path().join("notify");
    let listener = std::os::unix::net::UnixDatagram::bind(&socket).expect("writable");
    listener.set_read_timeout(Some(PATIENCE)).expect("a time");
    let mut shell = Command::new("sh");
    let program = env!("CARGO_BIN_EXE_volcomp-gateway");
    shell.args(["-c", "ulimit -S -n 256; exec \"$0\" \"$@\"", program]);
    shell.env("NOTIFY_SOCKET", &socket).env("WATCHDOG_USEC", "400000");
    let mut program = Program::simulated(shell, dir.path());
    let received = || {
        let mut buffer = [0; 256];
        let count = listener.recv(&mut buffer).expect("a word");
        String::from_utf8_lossy(&buffer[..count]).into_owned()
    };
    assert!(received().contains("READY=1"));
    for _ in 0..5 {
        assert!(received().contains("WATCHDOG=1"));
    }
    crate::http::the_simulation_lives(&program);
    let limits = std::fs::read_to_string(format!("/proc/{}/limits", program.running.id()));
    let limits = limits.expect("it runs");
    let files = limits.lines().find_map(|line| line.strip_prefix("Max open files"));
    let files: Vec<&str> = files.expect("a line").split_whitespace().collect();
    assert!(files[0] == files[1] && files[0] != "256", "{files:?}");
    program.signal("TERM");
    while !received().contains("STOPPING=1") {}
    assert_eq!(program.end(), Some(0));
}

/// The log goes to a full disk, to a pipe whose reader has ended, or to a full pipe whose reader has stopped. The
/// gateway corrects nevertheless, and ramps out at its end.
#[test]
fn a_log_that_cannot_be_written_ends_nothing() {
    let full = "2> >(exec tail --pid=$$ -f /dev/null); timeout 2 head -c 65536 /dev/zero >&2";
    for log in ["2>/dev/full", "2> >(true)", full] {
        let dir = tempfile::tempdir().expect("writable");
        let mut shell = Command::new("bash");
        let program = env!("CARGO_BIN_EXE_volcomp-gateway");
        shell.args(["-c", &format!("exec {log}; exec \"$0\" \"$@\""), program]);
        let mut program = Program::simulated(shell, dir.path());
        program.wait_for("compensating");
        program.signal("TERM");
        assert_eq!(program.end(), Some(0), "{log}");
        let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("written");
        let last = audit.lines().last().expect("a record");
        assert!(last.contains("\"stopped\"") && last.contains("disarmed"), "{log}: {last}");
    }
}

/// The reason why a gateway with its dashboard at `listen` does not start.
fn does_not_start(config: PathBuf, listen: &str) -> String {
    let listen = listen.parse().expect("an address");
    let turn = &mut |_: &mut Service| panic!("it has started");
    let failure = failed_at(listen, config, &Arc::default(), turn);
    assert_eq!(failure.status, 1, "{failure:?}");
    failure.what
}

/// Another program uses the port of the dashboard. The gateway exits with status 1, and its message names the address.
#[test]
fn a_port_that_is_taken_ends_it_with_status_1() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("loopback");
    let address = taken.local_addr().expect("bound").to_string();
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let why = does_not_start(config, &address);
    assert!(why.contains(&format!("dashboard {address}")) && why.contains("--listen"), "{why}");
}

/// The disk of the audit log has become read-only, with and without a log of an earlier run. The gateway does not start,
/// because neither its records nor an operator's disarm could be kept.
#[test]
fn a_read_only_audit_folder_is_refused() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(disk) = SmallDisk::at(dir.path().join("audit")) else {
        return;
    };
    let config = manual::configuration(dir.path(), "auto_arm = true");
    let remount = |option: &str| {
        let options = format!("remount,{option}");
        let mount = Command::new("mount").args(["-o", &options, path(&disk.0)]).status();
        assert!(mount.expect("of the system").success());
    };
    for _ in 0..2 {
        remount("ro");
        let why = manual::machine(&config).plan().err().expect("read-only").to_string();
        assert!(why.contains("/audit\" cannot be used: Read-only file system"), "{why}");
        remount("rw");
        let mut gateway = Gateway::start(&config);
        gateway.wait_for("compensating");
        gateway.stop();
    }
}

/// On one computer the lock of the control refuses a second gateway, for any spelling of the control's address, and so
/// does the lock of the folder. A gateway on another computer detects the changing heartbeat, and arming gets status
/// 409.
#[test]
fn two_gateways_on_one_controller() {
    let dir = tempfile::tempdir().expect("writable");
    let world = World::new(&['X', 'Y', 'Z']);
    let control = Simulator::start("0.0.0.0:0", Options::default(), world).expect("loopback");
    let at = |folder: &std::path::Path, host: &str, more: &str| {
        let config = controlled_configuration(folder, &control, more);
        change(&config, "focas://0.0.0.0", &format!("focas://{host}"));
        config
    };
    let config = at(dir.path(), "127.0.0.1", "auto_arm = true");
    let first = Program::start(dir.path(), &["--config", path(&config)]);
    first.wait_for("compensating");
    let other = tempfile::tempdir().expect("writable");
    for spelling in ["127.0.0.1", "localhost", "LocalHost", "[::1]", "0.0.0.0"] {
        let why = does_not_start(at(other.path(), spelling, ""), "127.0.0.1:0");
        assert!(why.contains("another gateway on this computer"), "{spelling}: {why}");
    }
    let text = std::fs::read_to_string(&config).expect("written");
    let in_folder = dir.path().join("other.toml");
    std::fs::write(&in_folder, text.replace("focas://127.0.0.1", "focas://127.0.0.3"))
        .expect("writable");
    let why = does_not_start(in_folder, "127.0.0.1:0");
    assert!(why.contains("[audit] dir: another gateway"), "{why}");
    let config = at(other.path(), "127.0.0.2", "");
    let second = Program::start(other.path(), &["--config", path(&config)]);
    second.wait(|state| state["cycle"]["count"].as_u64() > Some(100)).expect("it runs");
    let refused = second.post("/api/arm", "");
    assert_eq!(refused.status, 409);
    assert!(refused.body.contains("another gateway"), "{}", refused.body);
    first.wait_for("compensating");
}

/// When a gateway that never corrected ends, it leaves a correction that it found in place, because the correction may
/// be that of another gateway.
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

/// A control whose answers take longer than a cycle is corrected, and missed cycles are reported. SIGHUP reloads the
/// files; a change that needs a confirmation waits for the hash, over HTTP too. The first termination signal ramps out,
/// and a second one ends the program immediately.
#[test]
fn signals_reload_ramp_out_and_leave_at_once() {
    let dir = tempfile::tempdir().expect("writable");
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|_| vec![400.0, 150.0, 50.0]);
    let options = Options { latency: Duration::from_millis(7), ..Options::default() };
    let control = Simulator::start("127.0.0.1:0", options, world).expect("loopback");
    let config = controlled_configuration(dir.path(), &control, "auto_arm = true");
    let mut program = Program::start(dir.path(), &["--config", path(&config)]);
    let corrects = |program: &Program, um: f64| {
        let is_it = |state: &serde_json::Value| state["correction_um"]["Y"] == um;
        let state = program.wait(is_it);
        state.expect("what is applied follows")
    };
    let state = corrects(&program, -20.0);
    assert!(state["cycle"]["overruns"].as_u64() > Some(10), "{state}");
    assert!(manual::says(&state, "cycle overruns"), "{state}");
    assert_eq!(control.open_sessions(), 1);

    let machine = dir.path().join("machine.toml");
    change(&machine, "EYX = 20.0", "EYX = 25.0");
    program.signal("HUP");
    corrects(&program, -25.0);
    change(&machine, "EYX = 25.0", "EYX = 100.0");
    change(&config, "ramp_s = 0.1", "ramp_s = 0.1\nstop_s = 600");
    let asked = program.post("/api/reload", "");
    assert_eq!(asked.status, 409, "{}", asked.body);
    let other = program.post("/api/reload", "{\"confirm\": \"sha256:00\"}");
    assert_eq!(other.status, 409, "{}", other.body);
    let body = format!("{{\"confirm\": {}}}", asked.json()["model"]);
    let confirmed = program.post("/api/reload", &body);
    assert_eq!(confirmed.status, 200, "{}", confirmed.body);
    corrects(&program, -100.0);

    // Longer than the end of the program is waited for.
    change(&config, "ramp_s = 0.1", "ramp_s = 600");
    let asked = program.post("/api/reload", "");
    let body = format!("{{\"confirm\": {}}}", asked.json()["model"]);
    assert_eq!(program.post("/api/reload", &body).status, 200);
    program.signal("TERM");
    program.wait_for("ramping-out");
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    assert!(audit.contains("\"what\":\"stopped\"") && audit.contains("\"left_um\""));
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
    let config = controlled_configuration(dir.path(), &control, "");
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

/// A panic injected into the service ramps the correction out, and ends the program with status 1.
#[test]
fn a_fault_of_the_program_ramps_the_correction_out() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = controlled_configuration(dir.path(), &control, "auto_arm = true");
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
