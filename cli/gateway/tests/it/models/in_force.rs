//! A complete model is activated without a step, and reverted.

use std::{sync::atomic::Ordering, time::Duration};

use serde_json::{Value, json};

use super::{
    Rig, activate, engineers, machine_file, model, post, settled, upload, wait_model, with_y, y,
};
use crate::{
    controlled::{configuration, control},
    documents::validate,
    program::{Client, Program, change, path},
};

/// Reverts to the previous model, then to the first.
fn goes_back(program: &Client, before: &Value) {
    let history = model(program)["history"].clone();
    let first = &history.as_array().expect("a list").last().expect("one")["hash"];
    for (hash, um) in [(before, -100.0), (first, -20.0)] {
        let asked = post(program, "back", &json!({ "hash": hash })).json();
        let back = json!({ "hash": hash, "confirm": asked["model"] });
        let taken = post(program, "back", &back);
        assert_eq!(taken.status, 200, "{}", taken.body);
        y(program, um);
    }
}

/// A model uploaded during correction is confirmed and ramps in without a step. It persists over a kill and a reload.
/// The configured file becomes active only at an engineer's request.
#[test]
fn a_model_is_confirmed_ramped_in_and_survives_a_kill() {
    let rig = Rig::new("auto_arm = true");
    let program = rig.start();
    y(&program, -20.0);
    let made = machine_file(&program, &with_y(100.0));
    validate("gateway-model-candidate.json", &made);
    assert_eq!(made["step"], "ready", "{made}");
    assert_eq!(program.state()["correction_um"]["Y"], -20.0, "nothing happened");
    // A change of 80 µm needs a confirmation: without a hash or with another hash it is requested.
    program.largest_step_um();
    let asked = activate(&program, &made, None);
    assert_eq!(asked.status, 409, "{}", asked.body);
    let asked = asked.json();
    validate("gateway-answer.json", &asked);
    let worst = asked["worst_corner_um"].as_f64().expect("a number");
    assert!((worst - 80.0).abs() < 0.1, "{worst}");
    let wrong = activate(&program, &made, Some(&json!("sha256:00")));
    assert_eq!(wrong.status, 409, "{}", wrong.body);
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(program.state()["correction_um"]["Y"], -20.0, "nothing happened");
    let taken = activate(&program, &made, Some(&asked["model"]));
    assert_eq!(taken.status, 200, "{}", taken.body);
    // The published state agrees with the response immediately, before the next poll of the disk.
    let at_once = model(&program);
    assert_eq!(at_once["put_in_force"]["who"], "erna", "{at_once}");
    assert_eq!(at_once["history"][0]["outcome"], "in-force", "{at_once}");
    y(&program, -100.0);
    let largest = program.largest_step_um();
    assert!(largest > 0.0 && largest < 20.0, "a step of {largest} µm of 80");
    let state = model(&program);
    validate("gateway-model.json", &state);
    assert_eq!(state["from"], "upload");
    assert_eq!(state["put_in_force"]["who"], "erna");
    assert_eq!(state["hash"], made["result"]["hash"]);
    assert!(state["candidate"].is_null(), "{state}");
    let newest = &state["history"][0];
    assert_eq!(
        (&newest["who"], &newest["outcome"], &newest["from"]),
        (&json!("erna"), &json!("in-force"), &json!("upload"))
    );
    assert!((newest["worst_um"].as_f64().expect("known") - 80.0).abs() < 0.1);
    assert_eq!(state["history"][1]["outcome"], "must-be-confirmed");
    let audit = std::fs::read_to_string(rig.dir.path().join("audit/audit.log")).expect("a log");
    assert!(audit.contains("\"who\":\"erna\",\"what\":\"model\""), "{audit}");
    // The activation was on disk before the response, so it survives a kill.
    let program = program.killed_and_started(&rig.config);
    assert_eq!(rig.standing()["in_force"]["hash"], made["result"]["hash"]);
    let state = model(&program);
    assert_eq!(state["hash"], made["result"]["hash"]);
    y(&program, -100.0);
    // A reload reports that the changed configured file is not used.
    change(&rig.dir.path().join("machine.toml"), "EYX = 20.0", "EYX = 25.0");
    let reloaded = program.post("/api/reload", "");
    assert_eq!(reloaded.status, 200, "{}", reloaded.body);
    assert_eq!(reloaded.json()["unchanged"], true);
    assert!(reloaded.body.contains("was not read"), "{}", reloaded.body);
    let state = wait_model(&program, |now| now["configured"]["differs"] == true);
    assert_eq!(state["hash"], made["result"]["hash"]);
    // An engineer reverts to the configured file. The change of 75 µm has the same confirmation and ramp.
    program.largest_step_um();
    let asked = post(&program, "back", &json!({ "hash": null }));
    assert_eq!(asked.status, 409, "{}", asked.body);
    let back = json!({ "hash": null, "confirm": asked.json()["model"] });
    let taken = post(&program, "back", &back);
    assert_eq!(taken.status, 200, "{}", taken.body);
    y(&program, -25.0);
    let largest = program.largest_step_um();
    assert!(largest > 0.0 && largest < 20.0, "a step of {largest} µm of 75");
    let state = model(&program);
    assert_eq!(state["from"], "file", "{state}");
    assert!(rig.standing()["in_force"].is_null());
    goes_back(&program, &made["result"]["hash"]);
    let nobody = post(&program, "back", &json!({ "hash": "sha256:../../x" }));
    assert_eq!(nobody.status, 404, "{}", nobody.body);
}

