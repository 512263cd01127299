//! State that persists over a restart: an operator's disarm, and an unacknowledged fault.

use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
    process::Command,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use volcomp_gateway::request::{CentreOperation, Operation};
use volcomp_port::inject::Injection;
use volcomp_test_support::peers;
use volcomp_vocabulary::PerChannel;

use crate::{
    manual::{Gateway, configuration, says},
    program::{MACHINE, append, change, path, token_file},
};

/// The valid text of the file, which is in the slot with the higher count.
pub(crate) fn standing_text(file: &Path) -> String {
    let text = std::fs::read_to_string(file).expect("written");
    let slots = text.lines().filter_map(|line| {
        let mut words = line.trim_end().splitn(3, ' ').skip(1);
        Some((words.next()?.parse::<u64>().ok()?, words.next()?.to_owned()))
    });
    let latest = slots.max_by_key(|(count, _)| *count);
    latest.expect("a slot").1
}

/// A tmpfs of 512 KiB; `None` if the user may not mount one.
pub(crate) struct SmallDisk(pub(crate) PathBuf);

impl SmallDisk {
    pub(crate) fn at(folder: PathBuf) -> Option<Self> {
        std::fs::create_dir(&folder).expect("writable");
        let mount = Command::new("mount")
            .args(["-t", "tmpfs", "-o", "size=512k", "tmpfs", path(&folder)])
            .output();
        if mount.is_ok_and(|mount| mount.status.success()) {
            return Some(Self(folder));
        }
        peers::not_run("tmpfs");
        None
    }

    pub(crate) fn fill(&self, left: u64) {
        let path = self.0.join("filler");
        let mut filler = File::create(&path).expect("writable");
        let mut bytes = 0;
        while let Ok(more) = filler.write(&[1; 4096]) {
            bytes += more as u64;
        }
        filler.set_len(bytes - left).expect("shorter");
    }

    pub(crate) fn make_room(&self) {
        std::fs::remove_file(self.0.join("filler")).expect("there");
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").args(["-l", path(&self.0)]).status();
    }
}

const DISARMED: &str = "disarmed by the operator";
const UNWRITTEN: &str = "audit log cannot be written";

fn compensating(dir: &Path) -> (PathBuf, Gateway) {
    let config = configuration(dir, "auto_arm = true");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    (config, gateway)
}

/// Kills and restarts a disarmed gateway. Auto-arm stays off until an operator arms, and works after the next restart.
fn stays_disarmed_until_armed(gateway: Gateway, config: &Path) {
    let mut gateway = gateway.killed_and_started(config);
    gateway.wait_until_says(DISARMED);
    gateway.run(Duration::from_secs(10));
    assert_eq!(gateway.state()["state"], "disarmed");
    assert_eq!(gateway.shifts(), PerChannel::ZERO);
    gateway.must_arm();
    gateway.wait_for("compensating");
    gateway.wait_until_silent_of(DISARMED);
    let mut gateway = Gateway::again(gateway.stop(), config);
    gateway.wait_for("compensating");
}

#[test]
fn an_operators_disarm_survives_a_restart() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, mut gateway) = compensating(dir.path());
    assert_eq!(gateway.ask(Operation::Disarm).0, 200);
    gateway.wait_for("disarmed");
    stays_disarmed_until_armed(gateway, &config);
}

/// The file that records an operator's disarm was removed, but the log has records. Auto-arm stays off until an
/// operator arms.
#[test]
fn auto_arm_is_off_without_the_standing_state_of_a_log() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, mut gateway) = compensating(dir.path());
    assert_eq!(gateway.ask(Operation::Disarm).0, 200);
    gateway.wait_for("disarmed");
    let rig = gateway.stop();
    std::fs::remove_file(dir.path().join("audit/standing.slots")).expect("written");
    stays_disarmed_until_armed(Gateway::again(rig, &config), &config);
}

/// The folder is removed while the gateway runs: an operator's disarm makes it anew and survives a kill and restart, and a record is written.
#[test]
fn an_operators_disarm_is_kept_although_the_folder_was_removed() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, mut gateway) = compensating(dir.path());
    std::fs::remove_dir_all(dir.path().join("audit")).expect("it was made at the start");
    assert_eq!(gateway.ask(Operation::Disarm).0, 200);
    gateway.wait_for("disarmed");
    gateway.run(Duration::from_millis(300));
    assert!(!says(&gateway.state(), UNWRITTEN));
    assert!(gateway.audit().contains("anna"));
    stays_disarmed_until_armed(gateway, &config);
}

