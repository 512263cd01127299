//! Faults of a fleet: no server, a full disk, damaged files, wrong clocks, a duplicated machine.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use volcomp_gateway::audit::verify;

use crate::{
    controlled::control,
    fleet_bench::{Centre, compensating, corrects_y, goes_on, machine_with, wait},
    hung_disk::preloaded,
    process::{no_step, watched, watched_axis},
    program::{Program, path},
};

fn says(state: &serde_json::Value, words: &str) -> bool {
    state["reasons"].to_string().contains(words)
}

fn numbers(centre: &Centre) -> BTreeMap<String, BTreeSet<u64>> {
    let mut numbers: BTreeMap<String, BTreeSet<u64>> = BTreeMap::new();
    for stream in ["telemetry", "audit"] {
        for (_, document) in centre.reported(stream) {
            let instance = document["instance"].as_str().expect("text").to_owned();
            let number = document["number"].as_u64().expect("a number");
            assert!(
                numbers.entry(instance).or_default().insert(number),
                "twice: {document}"
            );
        }
    }
    numbers
}

fn is_whole(numbers: &BTreeSet<u64>) -> bool {
    numbers.last() == Some(&(numbers.len() as u64))
}

/// A gateway that starts without a server corrects. Its queued messages arrive later, each once, and the audit records in order with
/// their chain.
#[test]
fn messages_queued_while_the_centre_is_away_arrive_later() {
    let Some(mut centre) = Centre::start() else {
        return;
    };
    centre.stop();
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = centre.configuration(dir.path(), &control, "auto_arm = true");
    let mut program = compensating(dir.path(), &config);
    let fleet = program.state()["fleet"].clone();
    assert_eq!(fleet["connected"], false);
    assert!(fleet["waiting"].is_string(), "{fleet}");
    let before = program.state()["uptime_s"].as_f64().expect("a time");
    wait(&program, "it goes on for some seconds", |state| {
        state["uptime_s"].as_f64() > Some(before + 4.0)
    });
    centre.restart();
    centre.roll_out(1, &machine_with(25.0));
    centre.acknowledged(1, "activated");
    // A second outage, during the transfer.
    centre.stop();
    wait(&program, "it notices", |state| {
        state["fleet"]["connected"] == false
    });
    corrects_y(&program, -25.0);
    assert_eq!(program.post("/api/disarm", "").status, 200);
    centre.restart();
    // The oldest messages come first, so that there is no gap before the last one.
    volcomp_test_support::until("all of it comes", Duration::from_secs(60), || {
        let lines = centre.bodies("audit", "audit");
        let is_there = |line: &serde_json::Value| line.to_string().contains("disarm\\\"");
        lines.iter().any(is_there) && numbers(&centre).values().all(is_whole)
    });
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    let sent: Vec<String> = (centre.bodies("audit", "audit").iter())
        .map(|line| {
            let of = |key: &str| line[key].as_str().expect("text").to_owned();
            format!("{} {}\n", of("checksum"), of("record"))
        })
        .collect();
    let sent = sent.concat();
    let verified = verify(sent.as_bytes());
    assert_eq!(verified.broken, None, "{sent}");
    // The last records may arrive after the server has closed, but there is no gap.
    assert!(audit.starts_with(&sent), "{audit}\nsent:\n{sent}");
    assert!(sent.contains("\"what\":\"disarm\""), "{sent}");
    assert_eq!(numbers(&centre).len(), 1, "one start");
    let conditions = centre.bodies("telemetry", "condition");
    assert!(conditions.len() > 5, "{}", conditions.len());
    assert!(
        conditions
            .iter()
            .any(|reported| reported["state"] == "compensating"
                && reported["correction_um"]["Y"] == -20.0
                && reported["armed"] == true),
        "{conditions:?}"
    );
    let whole = centre.bodies("telemetry", "telemetry");
    let last = whole.last().expect("some");
    crate::documents::validate("gateway-state.json", last);
}

/// Two gateways run with the identity of one machine: the centre reports two instances at a time.
#[test]
fn a_duplicate_machine_is_detected() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let model = machine_with(25.0);
    centre.roll_out(1, &model);
    let [one, two] = [(); 2].map(|()| tempfile::tempdir().expect("writable"));
    let controls = [control(), control()];
    let configs = [(&one, &controls[0]), (&two, &controls[1])]
        .map(|(dir, control)| centre.configuration(dir.path(), control, "auto_arm = true"));
    let programs = [
        compensating(one.path(), &configs[0]),
        compensating(two.path(), &configs[1]),
    ];
    for program in &programs {
        corrects_y(program, -25.0);
    }
    volcomp_test_support::until("both report", Duration::from_secs(60), || {
        let numbers = numbers(&centre);
        numbers.len() == 2 && numbers.values().all(|numbers| numbers.len() > 5)
    });
}

