//! From start to end: signals, restarts, the log on disk, wrong calls.

use std::{
    path::Path,
    process::Command,
    sync::Arc,
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_focas::simulator::{Options, Simulator, World};

use crate::program::{MACHINE, Program, change, path, token_file};

/// A control whose X goes to and fro.
pub(crate) fn control() -> Simulator {
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|elapsed| {
        let x = 400.0 + 300.0 * (elapsed.as_secs_f64() * 0.5).sin();
        vec![x, 150.0, 50.0]
    });
    Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback")
}

/// A configuration for a control, with its machine and tokens.
pub(crate) fn configuration(dir: &Path, control: &Simulator, more: &str) -> std::path::PathBuf {
    std::fs::write(dir.join("machine.toml"), MACHINE).expect("writable");
    token_file(dir);
    let text = format!(
        r#"
machine = "machine.toml"
cycle_ms = 4.0
{more}
[guard]
limit_um = 150.0
slew_um_per_s = 500.0
hold_ms = 500
zero_after_ms = 3000
confirm_um = 10.0
# It moves all the time.
test_shift_um = 0
[[controller]]
url = "focas://{}"
axes = ["X", "Y", "Z"]
heartbeat = {{ pmc = "R", at = 120 }}
[dashboard]
token_file = "tokens"
"#,
        control.address()
    );
    let file = dir.join("G.toml");
    std::fs::write(&file, text).expect("writable");
    file
}

/// Shifts of X over time while something is done.
fn watched(control: &Simulator, act: impl FnOnce() + Send) -> Vec<(Instant, f64)> {
    let done = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watch = scope.spawn(|| {
            let mut trace = Vec::new();
            while !done.load(std::sync::atomic::Ordering::Relaxed) {
                let shift = control.world().shifts()[0];
                trace.push((Instant::now(), shift));
                std::thread::sleep(Duration::from_millis(1));
            }
            trace
        });
        act();
        done.store(true, std::sync::atomic::Ordering::Relaxed);
        watch.join().expect("no panic")
    })
}

/// Over any window no more than the slew rate, a step, and five cycles that were late.
fn no_step(trace: &[(Instant, f64)]) {
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

#[test]
fn killed_in_the_middle_and_started_again_there_is_no_step() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let arguments = ["--config", path(&config)];
    let trace = watched(&control, || {
        let mut program = Program::start(dir.path(), &arguments);
        program.wait_for("compensating");
        std::thread::sleep(Duration::from_millis(500));
        program.child.kill().expect("ours");
        let _ = program.child.wait();
        let held = control.world().shifts()[0];
        assert!(held.abs() > 0.005, "it corrected: {held}");
        drop(program);
        let mut program = Program::start(dir.path(), &arguments);
        program.wait_for("compensating");
        program.signal("TERM");
        assert_eq!(program.end(), Some(0));
        assert_eq!(control.world().shifts(), [0.0; 3], "ramped out");
    });
    assert!(trace.len() > 500);
    no_step(&trace);
}

#[test]
fn a_control_that_reboots_with_its_shift_cleared_is_ramped_in_again() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    control.disconnect_all();
    control
        .world()
        .write(volcomp_focas::PmcArea::R, 100, &[0; 6]);
    // From zero: the first write after it is a small one.
    let trace = watched(&control, || {
        let arming =
            program.wait(|state| state["state"] == "arming" || state["state"] == "holding");
        arming.expect("it noticed");
        program.wait_for("compensating");
    });
    let first = trace
        .iter()
        .find(|(_, shift)| *shift != 0.0)
        .expect("it corrects again")
        .1;
    assert!(first.abs() <= 0.012, "{first}");
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    assert!(
        audit.contains("\"state\":\"holding\"")
            || audit.contains("controller's correction changed")
    );
}

/// Answers that take longer than a cycle: it corrects all the same, and says that cycles are missed.
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

