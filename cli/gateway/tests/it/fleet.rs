//! A machine of a fleet, with a real `nats-server` and a simulated control.
//!
//! Manifests are accepted or rejected, and no axis steps. The faults are: no server, a full disk, damaged files, wrong
//! clocks, a duplicated machine, and a cut network between the machine and its centre.
//!
//! For the cut network, each side is in a separate network namespace, connected by a pair of virtual cards. The frames
//! of one or both directions are lost without an error, as with a failing switch. Each of these tests starts itself
//! again in the namespace of the site. The centre with its server and web interface is started in the other namespace.
//! Namespaces and cards end with the programs in them.

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::Range,
    path::{Path, PathBuf},
    process::{Command, Output},
    time::{Duration, SystemTime},
};

use base64::{Engine, engine::general_purpose::STANDARD};
use serde_json::Value;
use volcomp_focas::simulator::Simulator;
use volcomp_gateway::audit::verify;
use volcomp_test_support::{Running, peers, until};
use volcomp_vocabulary::PerChannel;

use crate::{
    audit::preloaded,
    fleet_bench::{Centre, compensating, corrects_y, goes_on, machine_with, wait},
    fleet_whole::{LONG, Place, Whole, machine_text},
    manual::{Served, control, no_step, says},
    program::{Client, MACHINE, Program, change, path},
    standing::SmallDisk,
};

/// The centre forbids correcting while an older version is being activated. Correcting stays forbidden, whenever the
/// order arrives.
#[test]
fn an_order_to_disable_outlives_the_activation_of_an_older_version() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let program = compensating(&config);
    let mut version = 0;
    for delay_ms in [0_u8, 2, 5, 10, 20, 50, 100] {
        let model = machine_with(22.0 + f64::from(delay_ms % 3));
        version += 1;
        centre.roll_out(version, &model);
        std::thread::sleep(std::time::Duration::from_millis(delay_ms.into()));
        version += 1;
        let mut forbids = centre.manifest(version, &model);
        forbids.enable = false;
        centre.send(&forbids, &model);
        centre.acknowledged(version, "activated");
        let state = program.state();
        let shown = format!("after {delay_ms} ms: {state}");
        assert!(says(&state, "disabled by the centre"), "{shown}");
        assert_eq!(state["armed"], false, "{shown}");
        version += 1;
        centre.roll_out(version, &model);
        centre.acknowledged(version, "activated");
        wait(&program, "it corrects again", |state| state["state"] == "compensating");
    }
}

/// A small change ramps in, and a large one waits for its confirmation. No axis moves faster than the slew. After a restart without the
/// centre the accepted manifest is still active.
#[test]
fn a_roll_out_is_confirmed_ramped_in_and_outlives_the_centre() {
    let Some(mut centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let program = compensating(&config);
    corrects_y(&program, -20.0);
    centre.roll_out(1, &machine_with(25.0));
    centre.acknowledged(1, "activated");
    corrects_y(&program, -25.0);
    assert_eq!(program.state()["fleet"]["version"], 1);
    // A model with 75 µm more, which is not confirmed.
    let large = machine_with(100.0);
    centre.roll_out(2, &large);
    let asked = centre.acknowledged(2, "needs-confirmation");
    assert_eq!(asked["worst_um"], "75.0");
    corrects_y(&program, -25.0);
    let state = program.state();
    assert_eq!(state["fleet"]["version"], 1);
    assert_eq!(state["fleet"]["accepted"], 2);
    let mut confirmed = centre.manifest(3, &large);
    confirmed.confirm = asked["hash"].as_str().map(str::to_owned);
    centre.send(&confirmed, &large);
    centre.acknowledged(3, "activated");
    corrects_y(&program, -100.0);
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    let key = STANDARD.encode(centre.key.verifying_key().to_bytes());
    let who = format!("\"who\":\"centre {}\",\"what\":\"reload\"", &key[..8]);
    assert_eq!(audit.matches(&who).count(), 2, "{who} in {audit}");
    // The centre has ended for good. The machine needs neither the centre nor the configured machine file.
    centre.stop();
    let rig = program.stop();
    std::fs::remove_file(dir.path().join("machine.toml")).expect("there");
    let program = Served::again(rig, &config);
    corrects_y(&program, -100.0);
    let fleet = program.state()["fleet"].clone();
    assert_eq!(fleet["connected"], false, "{fleet}");
    assert_eq!(fleet["version"], 3, "{fleet}");
    no_step(&program.stop());
}

/// An order of the centre to disable ramps the correction out. The machine cannot be armed, even after a restart, until
/// the centre enables it.
#[test]
fn what_the_centre_disables_stays_disarmed_until_it_enables() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let model = machine_with(25.0);
    let program = compensating(&config);
    let mut manifest = centre.manifest(1, &model);
    manifest.enable = false;
    centre.send(&manifest, &model);
    let state = program.wait_for("disarmed");
    assert!(says(&state, "disabled by the centre"), "{state}");
    centre.acknowledged(1, "activated");
    let refused = program.arm();
    assert_eq!(refused.status, 409, "{}", refused.body);
    assert!(says(&refused.json(), "disabled by the centre"));
    assert_eq!(program.state()["state"], "disarmed");
    let program = program.killed_and_started(&config);
    program.watch();
    let state = wait(&program, "it says so after the restart", |state| {
        says(state, "disabled by the centre") && state["error_um"].is_array()
    });
    assert_eq!(state["state"], "disarmed");
    assert_eq!(program.gateway().shifts(), PerChannel::ZERO);
    centre.roll_out(2, &model);
    // Auto-arm resumes, because only the order prevented arming.
    program.wait_for("compensating");
    corrects_y(&program, -25.0);
    assert_eq!(program.state()["fleet"]["enabled"], true);
}