const FAKETIME: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1";

/// Clocks ten years slow and ten years fast: the same manifests are accepted.
#[test]
fn no_clock_decides() {
    if !Path::new(FAKETIME).exists() {
        volcomp_test_support::peers::not_run("faketime");
        return;
    }
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = centre.configuration(dir.path(), &control, "auto_arm = true");
    let first = centre.roll_out(1, &machine_with(22.0));
    for (version, skew) in [(2, "-3650d"), (3, "+3650d")] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
        command
            .env("LD_PRELOAD", FAKETIME)
            .env("FAKETIME", skew)
            .env("FAKETIME_DONT_FAKE_MONOTONIC", "1");
        let program = Program::spawn(command, dir.path(), &["--config", path(&config)]);
        program.wait_for("compensating");
        let um = 22.0 + f64::from(version);
        centre.roll_out(
            u64::from(u8::try_from(version).expect("small")),
            &machine_with(um),
        );
        centre.acknowledged(
            u64::from(u8::try_from(version).expect("small")),
            "activated",
        );
        corrects_y(&program, -um);
        // With a wrong clock an old manifest is still rejected.
        centre.put(&first);
        centre.refused(1, "has been accepted before");
    }
    let times: Vec<f64> = (centre.reported("telemetry").iter())
        .filter_map(|(_, document)| document["wall_s"].as_f64())
        .collect();
    let first = times.iter().copied().fold(f64::INFINITY, f64::min);
    let last = times.iter().copied().fold(0.0, f64::max);
    assert!(
        last - first > 15.0 * 31_557_600.0,
        "the clocks were wrong: {first} to {last}"
    );
}

/// A small file system, unmounted on drop.
struct Small(PathBuf);

impl Small {
    /// `None` if nothing can be mounted; under CI that is a failure.
    fn mounted(folder: &Path) -> Option<Self> {
        std::fs::create_dir_all(folder).expect("writable");
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", "size=256k", "tmpfs"])
            .arg(folder)
            .status();
        if !mounted.is_ok_and(|status| status.success()) {
            volcomp_test_support::peers::not_run("the right to mount");
            return None;
        }
        Some(Self(folder.to_owned()))
    }

    fn fill(&self) -> PathBuf {
        use std::io::Write;
        let path = self.0.join("filler");
        let mut file = std::fs::File::create(&path).expect("writable");
        while file.write_all(&[0; 1024]).is_ok() {}
        while file.write_all(&[0]).is_ok() {}
        path
    }
}