/// What systemd hears: that it is ready, that cycles go on, that it stops.
#[test]
fn the_service_manager_is_told() {
    let dir = tempfile::tempdir().expect("writable");
    let socket = dir.path().join("notify");
    let listener = std::os::unix::net::UnixDatagram::bind(&socket).expect("writable");
    listener
        .set_read_timeout(Some(Duration::from_secs(20)))
        .expect("a time");
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command
        .env("NOTIFY_SOCKET", &socket)
        .env("WATCHDOG_USEC", "400000");
    let mut program = Program::spawn(command, dir.path(), &["--simulate"]);
    let heard = || {
        let mut buffer = [0; 256];
        let count = listener.recv(&mut buffer).expect("a word");
        String::from_utf8_lossy(&buffer[..count]).into_owned()
    };
    assert!(heard().contains("READY=1"));
    for _ in 0..5 {
        assert!(heard().contains("WATCHDOG=1"));
    }
    program.signal("TERM");
    while !heard().contains("STOPPING=1") {}
    assert_eq!(program.end(), Some(0));
}

#[test]
fn two_gateways_on_one_controller() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let first = Program::start(dir.path(), &["--config", path(&config)]);
    first.wait_for("compensating");
    // On the same host: the lock.
    let second = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
        .args(["--config", path(&config), "--listen", "127.0.0.1:0"])
        .output()
        .expect("built");
    assert_eq!(second.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&second.stderr).contains("another gateway on this computer"));
    // As from another host, by another name: the heartbeat moves.
    let other = tempfile::tempdir().expect("writable");
    let config = configuration(other.path(), &control, "");
    change(&config, "focas://127.0.0.1", "focas://localhost");
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
fn a_torn_log_is_cut_and_a_forged_one_put_aside() {
    let dir = tempfile::tempdir().expect("writable");
    let log = dir.path().join("audit/audit.log");
    let whole = {
        let mut program = Program::simulated(dir.path());
        program.wait_for("compensating");
        program.signal("INT");
        assert_eq!(program.end(), Some(0));
        std::fs::read_to_string(&log).expect("a log")
    };
    std::fs::write(&log, &whole[..whole.len() - 40]).expect("writable");
    let restarted = Program::simulated(dir.path());
    assert!(restarted.log().contains("torn tail"), "{}", restarted.log());
    drop(restarted);
    let again = std::fs::read_to_string(&log).expect("a log");
    let last_line = whole[..whole.len() - 40].rfind('\n').expect("lines");
    let kept = &whole[..=last_line];
    assert!(again.starts_with(kept) && again.len() > kept.len());
    // Somebody changes a record.
    std::fs::write(
        &log,
        again.replacen("\"who\":\"auto_arm\"", "\"who\":\"nobody\"", 1),
    )
    .expect("writable");
    let restarted = Program::simulated(dir.path());
    assert!(
        restarted.log().contains("does not belong to the chain"),
        "{}",
        restarted.log()
    );
    assert!(dir.path().join("audit/audit.broken-1.log").exists());
}

/// A file that may not grow stands for a disk that is full.
#[test]
fn a_full_disk_forbids_arming_but_not_correcting_nor_disarming() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    change(&config, "hold_ms = 500", "hold_ms = 500\nramp_s = 0.1");
    let audit = dir.path().join("audit");
    let mut shell = Command::new("bash");
    // 8 blocks of a KiB; without the signal a write fails instead.
    let limited = "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\"";
    shell.args(["-c", limited, env!("CARGO_BIN_EXE_volcomp-gateway")]);
    let program = Program::spawn(shell, dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    let mut refused = None;
    for _ in 0..40 {
        let disarmed = program.post("/api/disarm", "");
        assert_eq!(disarmed.status, 200, "{}", disarmed.body);
        program.wait_for("disarmed");
        let armed = program.post("/api/arm", "");
        if armed.status != 200 {
            refused = Some(armed);
            break;
        }
    }
    let refused = refused.expect("the log is full by now");
    assert_eq!(refused.status, 409);
    assert!(
        refused.body.contains("audit log cannot be written"),
        "{}",
        refused.body
    );
    let state = program
        .wait(|state| state["reasons"].to_string().contains("audit log"))
        .expect("it says so");
    assert_eq!(state["state"], "disarmed");
    // What is in the log is whole.
    let (_, found) = volcomp_gateway::audit::AuditLog::open(&audit).expect("readable");
    assert_eq!((found.cut_bytes, found.broken), (0, None));
}