/// A value that is not signed for this machine, is older, or is damaged changes nothing. The gateway reports the
/// reason.
#[test]
fn rogue_values_change_nothing() {
    let Some(centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let program = compensating(&config);
    let first = centre.roll_out(5, &machine_with(22.0));
    centre.acknowledged(5, "activated");
    centre.roll_out(6, &machine_with(25.0));
    centre.acknowledged(6, "activated");
    corrects_y(&program, -25.0);
    let refused = |version: u64, words: &str| {
        let why = centre.refused(version, words);
        assert!(why.len() < 400, "{why}");
        // The outcome shown is that of the accepted manifest, which could not be activated.
        let fleet = program.state()["fleet"].clone();
        let shown =
            [&fleet["refused"], &fleet["outcome"]].map(|text| text.as_str().unwrap_or_default());
        assert!(shown.iter().any(|text| text.contains(words)), "{fleet}");
    };
    // A replay of an old manifest with a trusted signature.
    centre.put(&first);
    refused(5, "its version is 5, and 6 has been accepted before");
    let model = machine_with(28.0);
    let another = volcomp_fleet::SigningKey::from_bytes(&[8; 32]);
    let stranger = volcomp_fleet::Desired::sign(&centre.manifest(7, &model), &model, &another);
    centre.put(&stranger.expect("plain").bytes().expect("plain"));
    refused(7, "untrusted key");
    let mut serial = centre.manifest(8, &model);
    serial.serial = "4712".to_owned();
    centre.send(&serial, &model);
    refused(8, "the serial number \"4712\"");
    let mut axes = centre.manifest(9, &model);
    axes.axes.swap(0, 1);
    centre.send(&axes, &model);
    refused(9, "meant for the axes");
    let manifest = centre.manifest(10, &model);
    let mut tampered =
        volcomp_fleet::Desired::sign(&manifest, &model, &centre.key).expect("plain data");
    tampered.model = Some(machine_with(29.0));
    centre.put(&tampered.bytes().expect("plain data"));
    refused(10, "does not match the checksum");
    // Garbage, of the maximum size that the server accepts.
    centre.put(b"\xff\x00 no JSON");
    refused(0, "the document of the manifest");
    let huge = format!("{{\"{}\": 1}}", "x".repeat(3_900_000));
    centre.put(huge.as_bytes());
    refused(0, "unknown field");
    // The object store holds other content than the manifest names.
    let large = format!("{model}#{}\n", "-".repeat(volcomp_fleet::INLINE_LIMIT));
    let manifest = centre.manifest(11, &large);
    centre.store(&manifest.model.sha256, &large.replace("28.0", "88.0"));
    centre.send(&manifest, &large);
    refused(11, "its checksum differs");
    // An invalid machine file with a valid signature.
    let no_machine = "structure = \"w X' b Y Z t\"\n[axes.X]\n";
    centre.roll_out(12, no_machine);
    refused(12, "travel");
    let state = program.state();
    assert_eq!(state["state"], "compensating");
    assert_eq!(state["correction_um"]["Y"], -25.0);
    assert_eq!(state["fleet"]["version"], 6);
    // A valid manifest is accepted, even with its model in the object store.
    let manifest = centre.manifest(13, &large);
    centre.store(&manifest.model.sha256, &large);
    centre.send(&manifest, &large);
    centre.acknowledged(13, "activated");
    corrects_y(&program, -28.0);
}

/// The gateway is killed between acceptance and activation. After its restart it activates the manifest once. The same
/// manifest again changes nothing.
#[test]
fn a_restart_between_acceptance_and_activation_continues() {
    let Some(mut centre) = Centre::start() else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let config = centre.configuration(dir.path());
    let model = machine_with(25.0);
    let large = format!("{model}#{}\n", "-".repeat(volcomp_fleet::INLINE_LIMIT));
    let manifest = centre.manifest(1, &large);
    let program = compensating(&config);
    // The server does not have the machine file yet: the manifest is accepted, and its activation waits.
    centre.send(&manifest, &large);
    wait(&program, "it is accepted", |state| {
        state["fleet"]["accepted"] == 1 && state["fleet"]["trouble"].is_string()
    });
    assert_eq!(program.state()["correction_um"]["Y"], -20.0);
    let rig = program.killed();
    centre.store(&manifest.model.sha256, &large);
    let program = Served::again(rig, &config);
    centre.acknowledged(1, "activated");
    corrects_y(&program, -25.0);
    // The server is killed and restarted. The same value again changes nothing.
    let ramps = || {
        let audit = program.gateway().audit();
        audit.matches("\"state\":\"arming\"").count()
    };
    let before = ramps();
    centre.stop();
    wait(&program, "it notices", |state| state["fleet"]["connected"] == false);
    centre.restart();
    wait(&program, "it is back", |state| state["fleet"]["connected"] == true);
    centre.send(&manifest, &large);
    centre.roll_out(2, &machine_with(26.0));
    centre.acknowledged(2, "activated");
    corrects_y(&program, -26.0);
    assert_eq!(ramps(), before + 1, "one ramp for one change");
}

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
    crate::interop::validate("gateway-state.json", last);
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

/// Set if this program runs inside the namespace of the site.
const INSIDE: &str = "VOLCOMP_TEST_SITE";
const SITE: &str = "10.77.0.2";
const CENTRE: &str = "10.77.0.1";
/// A MAC address of no interface, so that frames to it are lost.
const ABSENT_MAC: &str = "02:00:00:00:00:99";
/// Server settings. The server disconnects a gateway that is silent for three seconds; the gateway drops a dead
/// connection within 30 s.
const SHORT: &str = "ping_interval: \"1s\"\nping_max: 2\nwrite_deadline: \"2s\"\n";

/// The direction in which frames are lost.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Lost {
    Everything,
    ToTheCentre,
    ToTheSite,
}