/// The disk is still busy with the audit log when the disarm is answered, and the program is killed. The disarm is on
/// the disk.
#[test]
fn an_operators_disarm_does_not_wait_for_its_record() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let hangs = Arc::new(AtomicBool::new(false));
    let of_log = Arc::clone(&hangs);
    let mut gateway = Gateway::with_log(&config, |log| {
        log.synced_by(move |file| {
            while of_log.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_millis(1));
            }
            file.sync_data()
        })
    });
    gateway.wait_for("compensating");
    hangs.store(true, Ordering::Relaxed);
    let mut disarms = gateway.begin(Operation::Disarm);
    for _ in 0..50 {
        gateway.cycle_alone();
        gateway.parts.service.poll_within(Duration::ZERO);
    }
    assert_eq!(disarms.try_recv().expect("answered").status, 200);
    let standing = dir.path().join("audit/standing.slots");
    let end = Instant::now() + Duration::from_secs(60);
    let is_kept = || standing_text(&standing).contains("\"disarmed_by\":\"anna\"");
    while !is_kept() && Instant::now() < end {
        thread::sleep(Duration::from_millis(1));
    }
    let is_kept = is_kept();
    // The thread of the log must not hang until the end of all tests.
    hangs.store(false, Ordering::Relaxed);
    assert!(is_kept, "the record of the log comes first");
}

/// A full disk refuses the record of an operator's disarm. The record is written as soon as there is space. After a
/// kill and restart the gateway does not arm automatically.
#[test]
fn an_operators_disarm_is_written_as_soon_as_possible() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, mut gateway) = compensating(dir.path());
    // A folder of this name prevents the file from being written.
    let file = dir.path().join("audit/standing.slots");
    std::fs::remove_file(&file).expect("it took its room at the start");
    std::fs::create_dir(&file).expect("nothing stands");
    assert_eq!(gateway.ask(Operation::Disarm).0, 200);
    gateway.wait_for("disarmed");
    gateway.wait_until_says(UNWRITTEN);
    std::fs::remove_dir(&file).expect("empty");
    gateway.wait_until_silent_of(UNWRITTEN);
    let text = standing_text(&file);
    assert!(text.contains("\"disarmed_by\":\"anna\""), "{text}");
    let mut gateway = gateway.killed_and_started(&config);
    gateway.run(Duration::from_secs(10));
    assert_eq!(gateway.state()["state"], "disarmed");
}

/// On a full disk an operator's disarm (status 200) and a fault survive a power failure.
#[test]
fn an_operators_disarm_is_kept_on_a_full_disk() {
    for (is_fault, written, reported, state) in [
        (false, "\"disarmed_by\":\"anna\"", DISARMED, "disarmed"),
        (true, "\"faulted\":[", "faulted before the restart", "faulted"),
    ] {
        let dir = tempfile::tempdir().expect("writable");
        let Some(disk) = SmallDisk::at(dir.path().join("audit")) else {
            return;
        };
        let (config, mut gateway) = compensating(dir.path());
        disk.fill(0);
        if is_fault {
            gateway.fault();
        } else {
            assert_eq!(gateway.ask(Operation::Disarm).0, 200);
            gateway.wait_for("disarmed");
        }
        gateway.run(Duration::from_millis(100));
        let text = standing_text(&disk.0.join("standing.slots"));
        assert!(text.contains(written), "{text}");
        disk.make_room();
        let mut gateway = gateway.killed_and_started(&config);
        assert_eq!(gateway.wait_until_says(reported)["state"], state);
        if is_fault {
            gateway.watch();
            assert_eq!(gateway.ask(Operation::Arm(None)).0, 409);
        }
    }
}

/// Only a run that ended properly leaves its output. A run that is killed leaves none: lines without read-back would
/// otherwise start from a correction that has changed since.
#[test]
fn the_output_of_the_previous_run_is_used_once() {
    let dir = tempfile::tempdir().expect("writable");
    let has_output = || dir.path().join("audit/output.json").exists();
    let (config, gateway) = compensating(dir.path());
    assert!(!has_output());
    let rig = gateway.stop();
    assert!(has_output());
    let _gateway = Gateway::again(rig, &config);
    assert!(!has_output());
}

