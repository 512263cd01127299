//! Faults of a fleet: no server, a full disk, damaged files, wrong clocks, a duplicated machine.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use volcomp_focas::simulator::Simulator;
use volcomp_gateway::audit::verify;

use crate::{
    controlled::control,
    fleet_bench::{Centre, compensating, corrects_y, machine_with, wait},
    hung_disk::preloaded,
    manual::{Served, no_step, says},
    program::{Program, change, path},
    standing::SmallDisk,
};

/// Numbers of the received messages, by instance (one start of a gateway).
fn numbers(centre: &Centre) -> BTreeMap<String, BTreeSet<u64>> {
    let mut numbers: BTreeMap<String, BTreeSet<u64>> = BTreeMap::new();
    for stream in ["telemetry", "audit"] {
        for (_, document) in centre.reported(stream) {
            let instance = document["instance"].as_str().expect("text").to_owned();
            let number = document["number"].as_u64().expect("a number");
            assert!(numbers.entry(instance).or_default().insert(number), "twice: {document}");
        }
    }
    numbers
}

fn is_whole(numbers: &BTreeSet<u64>) -> bool {
    numbers.last() == Some(&(numbers.len() as u64))
}

/// A gateway that starts without a server corrects. Its queued messages arrive later, each once, and the audit records
/// in order with their hash chain.
#[test]
fn messages_queued_while_the_centre_is_away_arrive_later() {
    let Some(mut centre) = Centre::start() else {
        return;
    };
    centre.stop();
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let program = compensating(&config);
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
    // A second outage during the transfer of the queue.
    centre.stop();
    wait(&program, "it notices", |state| state["fleet"]["connected"] == false);
    corrects_y(&program, -25.0);
    assert_eq!(program.post("/api/disarm", "").status, 200);
    centre.restart();
    // The oldest messages are sent first, so that there is no gap before the last one.
    volcomp_test_support::until("all of it comes", Duration::from_secs(60), || {
        let lines = centre.bodies("audit", "audit");
        let is_there = |line: &serde_json::Value| line.to_string().contains("disarm\\\"");
        let conditions = centre.bodies("telemetry", "condition");
        lines.iter().any(is_there)
            && conditions.len() > 5
            && numbers(&centre).values().all(is_whole)
    });
    program.stop();
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
    // The last records may be written after the server was closed, but there is no gap before them.
    assert!(audit.starts_with(&sent), "{audit}\nsent:\n{sent}");
    assert!(sent.contains("\"what\":\"disarm\""), "{sent}");
    assert_eq!(numbers(&centre).len(), 1, "one start");
    let conditions = centre.bodies("telemetry", "condition");
    assert!(
        conditions.iter().any(|reported| reported["state"] == "compensating"
            && reported["correction_um"]["Y"] == -20.0
            && reported["armed"] == true),
        "{conditions:?}"
    );
    let whole = centre.bodies("telemetry", "telemetry");
    let last = whole.last().expect("some");
    crate::documents::validate("gateway-state.json", last);
}

/// The server rejects audit records and acknowledgements, as when their stream is full. The states arrive immediately,
/// the rejected messages later.
#[test]
fn refused_audit_records_delay_no_state() {
    let Some(centre) = Centre::start() else {
        return;
    };
    centre.limit_audit_messages(1);
    centre.roll_out(1, &machine_with(25.0));
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let gateway = compensating(&config);
    wait(&gateway, "it reports why its records wait", |state| {
        let waiting = state["fleet"]["waiting"].as_str();
        waiting.is_some_and(|waiting| waiting.contains("message size"))
    });
    let conditions = || centre.bodies("telemetry", "condition").len();
    let before = conditions();
    volcomp_test_support::until("its states arrive", Duration::from_secs(60), || {
        conditions() >= before + 5
    });
    assert_eq!(centre.reported("audit"), []);
    centre.limit_audit_messages(-1);
    centre.acknowledged(1, "activated");
    volcomp_test_support::until("its records arrive", Duration::from_secs(60), || {
        !centre.bodies("audit", "audit").is_empty()
    });
    wait(&gateway, "nothing waits", |state| state["fleet"]["waiting"].is_null());
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
    let programs = [&one, &two].map(|dir| compensating(&centre.configuration(dir.path())));
    for program in &programs {
        corrects_y(program, -25.0);
    }
    volcomp_test_support::until("both report", Duration::from_secs(60), || {
        let numbers = numbers(&centre);
        numbers.len() == 2 && numbers.values().all(|numbers| numbers.len() > 5)
    });
}