/// The namespaces of centre and site. This program runs in the namespace of the site.
struct Network {
    /// A process that keeps the centre's namespace alive.
    holder: Running,
}

impl Network {
    fn new() -> Self {
        let mut holder = Command::new("unshare");
        holder.args(["--net", "sh", "-c", "echo ready; exec sleep 600"]);
        let network = Self { holder: Running::start_ready(&mut holder) };
        let id = network.holder.id().to_string();
        ip(&["link", "add", "site", "type", "veth", "peer", "name", "centre", "netns", &id]);
        ip(&["addr", "add", &format!("{SITE}/30"), "dev", "site"]);
        ip(&["link", "set", "site", "up"]);
        network.at_centre(&["addr", "add", &format!("{CENTRE}/30"), "dev", "centre"]);
        for card in ["lo", "centre"] {
            network.at_centre(&["link", "set", card, "up"]);
        }
        network
    }

    fn namespace(&self) -> String {
        format!("--net=/proc/{}/ns/net", self.holder.id())
    }

    fn at_centre(&self, words: &[&str]) {
        let mut command = Command::new("nsenter");
        command.args([&self.namespace(), "ip"]).args(words);
        done(&mut command);
    }

    fn place(&self) -> Place {
        let through = ["nsenter", &self.namespace()];
        Place::elsewhere(&through, [&format!("{CENTRE}:4222"), "127.0.0.1:8460"], SHORT)
    }