/// Without disk space for the standing state, arming gets status 409. With space the gateway arms.
#[test]
fn without_room_for_the_standing_state_it_does_not_arm() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(disk) = SmallDisk::at(dir.path().join("audit")) else {
        return;
    };
    // The space left is enough for some records.
    disk.fill(24 * 1024);
    let config = configuration(dir.path(), "auto_arm = true");
    let mut gateway = Gateway::start(&config);
    gateway.wait_until_says(UNWRITTEN);
    gateway.watch();
    let (status, refused) = gateway.ask(Operation::Arm(None));
    assert_eq!(status, 409, "{refused}");
    assert_eq!(gateway.state()["state"], "disarmed");
    disk.make_room();
    gateway.wait_until_silent_of(UNWRITTEN);
    gateway.must_arm();
    gateway.wait_for("compensating");
}

/// An operator's disarm during the ramp-out of a stop is answered with 200, and survives a restart.
#[test]
fn a_disarm_while_stopping_survives_a_restart() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    change(&config, "ramp_s = 0.1", "ramp_s = 2.0");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    let mut asked = Vec::new();
    let rig = gateway.stop_while(|begin| {
        if asked.is_empty() {
            asked = vec![begin(Operation::Disarm), begin(Operation::Acknowledge)];
        }
    });
    let answers = asked.iter_mut().map(|wait| wait.try_recv().expect("answered").status);
    assert_eq!(answers.collect::<Vec<_>>(), [200, 503]);
    let mut gateway = Gateway::again(rig, &config);
    gateway.run(Duration::from_secs(10));
    let state = gateway.state();
    assert_eq!(state["state"], "disarmed", "{state}");
    assert!(says(&state, DISARMED), "{state}");
}

/// After a kill and restart a fault persists, and auto-arm waits until it is acknowledged.
#[test]
fn a_fault_survives_a_restart_until_it_is_acknowledged() {
    let dir = tempfile::tempdir().expect("writable");
    let (config, mut gateway) = compensating(dir.path());
    let state = gateway.fault();
    let why = state["reasons"][0].as_str().expect("a reason").to_owned();
    gateway.run(Duration::from_millis(300));
    let mut gateway = gateway.killed_and_started(&config);
    let state = gateway.wait_for("faulted");
    for words in ["faulted before the restart", &why] {
        assert!(says(&state, words), "{words}: {state}");
    }
    gateway.run(Duration::from_secs(10));
    assert_eq!(gateway.state()["state"], "faulted", "auto_arm waits");
    let (status, refused) = gateway.ask(Operation::Arm(None));
    assert_eq!(status, 409, "{refused}");
    let words = "acknowledge the fault first";
    assert!(refused.to_string().contains(words), "{refused}");
    // The fault cannot be acknowledged during an emergency stop.
    let stop = |gateway: &Gateway, is_on| {
        let switch = &gateway.rig.controls.emergency_stop;
        switch.store(is_on, Ordering::Relaxed);
    };
    stop(&gateway, true);
    gateway.wait_until_says("emergency stop");
    let (status, refused) = gateway.ask(Operation::Acknowledge);
    assert_eq!(status, 409, "{refused}");
    assert!(refused.to_string().contains("still faulted"), "{refused}");
    assert_eq!(gateway.state()["state"], "faulted");
    stop(&gateway, false);
    gateway.wait_until_silent_of("emergency stop");
    let (status, acknowledged) = gateway.ask(Operation::Acknowledge);
    assert_eq!(status, 200, "{acknowledged}");
    gateway.wait("past", |state| state["state"] != "faulted");
    gateway.must_arm();
    gateway.wait_for("compensating");
}

/// A fault that the operator has acknowledged leaves the gateway disarmed, even after a restart, until the operator
/// arms.
#[test]
fn an_acknowledged_fault_stays_disarmed_after_a_restart() {
    for is_from_before in [false, true] {
        let dir = tempfile::tempdir().expect("writable");
        let (config, mut gateway) = compensating(dir.path());
        gateway.fault();
        gateway.run(Duration::from_secs(1));
        if is_from_before {
            gateway = gateway.killed_and_started(&config);
            gateway.wait_for("faulted");
            gateway.watch();
        }
        assert_eq!(gateway.ask(Operation::Acknowledge).0, 200);
        gateway.wait_for("disarmed");
        stays_disarmed_until_armed(gateway, &config);
    }
}

