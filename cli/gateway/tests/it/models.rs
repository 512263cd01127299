//! New models over HTTP: upload, confirmation, activation through the ramp without a step, reverting.
//!
//! A file that is not a model of this machine is rejected, and so is an upload by a user without the required role.
//! Uploaded files are limited in size, and only in memory until activation.

use std::{
    io::{Read, Write},
    path::{Path, PathBuf},
    process::Command,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use serde_json::{Value, json};

use crate::{
    interop::validate,
    manual::{Served, control, controlled_configuration, served_configuration},
    program::{
        Answer, Client, MACHINE, OPERATE, PATIENCE, Program, VIEW, answer, change, exchange_over,
        path,
    },
};

pub(crate) const ENGINEER: &str = "00112233445566778899aabbccddeeff";

const OTHER_ENGINEER: &str = "ffeeddccbbaa99887766554433221100";

/// A gateway whose Y is corrected by -20 µm, and an engineer.
struct Rig {
    dir: tempfile::TempDir,
    config: PathBuf,
}

impl Rig {
    fn new(more: &str) -> Self {
        let dir = tempfile::tempdir().expect("writable");
        let config = served_configuration(dir.path(), more);
        engineers(dir.path());
        Self { dir, config }
    }

    fn start(&self) -> Served {
        Served::start(&self.config)
    }

    fn standing(&self) -> Value {
        let file = self.dir.path().join("audit/models/standing.json");
        let text = std::fs::read_to_string(file).expect("written");
        serde_json::from_str(&text).expect("whole")
    }
}

pub(crate) fn engineers(dir: &Path) {
    let file = dir.join("tokens");
    let text = std::fs::read_to_string(&file).expect("there");
    let more = format!("erna engineer {ENGINEER}\nemil engineer {OTHER_ENGINEER}\n");
    std::fs::write(file, text + &more).expect("writable");
}

pub(crate) fn post(program: &Client, what: &str, body: &Value) -> Answer {
    let path = format!("/api/model/{what}");
    program.request("POST", &path, Some(ENGINEER), &body.to_string())
}

fn upload_as(program: &Client, token: &str, query: &str, bytes: &[u8]) -> Answer {
    let mut request = format!(
        "POST /api/model/upload?{query} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {token}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        program.address,
        bytes.len()
    )
    .into_bytes();
    request.extend_from_slice(bytes);
    answer(&program.raw(&request))
}

pub(crate) fn upload(program: &Client, query: &str, bytes: &[u8]) -> Answer {
    upload_as(program, ENGINEER, query, bytes)
}

pub(crate) fn model(program: &Client) -> Value {
    program.get("/api/model").json()
}

pub(crate) fn candidate(program: &Client) -> Value {
    program.get("/api/model/candidate").json()
}

/// Waits until the candidate has been processed.
fn settled(program: &Client) -> Value {
    let end = Instant::now() + Duration::from_secs(60);
    loop {
        let now = candidate(program);
        if now["step"] != "working" {
            return now;
        }
        assert!(Instant::now() < end, "{now}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

pub(crate) fn machine_file(program: &Client, text: &str) -> Value {
    let sent = upload(program, "kind=machine&name=m.toml", text.as_bytes());
    assert_eq!(sent.status, 200, "{}", sent.body);
    settled(program)
}

pub(crate) fn activate(program: &Client, candidate: &Value, confirm: Option<&Value>) -> Answer {
    post(program, "activate", &activation(candidate, confirm))
}

/// The body of the request that activates a candidate.
fn activation(candidate: &Value, confirm: Option<&Value>) -> Value {
    // A candidate without a result has no hash.
    let hash = candidate["result"]["hash"].as_str().unwrap_or("none");
    let mut body = json!({ "candidate": candidate["id"], "hash": hash });
    if let Some(hash) = confirm {
        body["confirm"] = hash.clone();
    }
    body
}

fn y(program: &Client, um: f64) {
    program
        .wait(|state| state["correction_um"]["Y"] == um)
        .unwrap_or_else(|state| panic!("Y is not {um}: {state}\n{}", program.log()));
}

pub(crate) fn with_y(um: f64) -> String {
    MACHINE.replace("EYX = 20.0", &format!("EYX = {um:?}"))
}

pub(crate) fn wait_model(program: &Client, done: impl Fn(&Value) -> bool) -> Value {
    let end = Instant::now() + PATIENCE;
    loop {
        let now = model(program);
        if done(&now) {
            return now;
        }
        assert!(Instant::now() < end, "{now}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

pub(crate) fn examples() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../examples/calibration")
}

/// A truncated upload leaves no candidate. A file name with a path is reduced to its last part.
#[test]
fn a_file_is_taken_whole_under_a_plain_name() {
    let rig = Rig::new("");
    let program = rig.start();
    let mut stream = program.connect();
    let head = format!(
        "POST /api/model/upload?kind=machine&name=cut.toml HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: 1000\r\n\r\nhalf",
        program.address
    );
    stream.write_all(head.as_bytes()).expect("it listens");
    stream.shutdown(std::net::Shutdown::Write).expect("ours");
    let mut rest = String::new();
    let _ = stream.read_to_string(&mut rest);
    assert_eq!(program.get("/api/model/candidate").status, 404);
    let text = with_y(21.0);
    for nameless in ["..", "%2F", ""] {
        let query = format!("kind=machine&name={nameless}");
        assert_eq!(upload(&program, &query, text.as_bytes()).status, 400);
    }
    let query = "kind=machine&name=..%2F..%2F%3Cscript%3E.toml";
    let sent = upload(&program, query, text.as_bytes());
    assert_eq!(sent.status, 200, "{}", sent.body);
    assert_eq!(sent.json()["file"]["name"], "_script_.toml");
    let everything = candidate(&program).to_string();
    assert!(!everything.contains(path(rig.dir.path())), "no path of this computer: {everything}");
}

/// On a full disk (a small file system) an activation fails with status 507. The space reserved for the audit log stays
/// reserved.
#[test]
fn a_full_disk_refuses_a_model_and_keeps_the_log() {
    let rig = Rig::new("");
    let folder = rig.dir.path().join("audit");
    std::fs::create_dir_all(&folder).expect("writable");
    let mounted =
        Command::new("mount").args(["-t", "tmpfs", "-o", "size=8m", "tmpfs"]).arg(&folder).status();
    if !mounted.is_ok_and(|status| status.success()) {
        volcomp_test_support::peers::not_run("the right to mount");
        return;
    }
    let program = rig.start();
    let before = model(&program)["hash"].clone();
    // The free space is less than the audit log needs from the start.
    let made = machine_file(&program, &with_y(21.0));
    let refused = activate(&program, &made, None);
    let after = model(&program)["hash"].clone();
    program.must_arm();
    drop(program);
    // An error of `umount` cannot be handled here.
    let _ = Command::new("umount").arg("-l").arg(&folder).status();
    assert_eq!(refused.status, 507, "{}", refused.body);
    assert!(refused.body.contains("full"), "{}", refused.body);
    assert_eq!(before, after);
}

/// Four silent clients occupy the upload slots. When they time out, a fifth client is served. Disarming is never
/// delayed.
#[test]
fn silent_clients_do_not_prevent_disarming() {
    let rig = Rig::new("");
    let program = rig.start();
    let begin = |_| {
        let mut stream = program.connect();
        let head = format!(
            "POST /api/model/upload?kind=machine&name=m.toml HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: 8\r\n\r\n1,2\n",
            program.address
        );
        stream.write_all(head.as_bytes()).expect("it listens");
        stream
    };
    let streams: Vec<_> = (0..4).map(begin).collect();
    let text = with_y(21.0);
    let send = |name: &str| {
        let query = format!("kind=machine&name={name}");
        upload(&program, &query, text.as_bytes()).status
    };
    let end = Instant::now() + PATIENCE;
    // An upload without a valid file name creates no candidate, which would disconnect the four clients.
    while send("..") != 503 {
        assert!(Instant::now() < end, "the places are not held");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(program.post("/api/disarm", "").status, 200);
    drop(streams);
    let end = Instant::now() + PATIENCE;
    while send("m.toml") != 200 {
        assert!(Instant::now() < end, "the places are not given back");
        std::thread::sleep(Duration::from_millis(20));
    }
}

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
    let config = controlled_configuration(dir.path(), &control, "");
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
        // The kill may come before the activation, but not before the connection. A small change needs no confirmation.
        let (stream, body) = (program.connect(), activation(&made, None).to_string());
        let text = program.request_text("POST", "/api/model/activate", Some(ENGINEER), &body);
        let asked =
            std::thread::spawn(move || answer(&exchange_over(stream, text.as_bytes())).status);
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
    // The history is damaged, too. Its models stay on disk.
    std::fs::write(folder.join("standing.json"), "garbage").expect("writable");
    let program = program.killed_and_started(&rig.config);
    wait_model(&program, |now| {
        let trouble = now["trouble"].as_str().unwrap_or_default();
        trouble.contains("standing.json") && now["history"][0]["from"] == "file"
    });
    let aside = folder.with_file_name("models.damaged-1");
    let name = file.file_name().expect("a name");
    assert!(aside.join(name).exists() || file.exists());
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

#[test]
fn only_engineers_send_models() {
    let rig = Rig::new("");
    let program = rig.start();
    for (token, status) in [(Some(OPERATE), 403), (Some(VIEW), 403), (None, 401)] {
        for what in ["upload?kind=machine&name=m.toml", "activate", "back", "discard"] {
            let path = format!("/api/model/{what}");
            let refused = program.request("POST", &path, token, "{\"hash\": null}");
            assert_eq!(refused.status, status, "{token:?} {what}: {}", refused.body);
        }
    }
    assert!(model(&program)["candidate"].is_null());
    assert_eq!(program.get("/api/model/candidate").status, 404);
    // An engineer may operate as well.
    let token = program.request("GET", "/api/token", Some(ENGINEER), "").json();
    assert_eq!(token, json!({ "name": "erna", "role": "engineer" }));
    let disarmed = program.request("POST", "/api/disarm", Some(ENGINEER), "");
    assert_eq!(disarmed.status, 200, "{}", disarmed.body);
}

#[test]
fn invalid_and_foreign_models_are_refused() {
    let rig = Rig::new("");
    let program = rig.start();
    let none: [(&[u8], &str); 3] = [
        (b"structure = 7\n", "m.toml:1"),
        (b"\xff\xfe\x00rubbish", "invalid byte"),
        (b"", "structure"),
    ];
    for (bytes, says) in none {
        let sent = upload(&program, "kind=machine&name=m.toml", bytes);
        assert_eq!(sent.status, 200, "{}", sent.body);
        let made = settled(&program);
        let error = made["error"].as_str().expect("a reason");
        assert!(error.contains(says), "{error}");
        assert!(made["result"].is_null());
        assert_eq!(activate(&program, &made, None).status, 409);
        assert_eq!(post(&program, "discard", &json!({ "candidate": made["id"] })).status, 200);
    }
    // A model with the axes of another machine.
    let axes = MACHINE
        .replace("w X' b Y Z t", "w X' b Y t")
        .replace("[axes.Z]\ntravel = [0.0, 250.0]\n", "");
    let made = machine_file(&program, &axes);
    let why = made["result"]["refusal"].as_str().expect("a reason");
    assert!(why.contains("X and Y, the active model has X, Y and Z"), "{why}");
    let refused = activate(&program, &made, None);
    assert_eq!(refused.status, 422, "{}", refused.body);
    assert_eq!(refused.json()["error"], why);
    let newest = wait_model(&program, |now| now["history"][0]["outcome"] == "refused");
    assert!(newest["history"][0]["why"].as_str().expect("a reason").len() > 10);
    assert_eq!(newest["from"], "file");
    post(&program, "discard", &json!({ "candidate": made["id"] }));
    // Another structure is reported. It needs a confirmation if an axis moves.
    let made = machine_file(&program, &with_y(90.0).replace("w X' b Y Z t", "w X' Y' b Z t"));
    let warnings = made["result"]["warnings"].to_string();
    assert!(warnings.contains("The structure is"), "{warnings}");
    assert_eq!(activate(&program, &made, None).status, 409);
}

/// The machine file of another machine needs a confirmation, even if its correction hardly differs.
#[test]
fn a_model_of_another_machine_needs_confirmation() {
    let rig = Rig::new("");
    let program = rig.start();
    let other = with_y(21.0).replace("travel = [0.0, 250.0]", "travel = [0.0, 800.0]");
    let other = format!("name = \"gantry-8000\"\n{}", without_name(&other));
    let made = machine_file(&program, &other);
    assert!(made["result"]["refusal"].is_null(), "{made}");
    let said = made["result"]["warnings"].as_array().expect("a list");
    assert!(said[0].as_str().expect("a text").contains("“gantry-8000”"));
    let travels = "Z travels from 0 to 800 mm in this model, from 0 to 250 mm";
    assert!(said[1].as_str().expect("a text").contains(travels));
    let asked = activate(&program, &made, None);
    assert_eq!(asked.status, 409, "{}", asked.body);
    let asked = asked.json();
    validate("gateway-answer.json", &asked);
    assert_eq!(asked["model"], made["result"]["hash"]);
    assert_eq!(asked["differences"].as_array().expect("a list").len(), 2);
    let taken = activate(&program, &made, Some(&asked["model"]));
    assert_eq!(taken.status, 200, "{}", taken.body);
    // Reverting needs the same confirmation. Arming needs no second one.
    let back = post(&program, "back", &json!({ "hash": null }));
    assert_eq!(back.status, 409, "{}", back.body);
    assert!(back.body.contains("gantry-8000"), "{}", back.body);
    program.must_arm();
}

fn without_name(machine: &str) -> String {
    let lines = machine.lines().filter(|line| !line.starts_with("name"));
    lines.collect::<Vec<_>>().join("\n")
}

/// While one engineer has a candidate, the upload of a second engineer gets status 409 with the name of the first.
/// Requests for a discarded candidate fail.
#[test]
fn two_engineers_do_not_mix_their_files() {
    let rig = Rig::new("");
    let program = rig.start();
    let text = with_y(21.0);
    let first = upload(&program, "kind=machine&name=first.toml", text.as_bytes());
    assert_eq!(first.status, 200, "{}", first.body);
    let id = first.json()["id"].as_str().expect("named").to_owned();
    let query = "kind=machine&name=second.toml";
    let second = upload_as(&program, OTHER_ENGINEER, query, text.as_bytes());
    assert_eq!(second.status, 409, "{}", second.body);
    assert!(second.body.contains("erna"), "{}", second.body);
    assert_eq!(settled(&program)["file"]["name"], "first.toml");
    // A measurement file, another kind of file, and no file name.
    for (query, says) in [
        ("kind=measurement&name=exx.csv", "volcomp studio"),
        ("kind=rubbish&name=a.csv", "expected kind=machine"),
        ("kind=machine", "&name=NAME"),
    ] {
        let refused = upload(&program, query, b"0,0\n");
        assert_eq!(refused.status, 400, "{query}: {}", refused.body);
        assert!(refused.body.contains(says), "{query}: {}", refused.body);
    }
    let discard = json!({ "candidate": id }).to_string();
    let discarded = || {
        let request = |token| program.request("POST", "/api/model/discard", Some(token), &discard);
        request(OTHER_ENGINEER).status
    };
    assert_eq!(discarded(), 200);
    assert_eq!(discarded(), 409);
    assert_eq!(activate(&program, &json!({ "id": id }), None).status, 409);
}

/// A comparison cannot be aborted. Even with discarded candidates only one comparison runs at a time, and the next
/// upload gets status 503.
#[test]
fn one_comparison_at_a_time_also_of_discarded_files() {
    let rig = Rig::new("");
    let program = rig.start();
    let nodes: Vec<String> =
        (0..800).map(|k| format!("[{}, {}.0]", 0.5 * f64::from(k), k % 7)).collect();
    let curve = format!("EZX = {{ mls = {{ nodes = [{}] }} }}\n", nodes.join(", "));
    let slow = MACHINE.to_owned() + &curve;
    let query = "kind=machine&name=slow.toml";
    let sent = upload(&program, query, slow.as_bytes());
    assert_eq!(sent.status, 200, "{}", sent.body);
    let discarded = post(&program, "discard", &json!({ "candidate": sent.json()["id"] }));
    assert_eq!(discarded.status, 200, "{}", discarded.body);
    let next = upload(&program, query, MACHINE.as_bytes());
    assert_eq!(next.status, 503, "{}", next.body);
    assert!(next.body.contains("still being compared"), "{}", next.body);
    let end = Instant::now() + Duration::from_secs(120);
    while upload(&program, query, MACHINE.as_bytes()).status == 503 {
        assert!(Instant::now() < end, "it never ends");
        std::thread::sleep(Duration::from_millis(100));
    }
    assert!(settled(&program)["error"].is_null());
}
