//! What outlives a restart: that a person disarmed it, and a fault that nobody has acknowledged.

use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
    process::Command,
    sync::Arc,
    time::Duration,
};

use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_test_support::{peers, until};

use crate::{
    controlled::{configuration, control},
    program::{MACHINE, Program, change, path, token_file},
};

fn started(config: &Path) -> Program {
    let program = Program::start(
        config.parent().expect("a folder"),
        &["--config", path(config)],
    );
    program
        .wait(|state| state["error_um"].is_array())
        .expect("it sees the machine");
    program
}

/// What stands by the file: the text with the highest count of its two slots.
pub(crate) fn kept(file: &Path) -> String {
    let text = std::fs::read_to_string(file).expect("written");
    let slots = text.lines().filter_map(|line| {
        let mut words = line.trim_end().splitn(3, ' ').skip(1);
        Some((words.next()?.parse::<u64>().ok()?, words.next()?.to_owned()))
    });
    let latest = slots.max_by_key(|(count, _)| *count);
    latest.expect("a slot").1
}

/// A file system of 512 KiB in memory; `None` for a user who may not mount one.
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

    /// Fills it but for some room.
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

fn says(state: &serde_json::Value, words: &str) -> bool {
    state["reasons"].to_string().contains(words)
}

/// Before, a restart with `auto_arm` armed what a person had disarmed.
#[test]
fn a_persons_disarming_outlives_a_restart() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let mut program = started(&config);
    program.wait_for("compensating");
    assert_eq!(program.post("/api/disarm", "").status, 200);
    program.wait_for("disarmed");
    program.running.kill();
    drop(program);
    let mut program = started(&config);
    let told = program.wait(|state| says(state, "disarmed by a person"));
    told.expect("it says why");
    std::thread::sleep(Duration::from_millis(2500));
    assert_eq!(program.state()["state"], "disarmed");
    assert_eq!(control.world().shifts(), [0.0; 3]);
    // Armed by a person again it arms by itself after the next restart.
    program.must_arm();
    program.wait_for("compensating");
    program
        .wait(|state| !says(state, "disarmed by a person"))
        .expect("past");
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    drop(program);
    started(&config).wait_for("compensating");
}

/// A person's disarming that could not be written, since the disk was full, was never written again: after a kill and a
/// restart it armed itself.
#[test]
fn a_persons_disarming_is_written_as_soon_as_it_can_be() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let mut program = started(&config);
    program.wait_for("compensating");
    // A folder of this name: the file cannot take its place.
    let file = dir.path().join("audit/standing.slots");
    std::fs::remove_file(&file).expect("it took its room at the start");
    std::fs::create_dir(&file).expect("nothing stands");
    assert_eq!(program.post("/api/disarm", "").status, 200);
    program.wait_for("disarmed");
    let told = program.wait(|state| says(state, "audit log cannot be written"));
    told.expect("it is told while it is not written");
    std::fs::remove_dir(&file).expect("empty");
    let past = program.wait(|state| !says(state, "audit log cannot be written"));
    past.expect("it is written then");
    program.running.kill();
    drop(program);
    let text = kept(&file);
    assert!(text.contains("\"disarmed_by\":\"anna\""), "{text}");
    let program = started(&config);
    std::thread::sleep(Duration::from_millis(2500));
    assert_eq!(program.state()["state"], "disarmed");
}

/// A gateway that compensates, whose disk has become full: the disk, its configuration, and itself.
fn on_a_full_disk(dir: &Path, control: &Simulator) -> Option<(SmallDisk, PathBuf, Program)> {
    let disk = SmallDisk::at(dir.join("audit"))?;
    let config = configuration(dir, control, "auto_arm = true");
    let program = started(&config);
    program.wait_for("compensating");
    disk.fill(0);
    Some((disk, config, program))
}

/// A person disarmed on a full disk and was answered 200; after a power failure the gateway armed itself again.
#[test]
fn a_persons_disarming_is_kept_on_a_full_disk() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let Some((disk, config, mut program)) = on_a_full_disk(dir.path(), &control) else {
        return;
    };
    let file = disk.0.join("standing.slots");
    assert_eq!(program.post("/api/disarm", "").status, 200);
    program.wait_for("disarmed");
    let disarmed = "\"disarmed_by\":\"anna\"";
    until("it is written down", Duration::from_secs(10), || {
        kept(&file).contains(disarmed)
    });
    program.running.kill();
    drop(program);
    disk.make_room();
    let program = started(&config);
    let told = program.wait(|state| says(state, "disarmed by a person"));
    assert_eq!(told.expect("it is remembered")["state"], "disarmed");
    assert!(kept(&file).contains(disarmed));
}

/// A fault on a full disk is one after a power failure, too.
#[test]
fn a_fault_is_kept_on_a_full_disk() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let Some((disk, config, mut program)) = on_a_full_disk(dir.path(), &control) else {
        return;
    };
    let file = disk.0.join("standing.slots");
    // Somebody else writes 30 mm into the word of Y.
    until("it is a fault", Duration::from_secs(10), || {
        control.world().set_shift(1, 30_000);
        program.state()["state"] == "faulted"
    });
    until("it is written down", Duration::from_secs(10), || {
        kept(&file).contains("\"faulted\":[")
    });
    program.running.kill();
    drop(program);
    control.world().set_shift(1, 0);
    disk.make_room();
    let program = started(&config);
    let told = program.wait(|state| says(state, "faulted before the restart"));
    assert_eq!(told.expect("it is remembered")["state"], "faulted");
    assert_eq!(program.arm().status, 409);
}