#[test]
fn a_second_signal_leaves_at_once() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    change(
        &config,
        "hold_ms = 500",
        "hold_ms = 500\nramp_s = 60\nstop_s = 60",
    );
    let mut program = Program::start(dir.path(), &["--config", path(&config)]);
    program
        .wait(|state| state["correction_um"]["X"].as_f64() < Some(-1.0))
        .expect("it ramps in");
    program.signal("TERM");
    std::thread::sleep(Duration::from_millis(300));
    assert!(
        program.child.try_wait().expect("ours").is_none(),
        "it ramps out"
    );
    program.signal("TERM");
    let begun = Instant::now();
    assert_eq!(program.end(), Some(0));
    assert!(begun.elapsed() < Duration::from_secs(2));
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    assert!(audit.contains("\"what\":\"stopped\"") && audit.contains("\"left_um\""));
}

#[test]
fn status_and_check_speak_for_themselves() {
    let dir = tempfile::tempdir().expect("writable");
    let program = Program::simulated(dir.path());
    program.wait_for("compensating");
    let call = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
            .args(arguments)
            .output()
            .expect("built");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (
            output.status.code(),
            text(&output.stdout),
            text(&output.stderr),
        )
    };
    let address = program.address.to_string();
    let (status, text, _) = call(&["status", "--listen", &address]);
    assert_eq!(status, Some(0));
    assert!(
        text.contains("compensating") && text.contains("spindle"),
        "{text}"
    );
    let (_, json, _) = call(&["status", "--json", "--listen", &address]);
    assert_eq!(
        serde_json::from_str::<Value>(&json).expect("JSON")["state"],
        "compensating"
    );
    assert_eq!(call(&["status", "--listen", "127.0.0.1:1"]).0, Some(1));
    let control = control();
    let config = configuration(dir.path(), &control, "");
    let (status, text, _) = call(&["check", path(&config)]);
    assert_eq!(status, Some(0), "{text}");
    assert!(text.contains("axes X Y Z"), "{text}");
    for (from, to, expected) in [
        ("limit_um = 150.0", "limit_um = \"much\"", "guard.limit_um"),
        ("slew_um_per_s = 500.0", "", "slew_um_per_s"),
        ("hold_ms = 500", "hold_ms = 500\nhold_s = 1", "hold_s"),
        (
            "axes = [\"X\", \"Y\", \"Z\"]",
            "axes = [\"X\", \"W\"]",
            "axis W",
        ),
        ("heartbeat = { pmc = \"R\", at = 120 }", "", "heartbeat"),
        (
            "machine = \"machine.toml\"",
            "machine = \"missing.toml\"",
            "missing.toml",
        ),
        (
            "[dashboard]",
            "[dashboard]\nlisten = \"0.0.0.0:0\"",
            "tls_certificate",
        ),
        ("token_file = \"tokens\"", "token_file = \"G.toml\"", "mode"),
    ] {
        let text = std::fs::read_to_string(&config).expect("readable");
        assert!(text.contains(from), "{from}");
        let wrong = dir.path().join("wrong.toml");
        std::fs::write(&wrong, text.replacen(from, to, 1)).expect("writable");
        let (status, _, message) = call(&["check", path(&wrong)]);
        assert_eq!(status, Some(2), "{to}: {message}");
        assert!(message.contains(expected), "{message}");
    }
}

/// Axes that never stand still keep the test shift waiting; a person who disarms then is not overruled by auto_arm.
#[test]
fn auto_arm_does_not_overrule_a_person() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    change(&config, "test_shift_um = 0", "test_shift_um = 5");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let state = program.wait_for("arming");
    assert!(
        state["reasons"]
            .to_string()
            .contains("waiting for standstill"),
        "{state}"
    );
    assert_eq!(program.post("/api/disarm", "").status, 200);
    program.wait_for("disarmed");
    std::thread::sleep(Duration::from_millis(2500));
    assert_eq!(program.state()["state"], "disarmed");
    assert_eq!(control.world().shifts(), [0.0; 3]);
}