impl Drop for Small {
    fn drop(&mut self) {
        // A failure cannot be handled here.
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

/// On a full disk no manifest is activated, since it could not be stored, while the correction continues and a disarm is executed at
/// once. With space again the activation resumes.
#[test]
fn a_full_disk_accepts_nothing_new_and_delays_no_disarm() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let Some(disk) = Small::mounted(&dir.path().join("fleet")) else {
        return;
    };
    let control = control();
    let config = centre.configuration(dir.path(), &control, "auto_arm = true");
    let mut program = compensating(dir.path(), &config);
    centre.roll_out(1, &machine_with(22.0));
    centre.acknowledged(1, "activated");
    corrects_y(&program, -22.0);
    let filler = disk.fill();
    centre.roll_out(2, &machine_with(25.0));
    wait(&program, "it says that it cannot be kept", |state| {
        let trouble = state["fleet"]["trouble"].as_str().unwrap_or("");
        trouble.contains("cannot be kept on disk")
    });
    let state = program.state();
    assert_eq!(state["armed"], true, "{state}");
    assert_eq!(state["correction_um"]["Y"], -22.0, "{state}");
    assert_eq!(state["fleet"]["version"], 1, "{state}");
    // After a restart on the full disk the stored state is complete.
    program.running.kill();
    drop(program);
    let program = compensating(dir.path(), &config);
    corrects_y(&program, -22.0);
    let model = machine_with(26.0);
    let mut manifest = centre.manifest(3, &model);
    manifest.enable = false;
    centre.send(&manifest, &model);
    program.wait_for("disarmed");
    std::fs::remove_file(&filler).expect("there");
    centre.acknowledged(3, "activated");
    drop(program);
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let state = wait(&program, "it stays disabled", |state| {
        says(state, "disabled by the centre")
    });
    assert_eq!(state["armed"], false, "{state}");
    assert_eq!(state["fleet"]["version"], 3, "{state}");
    drop(program);
}

/// A stored machine file is modified: it is reported and not used, the configured file is active, and the centre's file is fetched again.
#[test]
fn a_damaged_machine_file_is_reported_and_fetched_again() {
    let Some(mut centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = centre.configuration(dir.path(), &control, "auto_arm = true");
    {
        let mut program = compensating(dir.path(), &config);
        centre.roll_out(4, &machine_with(25.0));
        centre.acknowledged(4, "activated");
        corrects_y(&program, -25.0);
        program.signal("TERM");
        assert_eq!(program.end(), Some(0));
    }
    centre.stop();
    let folder = dir.path().join("fleet");
    let files = || {
        std::fs::read_dir(&folder)
            .expect("there")
            .map(|entry| entry.expect("one").path())
    };
    let machine = files().find(|path| path.extension().is_some_and(|end| end == "toml"));
    let machine = machine.expect("kept");
    let text = std::fs::read_to_string(&machine).expect("readable");
    std::fs::write(&machine, text.replace("25.0", "125.0")).expect("writable");
    let trace = watched(&control, || {
        // The change from 25 to 20 µm is below the confirmation threshold.
        let program = compensating(dir.path(), &config);
        let state = wait(&program, "it says so", |state| {
            says(state, "machine file of the centre damaged")
        });
        assert_eq!(state["fleet"]["version"], 0, "{state}");
        corrects_y(&program, -20.0);
        let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
        assert!(audit.contains("files of the fleet damaged"), "{audit}");
        centre.restart();
        corrects_y(&program, -25.0);
        wait(&program, "all is well again", |state| {
            !says(state, "machine file of the centre damaged") && state["fleet"]["version"] == 4
        });
    });
    no_step(&trace);
    // All files of the folder are garbage: nothing is corrected until the centre enables it.
    for path in files().filter(|path| path.is_file()).collect::<Vec<_>>() {
        std::fs::write(path, "garbage").expect("writable");
    }
    centre.stop();
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let state = wait(&program, "it says so", |state| {
        says(state, "machine file of the centre damaged") && says(state, "disabled by the centre")
    });
    assert_eq!(state["armed"], false, "{state}");
    centre.restart();
    corrects_y(&program, -25.0);
}

/// The disk hangs during an order: the active model continues to correct and the page reports the disk. An order to disable is executed
/// before the disk responds, and everything resumes afterwards.
#[test]
fn a_hanging_disk_delays_no_cycle_and_no_disarm() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let Some(library) = preloaded(dir.path()) else {
        return;
    };
    let control = control();
    let config = centre.configuration(dir.path(), &control, "auto_arm = true");
    let hangs = dir.path().join("hangs");
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command
        .env("LD_PRELOAD", library)
        .env("HANGS", &hangs)
        .env("HANGS_BELOW", dir.path().join("fleet"));
    let trace = watched_axis(&control, 1, || {
        let program = Program::spawn(command, dir.path(), &["--config", path(&config)]);
        program.wait_for("compensating");
        centre.roll_out(1, &machine_with(22.0));
        centre.acknowledged(1, "activated");
        corrects_y(&program, -22.0);
        std::fs::write(&hangs, "").expect("writable");
        centre.roll_out(2, &machine_with(25.0));
        let tells = |key: &str, words: &str| {
            wait(&program, words, |state| {
                let reported = state["fleet"][key].as_str().unwrap_or_default();
                reported.contains(words) && reported.contains(path(&dir.path().join("fleet")))
            })
        };
        let state = tells("trouble", "the disk does not answer: the accepted manifest");
        let count = state["cycle"]["count"].as_u64().expect("a count");
        // The position in the audit log cannot be stored either.
        let state = tells(
            "waiting",
            "the disk does not answer: messages to the centre",
        );
        assert!(state["cycle"]["count"].as_u64() > Some(count), "{state}");
        goes_on(&state, -22.0);
        assert_eq!(state["fleet"]["version"], 1, "{state}");
        let model = machine_with(25.0);
        let mut forbids = centre.manifest(3, &model);
        forbids.enable = false;
        centre.send(&forbids, &model);
        let state = program.wait_for("disarmed");
        assert!(says(&state, "disabled by the centre"), "{state}");
        wait(&program, "it is ramped out", |_| {
            control.world().shifts() == [0.0; 3]
        });
        assert!(hangs.exists(), "all of that before the disk answered");
        std::fs::remove_file(&hangs).expect("ours");
        centre.acknowledged(3, "activated");
        wait(&program, "it is over", |state| {
            state["fleet"]["trouble"].is_null() && state["fleet"]["waiting"].is_null()
        });
        centre.roll_out(4, &model);
        centre.acknowledged(4, "activated");
        program.wait_for("compensating");
        corrects_y(&program, -25.0);
    });
    no_step(&trace);
    for numbers in numbers(&centre).values() {
        assert!(is_whole(numbers), "{numbers:?}");
    }
}