/// An operator who accepts a jumped temperature while the gateway corrects does not disarm it. The gateway arms again
/// after a restart.
#[test]
fn an_acknowledgement_while_armed_leaves_auto_arm_on() {
    let dir = tempfile::tempdir().expect("writable");
    let config = with_thermometer(dir.path());
    let mut gateway = Gateway::start(&config);
    let_sensor_jump(&mut gateway);
    assert_eq!(gateway.ask(Operation::Acknowledge).0, 200);
    gateway.wait("believed", |state| quality(state).contains("good"));
    assert!(!says(&gateway.state(), DISARMED));
    let mut gateway = gateway.killed_and_started(&config);
    gateway.wait_for("compensating");
}

/// The correction of digital lines that become unreachable is unknown. An orderly stop must not record zero, because
/// the next run would trust it.
#[test]
fn an_unknown_correction_stays_unknown_after_an_orderly_end() {
    let dir = tempfile::tempdir().expect("writable");
    std::fs::write(dir.path().join("machine.toml"), MACHINE).expect("writable");
    token_file(dir.path());
    let config = dir.path().join("G.toml");
    let text = r#"
machine = "machine.toml"
cycle_ms = 20.0
[guard]
limit_um = 30.0
slew_um_per_s = 500.0
hold_ms = 200
zero_after_ms = 3000
[[controller]]
url = "modbus://127.0.0.1:1?profile=ADAM-6050"
axes = ["X"]
fixed = { Y = 0.0, Z = 0.0 }
unwatched = true
unseen = ["referenced", "alarm", "emergency_stop"]
[controller.digital]
position_bits = 8
position_mm_per_count = 10.0
correction_bits = 6
[dashboard]
token_file = "tokens"
"#;
    std::fs::write(&config, text).expect("writable");
    let unknown = "what the control was left with is unknown";
    let mut gateway = Gateway::start(&config);
    for run in 0..3 {
        gateway.disconnect();
        let reported = gateway.wait_until_says(unknown);
        assert_eq!(reported["correction_known"], false, "{run}: {reported}");
        let audit = dir.path().join("audit/audit.log");
        let rig = gateway.stop();
        let audit = std::fs::read_to_string(audit).expect("a log");
        let stopped = audit.lines().rfind(|line| line.contains("\"what\":\"stopped\""));
        let stopped = stopped.expect("written");
        assert!(stopped.contains("\"left_um\":{}"), "{stopped}");
        gateway = Gateway::again(rig, &config);
    }
}

/// A machine whose X scale expands by 11.5 µm/(m·K).
pub(crate) fn with_thermometer(dir: &Path) -> PathBuf {
    let config = configuration(dir, "auto_arm = true");
    let profile = "name = \"ONE\"\n[channels]\nfunction = 4\naddress = 0\ncount = 1\ntype = \"i16\"\nscale = 0.1\nunit = \"degc\"\nvalid_degc = [-50.0, 200.0]\n";
    let file = dir.join("one.toml");
    std::fs::write(&file, profile).expect("writable");
    let thermal = "[thermal]\nreference = 20.0\n[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale_x\"\num_per_m_k = 11.5\n";
    std::fs::write(dir.join("machine.toml"), format!("{MACHINE}{thermal}")).expect("writable");
    let url = format!("modbus://127.0.0.1:1?profile={}", file.display());
    append(&config, &format!("[[thermometer]]\nurl = \"{url}\"\nnames = [\"scale_x\"]\n"));
    config
}

fn quality(state: &Value) -> String {
    let sensor = &state["temperatures"][0];
    format!("{} {}", sensor["quality"], sensor["reason"])
}

fn let_sensor_jump(gateway: &mut Gateway) {
    gateway.wait_for("compensating");
    gateway.wait("good", |state| quality(state).contains("good"));
    let (sensor, kelvin) = (0, 15.0);
    gateway.rig.inject_sensor(Injection::Jump { sensor, kelvin });
    gateway.wait("jumped", |state| quality(state).contains("jumped"));
}