/// If the gateway is killed at any moment of an activation, the old or the new model is active and complete after the
/// restart. It is the new model if the activation had been answered. An upload of the maximum size stays within 512 MiB
/// of memory.
#[test]
fn a_kill_at_any_moment_leaves_one_of_the_two_models() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "");
    engineers(dir.path());
    let start = || Program::start(dir.path(), &["--config", path(&config)]);
    let mut program = start();
    let mut answered = 0;
    // An activation takes about 10 ms on an idle computer.
    for (round, delay_ms) in [0, 4, 10, 20, 40, 80, 160, 1500].into_iter().enumerate() {
        let before = model(&program)["hash"].clone();
        let um = 20.5 + f64::from(u8::try_from(round).expect("few"));
        let made = machine_file(&program, &with_y(um));
        assert_eq!(made["step"], "ready", "{made}");
        let after = made["result"]["hash"].clone();
        let client = program.clone();
        // The kill may come before the activation. A small change needs no confirmation.
        let asked = std::thread::spawn(move || activate(&client, &made, None).status);
        std::thread::sleep(Duration::from_millis(delay_ms));
        program.signal("KILL");
        program.end();
        let status = asked.join().expect("no panic");
        answered += u32::from(status == 200);
        program = start();
        let now = model(&program);
        assert!(now["hash"] == before || now["hash"] == after, "{now}");
        assert!(now["trouble"].is_null(), "{now}");
        if status == 200 {
            assert_eq!(now["hash"], after, "round {round}: the answer had come");
        }
    }
    println!("{answered} of 8 were answered before the kill");
    assert!(answered > 0, "none was ever activated");
    // Either model can be armed.
    program.must_arm();
    no_upload_is_too_large(&program);
}

/// Parsing a broken machine file needs fifty times its size in memory. Without the limit one upload could end the
/// process that corrects.
fn no_upload_is_too_large(program: &Program) {
    let most = 4 * 1024 * 1024;
    let query = "kind=machine&name=m.toml";
    let refused = upload(program, query, &vec![b'['; most + 1]);
    assert_eq!(refused.status, 413, "{}", refused.body);
    let sent = upload(program, query, &vec![b'['; most]);
    assert_eq!(sent.status, 200, "{}", sent.body);
    assert!(settled(program)["error"].is_string());
    let status = std::fs::read_to_string(format!("/proc/{}/status", program.running.id()));
    let status = status.expect("it runs");
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let peak = peak.and_then(|peak| peak.trim().strip_suffix(" kB")?.parse().ok());
    let peak: u32 = peak.expect("a number");
    println!("4 MiB of brackets: at most {} MiB", peak / 1024);
    assert!(peak < 512 * 1024, "{peak} kB");
}

#[test]
fn a_fault_on_the_ramp_makes_no_step() {
    let rig = Rig::new("auto_arm = true");
    // The ramp is long enough for an alarm in the middle of it.
    change(&rig.config, "ramp_s = 0.1", "ramp_s = 5");
    let program = rig.start();
    y(&program, -20.0);
    let made = machine_file(&program, &with_y(100.0));
    let asked = activate(&program, &made, None).json();
    program.largest_step_um();
    assert_eq!(activate(&program, &made, Some(&asked["model"])).status, 200);
    let alarm = |is_on| {
        let switch = &program.gateway().rig.controls.alarm;
        switch.store(is_on, Ordering::Relaxed);
    };
    alarm(true);
    program
        .wait(|state| state["reasons"].to_string().contains("alarm"))
        .unwrap_or_else(|state| panic!("it sees no alarm: {state}"));
    let largest = program.largest_step_um();
    assert!(largest < 20.0, "a step of {largest} µm");
    alarm(false);
    y(&program, -100.0);
    let largest = program.largest_step_um();
    assert!(largest > 0.0 && largest < 20.0, "a step of {largest} µm");
}