/// Where there is no room for what may have to be kept, nothing is armed; once there is, it arms.
#[test]
fn without_room_for_what_stands_it_does_not_arm() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(disk) = SmallDisk::at(dir.path().join("audit")) else {
        return;
    };
    // Enough for some records.
    disk.fill(24 * 1024);
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let program = started(&config);
    let told = program.wait(|state| says(state, "audit log cannot be written"));
    told.expect("it is told");
    let refused = program.arm();
    assert_eq!(refused.status, 409, "{}", refused.body);
    assert_eq!(program.state()["state"], "disarmed");
    disk.make_room();
    let past = program.wait(|state| !says(state, "audit log cannot be written"));
    past.expect("there is room");
    program.must_arm();
    program.wait_for("compensating");
}

/// A person who disarms while the gateway already stops (it still ramps out, and still listens) has disarmed: before, the
/// request waited for nobody, and the next start armed by itself.
#[test]
fn disarming_while_it_stops_outlives_a_restart() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    change(&config, "ramp_s = 0.1", "ramp_s = 2.0");
    let mut program = started(&config);
    program.wait_for("compensating");
    program.signal("TERM");
    program.wait_for("ramping-out");
    assert_eq!(program.post("/api/disarm", "").status, 200);
    assert_eq!(program.post("/api/acknowledge", "").status, 503);
    assert_eq!(program.end(), Some(0));
    drop(program);
    let program = started(&config);
    std::thread::sleep(Duration::from_millis(2500));
    let state = program.state();
    assert_eq!(state["state"], "disarmed", "{state}");
    assert!(says(&state, "disarmed by a person"), "{state}");
}

/// Before, killing a gateway was a way to acknowledge its fault.
#[test]
fn a_fault_outlives_a_restart_until_it_is_acknowledged() {
    let dir = tempfile::tempdir().expect("writable");
    let mut world = World::new(&['X', 'Y', 'Z']);
    // Only the position of an axis that moves shows that it does not contain the correction.
    world.motion =
        Arc::new(|elapsed| vec![400.0 + (elapsed.as_secs_f64() / 3.0).floor(), 150.0, 50.0]);
    let control = Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback");
    let config = configuration(dir.path(), &control, "auto_arm = false");
    change(&config, "test_shift_um = 0", "test_shift_um = 5");
    change(&config, "axes =", "includes_correction = true\naxes =");
    let mut program = started(&config);
    let begun = program.state()["positions_mm"]["X"].as_f64();
    program
        .wait(|state| state["positions_mm"]["X"].as_f64() > begun)
        .expect("X moves");
    program.must_arm();
    program.wait_for("faulted");
    std::thread::sleep(Duration::from_millis(300));
    program.running.kill();
    drop(program);
    change(&config, "includes_correction = true\n", "");
    change(&config, "auto_arm = false", "auto_arm = true");
    let program = started(&config);
    let state = program.wait_for("faulted");
    assert!(says(&state, "faulted before the restart"), "{state}");
    assert!(says(&state, "positions contradict"), "{state}");
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(program.state()["state"], "faulted", "auto_arm waits");
    let refused = program.post("/api/arm", "");
    assert_eq!(refused.status, 409, "{}", refused.body);
    assert!(
        refused.body.contains("acknowledge the fault first"),
        "{}",
        refused.body
    );
    // While an emergency stop is on it could be acknowledged all the same.
    control.world().set_emergency_stop(true);
    program
        .wait(|state| says(state, "emergency stop"))
        .expect("it is seen");
    let refused = program.post("/api/acknowledge", "");
    assert_eq!(refused.status, 409, "{}", refused.body);
    assert!(refused.body.contains("still faulted"), "{}", refused.body);
    assert_eq!(program.state()["state"], "faulted");
    control.world().set_emergency_stop(false);
    program
        .wait(|state| !says(state, "emergency stop"))
        .expect("it is released");
    let acknowledged = program.post("/api/acknowledge", "");
    assert_eq!(acknowledged.status, 200, "{}", acknowledged.body);
    program
        .wait(|state| state["state"] != "faulted")
        .expect("past");
    program.must_arm();
    program.wait_for("compensating");
}

/// Nobody knows what lines that are not reached were left with. An orderly end of a run that never knew it wrote down zero,
/// which the next run took for true.
#[test]
fn what_is_unknown_stays_unknown_over_an_orderly_end() {
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
    for run in 0..3 {
        let mut program = Program::start(dir.path(), &["--config", path(&config)]);
        let told = program.wait(|state| says(state, unknown));
        let told = told.unwrap_or_else(|state| panic!("run {run}: {state}"));
        assert_eq!(told["correction_known"], false, "{told}");
        program.signal("TERM");
        assert_eq!(program.end(), Some(0));
        let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
        let stopped = audit
            .lines()
            .rfind(|line| line.contains("\"what\":\"stopped\""));
        let stopped = stopped.expect("written");
        assert!(stopped.contains("\"left_um\":{}"), "{stopped}");
    }
}