    fn cut(&self, lost: Lost) {
        let to = ["lladdr", ABSENT_MAC, "nud", "permanent"];
        if lost != Lost::ToTheSite {
            ip(&[&["neigh", "replace", CENTRE, "dev", "site"], &to[..]].concat());
        }
        if lost != Lost::ToTheCentre {
            self.at_centre(&[&["neigh", "replace", SITE, "dev", "centre"], &to[..]].concat());
        }
    }

    fn heal(&self, lost: Lost) {
        if lost != Lost::ToTheSite {
            ip(&["neigh", "del", CENTRE, "dev", "site"]);
        }
        if lost != Lost::ToTheCentre {
            self.at_centre(&["neigh", "del", SITE, "dev", "centre"]);
        }
    }
}

fn ip(words: &[&str]) {
    done(Command::new("ip").args(words));
}

fn done(command: &mut Command) {
    let status = command.status();
    assert!(status.is_ok_and(|status| status.success()), "{command:?}");
}

/// The command that starts a program in a new network namespace; `None` if none of the candidates works.
fn into_namespace() -> Option<&'static [&'static str]> {
    const WAYS: [&[&str]; 3] = [
        &["unshare", "--net"],
        &["unshare", "--user", "--map-root-user", "--net"],
        &["sudo", "-n", "-E", "unshare", "--net"],
    ];
    // The command must permit creating virtual cards and entering another namespace.
    let probe =
        "ip link add site type veth peer name centre && nsenter --net=/proc/self/ns/net true";
    WAYS.into_iter().find(|way| {
        let tried = Command::new(way[0]).args(&way[1..]).args(["sh", "-c", probe]).output();
        tried.is_ok_and(|tried| tried.status.success())
    })
}

/// Runs a test in a separate network namespace.
fn at_site(name: &str, work: impl FnOnce()) {
    if std::env::var_os(INSIDE).is_some() {
        ip(&["link", "set", "lo", "up"]);
        return work();
    }
    if volcomp_fleet::server::program().is_none() {
        return peers::not_run("nats-server");
    }
    let Some(way) = into_namespace() else {
        return peers::not_run(
            "the right to make network namespaces (root, user namespaces or sudo -n), or ip of iproute2,",
        );
    };
    let mut command = Command::new(way[0]);
    command
        .args(&way[1..])
        .arg(std::env::current_exe().expect("this program"))
        .args(["--exact", &format!("fleet::{name}"), "--nocapture"])
        .env(INSIDE, "1");
    let Output { status, stdout, stderr } = command.output().expect("just tried");
    let [out, error] = [stdout, stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    println!("{out}\n{error}");
    assert!(status.success() && out.contains("1 passed"), "{status}");
}

#[test]
fn everything_is_lost() {
    at_site("everything_is_lost", || partition(Lost::Everything));
}

/// Frames to the centre are lost. The site receives, but its messages do not arrive.
#[test]
fn what_goes_to_the_centre_is_lost() {
    at_site("what_goes_to_the_centre_is_lost", || {
        partition(Lost::ToTheCentre);
    });
}

/// Frames to the site are lost. Its messages arrive, but no acknowledgement returns.
#[test]
fn what_goes_to_the_site_is_lost() {
    at_site("what_goes_to_the_site_is_lost", || {
        partition(Lost::ToTheSite);
    });
}

/// During the partition the gateway corrects without a step. Afterwards its messages arrive, each once, and an order
/// given in between is executed.
fn partition(lost: Lost) {
    let network = Network::new();
    let whole = Whole::start_at(network.place(), &[("mill-1", "4711", MACHINE)]);
    let whole = whole.expect("its server is there");
    let dir = tempfile::tempdir().expect("writable");
    let config = whole.member(dir.path(), ("mill-1", "4711"));
    let program = compensating(&config);
    let rollout = whole.roll_out(&machine_text("small", 25.0), &["mill-1"]);
    whole.is_in(rollout, "done");
    corrects_y(&program, -25.0);

    network.cut(lost);
    let cut_s = now_s();
    alone(&whole, &program);
    let cut_s = cut_s..now_s();
    network.heal(lost);
    let state = program.wait_for("disarmed");
    assert!(says(&state, "disabled by the centre"), "{state}");
    wait(&program, "it is ramped out", |_| program.gateway().shifts() == PerChannel::ZERO);
    comes_later(&whole, &program, dir.path(), &cut_s);

    whole.done("machine enable mill-1");
    // An operator disarmed the machine, so an operator must arm it.
    wait(&program, "it may be armed", |state| !says(state, "disabled by the centre"));
    program.must_arm();
    program.wait_for("compensating");
    corrects_y(&program, -25.0);
    no_step(&program.stop());
}

/// Checks the behaviour of gateway and centre during the partition.
fn alone(whole: &Whole, program: &Client) {
    wait(program, "the gateway notices", |state| {
        goes_on(state, -25.0);
        state["fleet"]["connected"] == false
    });
    whole.wait("the centre notices", "alarms --json", |alarms| {
        let mut alarms = alarms.as_array().expect("a list").iter();
        alarms.any(|alarm| alarm["kind"] == "silent" && alarm["machine"] == "mill-1")
    });
    // One audit record and one order arise during the partition.
    assert_eq!(program.post("/api/disarm", "").status, 200);
    program.wait_for("disarmed");
    program.must_arm();
    program.wait_for("compensating");
    corrects_y(program, -25.0);
    whole.done("machine disable mill-1");
    let before = program.state()["uptime_s"].as_f64().expect("a time");
    wait(program, "it goes on for some seconds", |state| {
        goes_on(state, -25.0);
        assert_eq!(state["fleet"]["version"], 1, "{state}");
        state["uptime_s"].as_f64() > Some(before + 4.0)
    });
    let cookie = whole.log_in();
    let page = whole.page(&cookie, "/api/machines/mill-1");
    assert_eq!(page["silent"], true, "{page}");
}

/// The present time, s since 1970.
fn now_s() -> f64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).expect("after 1970").as_secs_f64()
}