/// The stored file of the active model is damaged. The gateway uses the configured file and reports the damage. Arming
/// compares with the model that was armed last.
#[test]
fn a_damaged_model_is_not_loaded() {
    let rig = Rig::new("");
    let program = rig.start();
    let made = machine_file(&program, &with_y(25.0));
    assert_eq!(activate(&program, &made, None).status, 200);
    let folder = rig.dir.path().join("audit/models");
    let hash = made["result"]["hash"].as_str().expect("a hash").replace("sha256:", "");
    let file = folder.join(format!("machine-{hash}.toml"));
    change(&file, "25.0", "26.0");
    let program = program.killed_and_started(&rig.config);
    let now = model(&program);
    assert_eq!(now["from"], "file", "{now}");
    // The page reports the damage continuously.
    let is_told = |now: &Value| {
        let trouble = now["trouble"].as_str().unwrap_or_default();
        trouble.contains(&hash) && trouble.contains("was not loaded")
    };
    let now = wait_model(&program, |now| is_told(now) && now["history"][0]["from"] == "file");
    assert!(now["put_in_force"].is_null(), "{now}");
    std::thread::sleep(Duration::from_secs(3));
    let now = model(&program);
    assert!(is_told(&now), "{now}");
    // An engineer reverts to the configured model.
    let taken = post(&program, "back", &json!({ "hash": null }));
    assert_eq!(taken.status, 200, "{}", taken.body);
    let now = wait_model(&program, |now| now["trouble"].is_null());
    assert_eq!(now["from"], "file", "{now}");
}

/// An activation needs the hash of the displayed result. With another hash or none it is rejected.
#[test]
fn only_the_displayed_result_is_activated() {
    let rig = Rig::new("");
    let program = rig.start();
    let before = model(&program)["hash"].clone();
    let made = machine_file(&program, &with_y(21.0));
    let other = json!({ "candidate": made["id"], "hash": before });
    let refused = post(&program, "activate", &other);
    assert_eq!(refused.status, 409, "{}", refused.body);
    let hash = made["result"]["hash"].as_str().expect("a hash");
    assert!(refused.body.contains(hash), "{}", refused.body);
    // The rejection offers nothing to confirm.
    assert!(refused.json()["model"].is_null(), "{}", refused.body);
    let none = post(&program, "activate", &json!({ "candidate": made["id"] }));
    assert_eq!(none.status, 400, "{}", none.body);
    assert_eq!(model(&program)["hash"], before);
    assert_eq!(activate(&program, &made, None).status, 200);
    assert_eq!(model(&program)["hash"], hash);
}

/// An active model whose file cannot be stored is reported until it is stored. Other history entries do not clear the
/// message.
#[test]
fn a_model_that_cannot_be_kept_is_reported_until_it_is() {
    let rig = Rig::new("");
    let program = rig.start();
    let machine = rig.dir.path().join("machine.toml");
    let text = std::fs::read_to_string(&machine).expect("there");
    let other = text.replace("EYX = 20.0", "EYX = 21.0");
    assert_ne!(text, other);
    let hash = volcomp_model::Machine::parse(&other, "machine.toml").expect("right").checksum();
    let digits = hash.strip_prefix("sha256:").expect("a hash");
    let kept = rig.dir.path().join("audit/models");
    // A folder in place of the temporary file makes storing fail.
    let stands_in = kept.join(format!("machine-{digits}.new"));
    std::fs::create_dir_all(&stands_in).expect("writable");
    std::fs::write(&machine, other).expect("writable");
    let reloaded = program.post("/api/reload", "");
    assert_eq!(reloaded.status, 200, "{}", reloaded.body);
    let is_told = |now: &Value| {
        let trouble = now["trouble"].as_str().unwrap_or_default();
        trouble.contains("cannot be kept on disk")
    };
    wait_model(&program, is_told);
    std::thread::sleep(Duration::from_secs(3));
    let now = model(&program);
    assert!(is_told(&now), "{now}");
    std::fs::remove_dir(&stands_in).expect("empty");
    wait_model(&program, |now| now["trouble"].is_null());
    assert!(kept.join(format!("machine-{digits}.toml")).is_file());
}