/// A configuration of a member for a program, which needs a simulated control.
fn with_control(centre: &Centre, dir: &Path, control: &Simulator) -> PathBuf {
    let config = centre.configuration(dir);
    let address = format!("focas://{}\"", control.address());
    change(&config, "focas://127.0.0.1:1\"", &address);
    config
}

const FAKETIME: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1";

/// If the wall clock jumps by ten years and back, the correction continues and the same manifests are accepted. The
/// dates in the log jump, but its order does not change.
#[test]
fn a_wall_clock_that_jumps_changes_nothing_but_the_dates() {
    if !Path::new(FAKETIME).exists() {
        volcomp_test_support::peers::not_run("faketime");
        return;
    }
    let Some(centre) = Centre::start() else {
        return;
    };
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
    let config = with_control(&centre, dir.path(), &control);
    let mut program = Program::spawn(command, dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    let first = centre.roll_out(1, &machine_with(22.0));
    centre.acknowledged(1, "activated");
    for (version, jump) in [(2_u8, "-3650d"), (3, "+3650d"), (4, "+0")] {
        let before = program.state()["cycle"]["count"].as_u64().expect("a count");
        std::fs::write(&stamp, jump).expect("writable");
        // On a busy computer a late cycle makes the gateway hold for a moment, whatever the clock does.
        wait(&program, jump, |state| {
            state["cycle"]["count"].as_u64() > Some(before + 100)
                && state["state"] == "compensating"
        });
        let um = 22.0 + f64::from(version);
        centre.roll_out(version.into(), &machine_with(um));
        centre.acknowledged(version.into(), "activated");
        corrects_y(&program, -um);
        // With a wrong clock an old manifest is still rejected.
        centre.put(&first);
        centre.refused(1, "has been accepted before");
    }
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    let text = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    let records: Vec<serde_json::Value> = text
        .lines()
        .filter_map(|line| serde_json::from_str(line.split_once(' ')?.1).ok())
        .collect();
    let years: BTreeSet<&str> =
        (records.iter()).filter_map(|record| record["time"].as_str()?.get(..4)).collect();
    assert!(years.len() >= 3, "the clock did jump: {years:?}");
    let steadily = |pair: &[serde_json::Value]| {
        pair[0]["monotonic_s"].as_f64() <= pair[1]["monotonic_s"].as_f64()
            && pair[0]["seq"].as_u64() < pair[1]["seq"].as_u64()
    };
    assert!(records.windows(2).all(steadily));
}

/// On a full disk no manifest is activated, because it could not be stored. The correction continues, and a disarm is
/// executed immediately. When there is space again, the activation resumes.
#[test]
fn a_full_disk_accepts_nothing_new_and_delays_no_disarm() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let Some(disk) = SmallDisk::at(dir.path().join("fleet")) else {
        return;
    };
    let config = centre.configuration(dir.path());
    let program = compensating(&config);
    centre.roll_out(1, &machine_with(22.0));
    centre.acknowledged(1, "activated");
    corrects_y(&program, -22.0);
    disk.fill(0);
    centre.roll_out(2, &machine_with(25.0));
    wait(&program, "it says that it cannot be kept", |state| {
        let trouble = state["fleet"]["trouble"].as_str().unwrap_or("");
        trouble.contains("cannot be kept on disk")
    });
    let state = program.state();
    assert_eq!(state["armed"], true, "{state}");
    assert_eq!(state["correction_um"]["Y"], -22.0, "{state}");
    assert_eq!(state["fleet"]["version"], 1, "{state}");
    // After a restart on the full disk, everything stored is complete.
    let program = program.killed_and_started(&config);
    corrects_y(&program, -22.0);
    let model = machine_with(26.0);
    let mut manifest = centre.manifest(3, &model);
    manifest.enable = false;
    centre.send(&manifest, &model);
    program.wait_for("disarmed");
    disk.make_room();
    centre.acknowledged(3, "activated");
    let program = program.killed_and_started(&config);
    let state = wait(&program, "it stays disabled", |state| says(state, "disabled by the centre"));
    assert_eq!(state["armed"], false, "{state}");
    assert_eq!(state["fleet"]["version"], 3, "{state}");
    drop(program);
}