/// A sensor was excluded after a jump, and the gateway was restarted, also after a full disk. The first reading is not
/// accepted, and auto-arm waits.
#[test]
fn a_sensor_that_jumped_keeps_a_restart_from_arming() {
    for is_full in [false, true] {
        let dir = tempfile::tempdir().expect("writable");
        let folder = dir.path().join("audit");
        let disk = is_full.then(|| SmallDisk::at(folder.clone()));
        let Some(disk) = disk.map_or(Some(None), |disk| disk.map(Some)) else {
            return;
        };
        let config = with_thermometer(dir.path());
        let mut gateway = Gateway::start(&config);
        gateway.wait_for("compensating");
        if let Some(disk) = &disk {
            disk.fill(0);
        }
        let_sensor_jump(&mut gateway);
        // The jump is kept while the sensor has another error.
        let (sensor, kelvin) = (0, 500.0);
        gateway.rig.inject_sensor(Injection::Jump { sensor, kelvin });
        gateway.wait("out", |state| quality(state).contains("out of range"));
        gateway.run(Duration::from_millis(100));
        assert!(standing_text(&folder.join("standing.slots")).contains("scale_x"));
        if let Some(disk) = &disk {
            disk.make_room();
        }
        let mut gateway = gateway.killed_and_started(&config);
        let reported = "temperature that jumped before the restart: scale_x";
        assert_eq!(gateway.wait_until_says(reported)["state"], "faulted");
        gateway.run(Duration::from_secs(10));
        assert_eq!(gateway.state()["state"], "faulted");
        assert_eq!(gateway.ask(Operation::Acknowledge).0, 200);
        assert_ne!(gateway.state()["state"], "faulted");
    }
}

#[test]
fn acknowledging_an_alarm_accepts_no_jumped_sensor() {
    let dir = tempfile::tempdir().expect("writable");
    let config = with_thermometer(dir.path());
    let mut gateway = Gateway::start(&config);
    let_sensor_jump(&mut gateway);
    gateway.rig.controls.alarm.store(true, Ordering::Relaxed);
    gateway.wait_for("holding");
    gateway.ask(Operation::Acknowledge);
    gateway.rig.controls.alarm.store(false, Ordering::Relaxed);
    gateway.wait_for("compensating");
    gateway.run(Duration::from_secs(12));
    let state = gateway.state();
    assert!(quality(&state).contains("jumped"), "{state}");
    assert!(says(&state, "degraded: scale_x"), "{state}");
    assert!(gateway.audit().contains("\"degraded: scale_x\""), "{}", gateway.audit());
    let jump = |gateway: &Gateway, kelvin| {
        let sensor = 0;
        let jump = Injection::Jump { sensor, kelvin };
        gateway.rig.inject_sensor(jump);
    };
    jump(&gateway, 500.0);
    gateway.wait("out", |state| quality(state).contains("out of range"));
    let (status, answer) = gateway.ask(Operation::Acknowledge);
    assert_eq!(status, 409);
    let why = "a temperature that jumped has no valid reading now";
    assert!(answer.to_string().contains(why), "{answer}");
    jump(&gateway, 15.0);
    gateway.wait("jumped", |state| quality(state).contains("jumped"));
    assert_eq!(gateway.ask(Operation::Acknowledge).0, 200);
    gateway.wait("believed", |state| quality(state).contains("good"));
    gateway.run(Duration::from_secs(12));
    assert!(gateway.audit().contains("\"no longer degraded\""), "{}", gateway.audit());
}

/// The control stops responding during an emergency stop, and the gateway is killed. The stop persists until the
/// control reports its end or the operator acknowledges it.
#[test]
fn an_interlock_not_seen_to_clear_survives_a_restart() {
    let unseen = "interlock not seen to clear";
    for returns in [false, true] {
        let dir = tempfile::tempdir().expect("writable");
        let (config, mut gateway) = compensating(dir.path());
        let stop = Arc::clone(&gateway.rig.controls);
        stop.emergency_stop.store(true, Ordering::Relaxed);
        gateway.wait_until_says("emergency stop");
        gateway.disconnect();
        gateway.wait_until_says(unseen);
        gateway.run(Duration::from_millis(200));
        let mut gateway = gateway.killed_and_started(&config);
        gateway.run(Duration::from_secs(1));
        let state = gateway.state();
        assert!(says(&state, unseen) && says(&state, "emergency stop"), "{state}");
        if returns {
            gateway.rig.inject(Injection::Disconnect { calls: 0 });
            gateway.run(Duration::from_secs(10));
            let state = gateway.state();
            assert_eq!(state["state"], "disarmed", "{state}");
            assert!(says(&state, "emergency stop") && !says(&state, unseen), "{state}");
            stop.emergency_stop.store(false, Ordering::Relaxed);
            gateway.wait_for("compensating");
        } else {
            assert_eq!(gateway.ask(Operation::Acknowledge).0, 200);
            gateway.wait_until_silent_of(unseen);
            let mut gateway = gateway.killed_and_started(&config);
            gateway.run(Duration::from_secs(1));
            assert!(!says(&gateway.state(), unseen), "{}", gateway.state());
        }
    }
}