/// Checks that every message of the partition, from and to the times `cut_s`, arrives afterwards, once.
fn comes_later(whole: &Whole, program: &Client, dir: &std::path::Path, cut_s: &Range<f64>) {
    whole.machine_is("its state is reported", "mill-1", |one| {
        one["enable"] == false && one["live"]["condition"]["state"] == "disarmed"
    });
    let cookie = whole.log_in();
    // Every audit record arrives once.
    until("its audit log is there", LONG, || {
        let page = whole.page(&cookie, "/api/machines/mill-1");
        let records = page["records"].as_array().expect("a list").iter();
        let stored: Vec<String> = records
            .filter_map(|record| record["record"]["body"]["checksum"].as_str())
            .map(str::to_owned)
            .collect();
        let once: BTreeSet<&String> = stored.iter().collect();
        assert_eq!(once.len(), stored.len(), "twice: {stored:?}");
        let log = std::fs::read_to_string(dir.join("audit/audit.log")).expect("a log");
        log.lines().all(|line| {
            let checksum = line.split(' ').next().expect("a word");
            stored.iter().any(|one| one == checksum)
        })
    });
    // Conditions are made once per second, even during the partition, which lasts until the centre has noticed it, 15 s or longer.
    until("its conditions are there", LONG, || {
        let history = "/api/machines/mill-1/history?resolution=raw&hours=1";
        let history = whole.page(&cookie, history);
        let points = history["points"].as_array().expect("a list");
        let times = points.iter().filter_map(|point| point["at_s"].as_f64());
        times.filter(|at_s| cut_s.contains(at_s)).count() > 5
    });
    let one = whole.machine("mill-1");
    assert_eq!(one["live"]["lost"], 0, "{one}");
    assert_eq!(program.state()["fleet"]["dropped"], 0);
    let alarms = whole.document("alarms --all --json");
    let alarms = alarms.as_array().expect("a list");
    let has = |kind: &str| alarms.iter().any(|alarm: &Value| alarm["kind"] == kind);
    assert!(!has("gap") && !has("clone") && !has("unreadable"), "{alarms:?}");
}