/// A stored machine file is modified. The gateway reports it and does not use it, the configured file is active, and
/// the file of the centre is fetched again.
#[test]
fn a_damaged_machine_file_is_reported_and_fetched_again() {
    let Some(mut centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let program = compensating(&config);
    centre.roll_out(4, &machine_with(25.0));
    centre.acknowledged(4, "activated");
    corrects_y(&program, -25.0);
    let rig = program.stop();
    centre.stop();
    let folder = dir.path().join("fleet");
    let files =
        || std::fs::read_dir(&folder).expect("there").map(|entry| entry.expect("one").path());
    let machine = files().find(|path| path.extension().is_some_and(|end| end == "toml"));
    let machine = machine.expect("kept");
    let text = std::fs::read_to_string(&machine).expect("readable");
    std::fs::write(&machine, text.replace("25.0", "125.0")).expect("writable");
    // The change from 25 to 20 µm is too small to need a confirmation.
    let program = Served::again(rig, &config);
    let state =
        wait(&program, "it says so", |state| says(state, "machine file of the centre damaged"));
    assert_eq!(state["fleet"]["version"], 0, "{state}");
    corrects_y(&program, -20.0);
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    assert!(audit.contains("files of the fleet damaged"), "{audit}");
    centre.restart();
    corrects_y(&program, -25.0);
    wait(&program, "all is well again", |state| {
        !says(state, "machine file of the centre damaged") && state["fleet"]["version"] == 4
    });
    // All files of the folder are garbage, as after a loss of data. The gateway does not correct before the centre
    // permits it.
    for path in files().filter(|path| path.is_file()).collect::<Vec<_>>() {
        std::fs::write(path, "garbage").expect("writable");
    }
    centre.stop();
    let program = program.killed_and_started(&config);
    let state = wait(&program, "it says so", |state| {
        says(state, "machine file of the centre damaged") && says(state, "disabled by the centre")
    });
    assert_eq!(state["armed"], false, "{state}");
    centre.restart();
    corrects_y(&program, -25.0);
    no_step(&program.stop());
}

/// The disk hangs during an order. The active model continues to correct, and the page reports the disk. An order to
/// disable is executed before the disk responds. Everything resumes afterwards.
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
    let config = with_control(&centre, dir.path(), &control);
    let hangs = dir.path().join("hangs");
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command
        .env("LD_PRELOAD", library)
        .env("HANGS", &hangs)
        .env("HANGS_BELOW", dir.path().join("fleet"));
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
    // The cursor of the log cannot be written either.
    let state = tells("waiting", "the disk does not answer: messages to the centre");
    assert!(state["cycle"]["count"].as_u64() > Some(count), "{state}");
    assert_eq!(state["fleet"]["version"], 1, "{state}");
    corrects_y(&program, -22.0);
    let model = machine_with(25.0);
    let mut forbids = centre.manifest(3, &model);
    forbids.enable = false;
    centre.send(&forbids, &model);
    let state = program.wait_for("disarmed");
    assert!(says(&state, "disabled by the centre"), "{state}");
    wait(&program, "it is ramped out", |_| control.world().shifts() == [0.0; 3]);
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
    for numbers in numbers(&centre).values() {
        assert!(is_whole(numbers), "{numbers:?}");
    }
}