/// Adds `add` to all later positions of X, mm.
fn displace(gateway: &Gateway, add: f64) {
    gateway.rig.inject(Injection::WrongPosition { axis: 0, factor: 1.0, add, readings: u32::MAX });
}

const JUMPED: &str = "position jumped: X";

/// X jumps by 200 mm within its travel and is rejected.
fn let_position_jump(gateway: &mut Gateway) {
    let x = gateway.state()["positions_mm"]["X"].as_f64();
    let is_high = x.expect("known") > 400.0;
    displace(gateway, if is_high { -200.0 } else { 200.0 });
    let state = gateway.wait("held", |state| state["state"] == "holding" && says(state, JUMPED));
    assert_eq!(state["wanted_um"], json!({}), "unknown is not zero: {state}");
}

/// Auto-arm does not accept the rejected position; the operator may.
fn accepts_no_jumped_position(gateway: &mut Gateway) {
    gateway.wait("restarted", |state| state["error_um"].is_array() && !says(state, "watching"));
    gateway.run(Duration::from_secs(10));
    let state = gateway.state();
    assert_eq!(state["state"], "disarmed", "{state}");
    assert!(says(&state, JUMPED), "{state}");
    displace(gateway, 0.0);
    gateway.must_arm();
    let state = gateway.wait_for("compensating");
    assert!(!says(&state, "jumped"), "{state}");
}

/// The gateway ends while a position is rejected, and starts again on the same wrong position.
#[test]
fn a_position_that_jumped_keeps_a_restart_from_arming() {
    for is_killed in [false, true] {
        let dir = tempfile::tempdir().expect("writable");
        let (config, mut gateway) = compensating(dir.path());
        let_position_jump(&mut gateway);
        gateway.run(Duration::from_secs(6));
        let rig = if is_killed { gateway.killed() } else { gateway.stop() };
        let mut gateway = Gateway::again(rig, &config);
        accepts_no_jumped_position(&mut gateway);
        let mut gateway = Gateway::again(gateway.stop(), &config);
        gateway.wait_for("compensating");
    }
}

/// The centre disables and enables a machine. Auto-arm resumes if the position is accepted again, but not while it is
/// rejected.
#[test]
fn the_centre_enables_no_jumped_position() {
    let dir = tempfile::tempdir().expect("writable");
    let (_, mut gateway) = compensating(dir.path());
    let disable_and_enable = |gateway: &mut Gateway| {
        for (operation, says) in
            [(CentreOperation::Disable, true), (CentreOperation::Enable, false)]
        {
            assert_eq!(gateway.ask(Operation::Centre(operation)).0, 200);
            gateway.wait("obeyed", |state| {
                state["state"] == "disarmed"
                    && state["reasons"].to_string().contains("disabled by the centre") == says
            });
        }
    };
    let_position_jump(&mut gateway);
    displace(&gateway, 0.0);
    gateway.wait_for("compensating");
    disable_and_enable(&mut gateway);
    gateway.wait_for("compensating");
    let_position_jump(&mut gateway);
    disable_and_enable(&mut gateway);
    accepts_no_jumped_position(&mut gateway);
}

/// An operator disarms after the cycle has armed, but before the service has received the new state. The name of the
/// operator is recorded.
#[test]
fn a_disarm_right_after_arming_survives_a_restart() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let standing = dir.path().join("audit/standing.slots");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    let mut armed = 0;
    for cycles in 0..12 {
        assert_eq!(gateway.ask(Operation::Disarm).0, 200);
        gateway.wait_for("disarmed");
        let mut arms = gateway.begin(Operation::Arm(None));
        for _ in 0..cycles {
            gateway.step();
        }
        gateway.cycle_alone();
        let mut disarms = gateway.begin(Operation::Disarm);
        gateway.run(Duration::from_secs(1));
        armed += u32::from(arms.try_recv().expect("answered").status == 200);
        assert_eq!(disarms.try_recv().expect("answered").status, 200);
        let text = standing_text(&standing);
        assert!(text.contains("\"disarmed_by\":\"anna\""), "{cycles}: {text}");
        assert_eq!(gateway.state()["state"], "disarmed", "{cycles}");
    }
    assert!((1..12).contains(&armed), "{armed} of 12 were armed first");
    let mut gateway = gateway.killed_and_started(&config);
    gateway.run(Duration::from_secs(10));
    assert_eq!(gateway.state()["state"], "disarmed");
}