/// Without [guard] it runs and shows, and does not arm.
#[test]
fn without_limits_it_does_not_arm() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let text = std::fs::read_to_string(&config).expect("readable");
    let (before, rest) = text.split_once("[guard]").expect("there");
    let (_, after) = rest.split_once("[[controller]]").expect("there");
    std::fs::write(&config, format!("{before}[[controller]]{after}")).expect("writable");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    program
        .wait(|state| state["positions_mm"]["Y"] == 150.0)
        .expect("it shows");
    let refused = program.post("/api/arm", "");
    assert_eq!(refused.status, 409);
    assert!(
        refused.body.contains("limits are not configured"),
        "{}",
        refused.body
    );
    assert_eq!(program.state()["state"], "disarmed");
}

/// The configuration of the manual.
#[test]
fn the_documented_configuration_is_right() {
    let dir = tempfile::tempdir().expect("writable");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    std::fs::copy(
        root.join("../../examples/gantry.toml"),
        dir.path().join("machine.toml"),
    )
    .expect("there");
    let text = std::fs::read_to_string(root.join("debian/gateway.toml")).expect("there");
    let config = dir.path().join("G.toml");
    std::fs::write(&config, text).expect("writable");
    crate::program::token_file(dir.path());
    let config = volcomp_gateway::config::Config::read(&config).unwrap_or_else(|e| panic!("{e}"));
    let plan = volcomp_gateway::plan::Plan::new(config).unwrap_or_else(|e| panic!("{e}"));
    let text = plan.text();
    assert!(text.contains("focas://192.0.2.10:8193"), "{text}");
    assert!(text.contains("axes X Y Z"), "{text}");
}

#[test]
fn elsewhere_only_with_tls_and_a_token() {
    let dir = tempfile::tempdir().expect("writable");
    let call = |arguments: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
            .args(arguments)
            .output()
            .expect("built")
    };
    let refused = call(&["--simulate", "--listen", "0.0.0.0:0"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("tls-init"));
    let made = call(&["tls-init", "localhost", "127.0.0.1", "-o", path(dir.path())]);
    assert_eq!(made.status.code(), Some(0));
    assert_eq!(
        call(&["tls-init", "localhost", "-o", path(dir.path())])
            .status
            .code(),
        Some(1),
        "keys are not overwritten"
    );
    let control = control();
    let config = configuration(dir.path(), &control, "");
    let free = std::net::TcpListener::bind("127.0.0.1:0")
        .and_then(|l| l.local_addr())
        .expect("loopback")
        .port();
    let tls = "tls_certificate = \"certificate.pem\"\ntls_key = \"key.pem\"";
    let dashboard = format!("[dashboard]\nlisten = \"0.0.0.0:{free}\"\n{tls}");
    change(&config, "[dashboard]", &dashboard);
    let log = std::fs::File::create(dir.path().join("log")).expect("writable");
    let child = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
        .args(["--config", path(&config)])
        .stdout(std::process::Stdio::null())
        .stderr(log)
        .spawn()
        .expect("built");
    let mut child = scopeguard(child);
    let end = Instant::now() + Duration::from_secs(20);
    let without = loop {
        let output = call(&["status", "--config", path(&config)]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        if message.contains("401") || Instant::now() > end {
            break message;
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    assert!(without.contains("answers 401"), "{without}");
    let with = call(&[
        "status",
        "--config",
        path(&config),
        "--token-file",
        path(&viewer(dir.path())),
    ]);
    assert_eq!(
        with.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&with.stderr)
    );
    assert!(String::from_utf8_lossy(&with.stdout).contains("disarmed"));
    child.0.kill().expect("ours");
}

fn viewer(dir: &Path) -> std::path::PathBuf {
    let file = dir.join("viewer");
    std::fs::write(&file, crate::program::VIEW).expect("writable");
    file
}

/// Ended whatever happens.
struct Guarded(std::process::Child);

fn scopeguard(child: std::process::Child) -> Guarded {
    Guarded(child)
}

impl Drop for Guarded {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
