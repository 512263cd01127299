//! New models over HTTP: uploaded, confirmed, in force through the ramp, gone back from; and what is refused.

use std::{
    io::{Read, Write},
    path::{Path, PathBuf},
    process::Command,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use volcomp_focas::simulator::Simulator;

use crate::{
    controlled::{configuration, control},
    documents::validate,
    program::{Answer, MACHINE, OPERATE, Program, VIEW, answer, change, path},
};

pub(crate) const ENGINEER: &str = "00112233445566778899aabbccddeeff";
const OTHER_ENGINEER: &str = "ffeeddccbbaa99887766554433221100";

/// A gateway whose machine stands at the middle of X, where only Y is corrected, and an engineer.
struct Rig {
    dir: tempfile::TempDir,
    control: Simulator,
    config: PathBuf,
}

impl Rig {
    fn new(more: &str) -> Self {
        let dir = tempfile::tempdir().expect("writable");
        let control = control();
        let config = configuration(dir.path(), &control, more);
        engineers(dir.path());
        Self {
            dir,
            control,
            config,
        }
    }

    fn start(&self) -> Program {
        Program::start(self.dir.path(), &["--config", path(&self.config)])
    }

    fn standing(&self) -> Value {
        let file = self.dir.path().join("audit/models/standing.json");
        let text = std::fs::read_to_string(file).expect("written");
        serde_json::from_str(&text).expect("whole")
    }

    /// From now on the largest change of Y between two scans of the control, µm.
    fn largest_step(&self) -> Arc<Mutex<f64>> {
        let largest = Arc::new(Mutex::new(0.0_f64));
        let told = Arc::clone(&largest);
        let mut before: Option<i64> = None;
        let mut world = self.control.world();
        let count_um = world.shift.count * 1e3;
        world.scan_log = Some(Box::new(move |scan| {
            let now = scan.shifts[1];
            if let Some(before) = before {
                #[expect(clippy::cast_precision_loss, reason = "some hundreds")]
                let step = (now - before).abs() as f64 * count_um;
                let mut largest = told.lock().expect("no panic");
                *largest = largest.max(step);
            }
            before = Some(now);
        }));
        largest
    }
}

/// Adds two engineers to the token file of a folder.
pub(crate) fn engineers(dir: &Path) {
    let file = dir.join("tokens");
    let text = std::fs::read_to_string(&file).expect("there");
    let more = format!("erna engineer {ENGINEER}\nemil engineer {OTHER_ENGINEER}\n");
    std::fs::write(file, text + &more).expect("writable");
}

pub(crate) fn post(program: &Program, what: &str, body: &Value) -> Answer {
    let path = format!("/api/model/{what}");
    program.request("POST", &path, Some(ENGINEER), &body.to_string())
}

fn upload_as(program: &Program, token: &str, query: &str, bytes: &[u8]) -> Answer {
    let mut request = format!(
        "POST /api/model/upload?{query} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {token}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        program.address,
        bytes.len()
    )
    .into_bytes();
    request.extend_from_slice(bytes);
    answer(&program.raw(&request))
}

pub(crate) fn upload(program: &Program, query: &str, bytes: &[u8]) -> Answer {
    upload_as(program, ENGINEER, query, bytes)
}

pub(crate) fn model(program: &Program) -> Value {
    program.get("/api/model").json()
}

pub(crate) fn candidate(program: &Program) -> Value {
    program.get("/api/model/candidate").json()
}

/// Waits until nothing works at the candidate any more.
fn settled(program: &Program) -> Value {
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

/// Uploads a machine file: its candidate.
pub(crate) fn machine_file(program: &Program, text: &str) -> Value {
    let sent = upload(program, "kind=machine&name=m.toml", text.as_bytes());
    assert_eq!(sent.status, 200, "{}", sent.body);
    settled(program)
}

pub(crate) fn activate(program: &Program, candidate: &Value, confirm: Option<&Value>) -> Answer {
    // One without a result has no hash.
    let hash = candidate["result"]["hash"].as_str().unwrap_or("none");
    let mut body = json!({ "candidate": candidate["id"], "hash": hash });
    if let Some(hash) = confirm {
        body["confirm"] = hash.clone();
    }
    post(program, "activate", &body)
}

fn y(program: &Program, um: f64) {
    program
        .wait(|state| state["correction_um"]["Y"] == um)
        .unwrap_or_else(|state| panic!("Y is not {um}: {state}\n{}", program.log()));
}

pub(crate) fn with_y(um: f64) -> String {
    MACHINE.replace("EYX = 20.0", &format!("EYX = {um:?}"))
}

/// Waits until the desk has taken something over.
pub(crate) fn wait_model(program: &Program, done: impl Fn(&Value) -> bool) -> Value {
    let end = Instant::now() + Duration::from_secs(20);
    loop {
        let now = model(program);
        if done(&now) {
            return now;
        }
        assert!(Instant::now() < end, "{now}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Back to the model before, and to the first of all.
fn goes_back(program: &Program, before: &Value) {
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

/// Uploaded while it corrects; asked about; confirmed; through the ramp without a step; outlives a kill; a reload leaves it; the
/// configured file is taken back only when a person says so.
#[test]
fn a_model_goes_into_force_through_question_and_ramp_and_outlives_a_kill() {
    let rig = Rig::new("auto_arm = true");
    let mut program = rig.start();
    y(&program, -20.0);
    let made = machine_file(&program, &with_y(100.0));
    validate("gateway-model-candidate.json", &made);
    assert_eq!(made["step"], "ready", "{made}");
    assert_eq!(
        program.state()["correction_um"]["Y"],
        -20.0,
        "nothing happened"
    );
    // 80 µm: without the hash, and with another one, it is asked.
    let step = rig.largest_step();
    let asked = activate(&program, &made, None);
    assert_eq!(asked.status, 409, "{}", asked.body);
    let asked = asked.json();
    validate("gateway-answer.json", &asked);
    let worst = asked["worst_corner_um"].as_f64().expect("a number");
    assert!((worst - 80.0).abs() < 0.1, "{worst}");
    let wrong = activate(&program, &made, Some(&json!("sha256:00")));
    assert_eq!(wrong.status, 409, "{}", wrong.body);
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(
        program.state()["correction_um"]["Y"],
        -20.0,
        "nothing happened"
    );
    let taken = activate(&program, &made, Some(&asked["model"]));
    assert_eq!(taken.status, 200, "{}", taken.body);
    // What the answer says stands at once, not only when the disk was looked at again.
    let at_once = model(&program);
    assert_eq!(at_once["put_in_force"]["who"], "erna", "{at_once}");
    assert_eq!(at_once["history"][0]["outcome"], "in-force", "{at_once}");
    y(&program, -100.0);
    let largest = *step.lock().expect("no panic");
    assert!(
        largest > 0.0 && largest < 20.0,
        "a step of {largest} µm of 80"
    );
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
    assert!(
        audit.contains("\"who\":\"erna\",\"what\":\"model\""),
        "{audit}"
    );
    // What the answer says is on disk.
    program.signal("KILL");
    program.end();
    assert_eq!(rig.standing()["in_force"]["hash"], made["result"]["hash"]);
    let program = rig.start();
    let state = model(&program);
    assert_eq!(state["hash"], made["result"]["hash"]);
    y(&program, -100.0);
    // The configured file changes: a reload says that it is not used.
    change(
        &rig.dir.path().join("machine.toml"),
        "EYX = 20.0",
        "EYX = 25.0",
    );
    let reloaded = program.post("/api/reload", "");
    assert_eq!(reloaded.status, 200, "{}", reloaded.body);
    assert_eq!(reloaded.json()["unchanged"], true);
    assert!(reloaded.body.contains("was not read"), "{}", reloaded.body);
    let state = wait_model(&program, |now| now["configured"]["differs"] == true);
    assert_eq!(state["hash"], made["result"]["hash"]);
    // A person goes back to it: 75 µm, by the same question and the same ramp.
    let step = rig.largest_step();
    let asked = post(&program, "back", &json!({ "hash": null }));
    assert_eq!(asked.status, 409, "{}", asked.body);
    let back = json!({ "hash": null, "confirm": asked.json()["model"] });
    let taken = post(&program, "back", &back);
    assert_eq!(taken.status, 200, "{}", taken.body);
    y(&program, -25.0);
    let largest = *step.lock().expect("no panic");
    assert!(
        largest > 0.0 && largest < 20.0,
        "a step of {largest} µm of 75"
    );
    let state = model(&program);
    assert_eq!(state["from"], "file", "{state}");
    assert!(rig.standing()["in_force"].is_null());
    goes_back(&program, &made["result"]["hash"]);
    let nobody = post(&program, "back", &json!({ "hash": "sha256:../../x" }));
    assert_eq!(nobody.status, 404, "{}", nobody.body);
}

#[test]
fn who_is_no_engineer_brings_no_model() {
    let rig = Rig::new("");
    let program = rig.start();
    for (token, status) in [(Some(OPERATE), 403), (Some(VIEW), 403), (None, 401)] {
        for what in [
            "upload?kind=machine&name=m.toml",
            "draft",
            "answers",
            "activate",
            "back",
            "discard",
            "take-off",
        ] {
            let path = format!("/api/model/{what}");
            let refused = program.request("POST", &path, token, "{\"hash\": null}");
            assert_eq!(refused.status, status, "{token:?} {what}: {}", refused.body);
        }
    }
    assert!(model(&program)["candidate"].is_null());
    assert_eq!(program.get("/api/model/candidate").status, 404);
    // An engineer may operate, too.
    let token = program
        .request("GET", "/api/token", Some(ENGINEER), "")
        .json();
    assert_eq!(token, json!({ "name": "erna", "role": "engineer" }));
    let disarmed = program.request("POST", "/api/disarm", Some(ENGINEER), "");
    assert_eq!(disarmed.status, 200, "{}", disarmed.body);
}

#[test]
fn what_is_no_model_of_this_machine_is_refused() {
    let rig = Rig::new("");
    let program = rig.start();
    let none: [(&[u8], &str); 3] = [
        (b"structure = 7\n", "m.toml:1"),
        (b"\xff\xfe\x00rubbish", "no text"),
        (b"", "structure"),
    ];
    for (bytes, says) in none {
        let sent = upload(&program, "kind=machine&name=m.toml", bytes);
        assert_eq!(sent.status, 200, "{}", sent.body);
        let made = settled(&program);
        let error = made["error"].as_str().expect("told");
        assert!(error.contains(says), "{error}");
        assert!(made["result"].is_null());
        assert_eq!(activate(&program, &made, None).status, 409);
        assert_eq!(
            post(&program, "discard", &json!({ "candidate": made["id"] })).status,
            200
        );
    }
    // Another machine's axes.
    let axes = MACHINE
        .replace("w X' b Y Z t", "w X' b Y t")
        .replace("[axes.Z]\ntravel = [0.0, 250.0]\n", "");
    let made = machine_file(&program, &axes);
    let why = made["result"]["refusal"].as_str().expect("told");
    assert!(
        why.contains("X and Y, the model in force has X, Y and Z"),
        "{why}"
    );
    let refused = activate(&program, &made, None);
    assert_eq!(refused.status, 422, "{}", refused.body);
    assert_eq!(refused.json()["error"], why);
    let newest = wait_model(&program, |now| now["history"][0]["outcome"] == "refused");
    assert!(newest["history"][0]["why"].as_str().expect("told").len() > 10);
    assert_eq!(newest["from"], "file");
    post(&program, "discard", &json!({ "candidate": made["id"] }));
    // Another structure: it is said, and asked where it moves anything.
    let made = machine_file(
        &program,
        &with_y(90.0).replace("w X' b Y Z t", "w X' Y' b Z t"),
    );
    let warnings = made["result"]["warnings"].to_string();
    assert!(warnings.contains("The structure is"), "{warnings}");
    assert_eq!(activate(&program, &made, None).status, 409);
}

/// The machine file of another machine whose correction hardly moves: it went into force with no word.
#[test]
fn a_model_of_another_machine_is_asked_about() {
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
    // The way back is asked about in the same way, and arming no more than once.
    let back = post(&program, "back", &json!({ "hash": null }));
    assert_eq!(back.status, 409, "{}", back.body);
    assert!(back.body.contains("gantry-8000"), "{}", back.body);
    arms(&program);
}

fn without_name(machine: &str) -> String {
    let lines = machine.lines().filter(|line| !line.starts_with("name"));
    lines.collect::<Vec<_>>().join("\n")
}

/// Whoever begins first is told to whoever comes second, and nobody goes on with what is gone.
#[test]
fn two_engineers_do_not_mix_their_files() {
    let rig = Rig::new("");
    let program = rig.start();
    let first = upload(
        &program,
        "kind=measurement&name=exx.csv",
        b"target,deviation\n0,0\n",
    );
    assert_eq!(first.status, 200, "{}", first.body);
    let id = first.json()["id"].as_str().expect("named").to_owned();
    let second = upload_as(
        &program,
        OTHER_ENGINEER,
        "kind=measurement&name=eyx.csv",
        b"0,0\n",
    );
    assert_eq!(second.status, 409, "{}", second.body);
    assert!(second.body.contains("erna"), "{}", second.body);
    let files = candidate(&program)["files"].to_string();
    assert!(
        files.contains("exx.csv") && !files.contains("eyx.csv"),
        "{files}"
    );
    // The same name, another kind, a TOML file, an unknown candidate.
    for (query, status) in [
        (format!("kind=measurement&name=EXX.csv&candidate={id}"), 409),
        (format!("kind=machine&name=m.toml&candidate={id}"), 409),
        (
            format!("kind=measurement&name=calibration.toml&candidate={id}"),
            400,
        ),
        ("kind=measurement&name=a.csv&candidate=00".to_owned(), 409),
        ("kind=rubbish&name=a.csv".to_owned(), 400),
        ("kind=measurement".to_owned(), 400),
    ] {
        let refused = upload(&program, &query, b"0,0\n");
        assert_eq!(refused.status, status, "{query}: {}", refused.body);
    }
    let discard = json!({ "candidate": id }).to_string();
    let gone = program.request("POST", "/api/model/discard", Some(OTHER_ENGINEER), &discard);
    assert_eq!(gone.status, 200, "{}", gone.body);
    let late = upload(
        &program,
        &format!("kind=measurement&name=b.csv&candidate={id}"),
        b"0,0\n",
    );
    assert_eq!(late.status, 409, "{}", late.body);
    assert_eq!(activate(&program, &json!({ "id": id }), None).status, 409);
}

/// Names that lead elsewhere, two hundred files, one that is cut, one that is too large: nothing outside of the folder, nothing
/// half there.
#[test]
fn files_stay_in_their_folder_and_whole() {
    let rig = Rig::new("");
    change(
        &rig.config,
        "[dashboard]\n",
        "[dashboard]\nupload_mib = 1\n",
    );
    let program = rig.start();
    let begun = upload(
        &program,
        "kind=measurement&name=..%2F..%2F..%2Fx.csv",
        b"1,2\n",
    )
    .json();
    let id = begun["id"].as_str().expect("named").to_owned();
    let script = upload(
        &program,
        &format!("kind=measurement&name=%3Cscript%3E.rtl&candidate={id}"),
        b"rubbish",
    );
    assert_eq!(script.status, 200, "{}", script.body);
    let folder = rig
        .dir
        .path()
        .join("audit/models/uploads")
        .join(&id)
        .join("files");
    let names = || -> Vec<String> {
        let entries = std::fs::read_dir(&folder).expect("there");
        let mut names: Vec<String> = entries
            .map(|entry| {
                entry
                    .expect("there")
                    .file_name()
                    .into_string()
                    .expect("UTF-8")
            })
            .collect();
        names.sort();
        names
    };
    // Bytes that are no text.
    let query = format!("kind=measurement&name=%ff%fex.csv&candidate={id}");
    assert_eq!(upload(&program, &query, b"1,2\n").status, 200);
    assert_eq!(names(), ["__x.csv", "_script_.rtl", "x.csv"]);
    // Cut in the middle.
    let mut stream = program.connect();
    let head = format!(
        "POST /api/model/upload?kind=measurement&name=cut.csv&candidate={id} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: 1000\r\n\r\nhalf",
        program.address
    );
    stream.write_all(head.as_bytes()).expect("it listens");
    stream.shutdown(std::net::Shutdown::Write).expect("ours");
    let mut rest = String::new();
    let _ = stream.read_to_string(&mut rest);
    let end = Instant::now() + Duration::from_secs(10);
    while names().len() > 3 {
        assert!(Instant::now() < end, "{:?}", names());
        std::thread::sleep(Duration::from_millis(20));
    }
    // The name is free again.
    let end = Instant::now() + Duration::from_secs(10);
    let query = format!("kind=measurement&name=cut.csv&candidate={id}");
    while upload(&program, &query, b"1,2\n").status != 200 {
        assert!(Instant::now() < end);
        std::thread::sleep(Duration::from_millis(50));
    }
    // Too large, by its length and by what comes.
    let large = vec![b'1'; 1024 * 1024 + 1];
    let refused = upload(
        &program,
        &format!("kind=measurement&name=large.csv&candidate={id}"),
        &large,
    );
    assert_eq!(refused.status, 413, "{}", refused.body);
    assert!(!names().contains(&"large.csv".to_owned()));
    for number in 0..196 {
        let query = format!("kind=measurement&name=f{number}.csv&candidate={id}");
        let sent = upload(&program, &query, b"1,2\n");
        assert_eq!(sent.status, 200, "{number}: {}", sent.body);
    }
    let over = upload(
        &program,
        &format!("kind=measurement&name=over.csv&candidate={id}"),
        b"1,2\n",
    );
    assert_eq!(over.status, 409, "{}", over.body);
    assert!(over.body.contains("200"), "{}", over.body);
    // They are no measurements: told, and nothing else happens.
    assert_eq!(
        post(&program, "draft", &json!({ "candidate": id })).status,
        200
    );
    let made = settled(&program);
    assert!(
        made["error"].is_string() || made["draft"].is_object(),
        "{made}"
    );
    assert!(!rig.dir.path().join("x.csv").exists());
    let everything = candidate(&program).to_string();
    assert!(
        !everything.contains(path(rig.dir.path())),
        "no path of this computer: {everything}"
    );
    post(&program, "discard", &json!({ "candidate": id }));
}

/// It arms, and nobody is asked. On a busy computer the control thread may take longer than an answer waits for.
fn arms(program: &Program) {
    let end = Instant::now() + Duration::from_secs(20);
    loop {
        let armed = program.arm();
        if armed.status == 200 {
            return;
        }
        assert!(!armed.body.contains("worst_corner_um"), "{}", armed.body);
        assert!(Instant::now() < end, "{}\n{}", armed.body, program.log());
        std::thread::sleep(Duration::from_millis(200));
    }
}

/// Killed at any moment of an activation: after the restart it is one of the two models, whole; and the new one where the answer
/// had come.
#[test]
fn a_kill_at_any_moment_leaves_one_of_the_two_models() {
    let rig = Rig::new("");
    let mut answered = 0;
    // The whole takes some ten milliseconds on a computer that has nothing else to do.
    for (round, delay_ms) in [0, 4, 10, 20, 40, 80, 160, 1500].into_iter().enumerate() {
        let mut program = rig.start();
        let before = model(&program)["hash"].clone();
        let um = 20.5 + f64::from(u8::try_from(round).expect("few"));
        let made = machine_file(&program, &with_y(um));
        assert_eq!(made["step"], "ready", "{made}");
        let after = made["result"]["hash"].clone();
        // Small moves need no confirmation.
        let body = json!({ "candidate": made["id"], "hash": after }).to_string();
        let request = format!(
            "POST /api/model/activate HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}",
            program.address,
            body.len()
        );
        let mut stream = program.connect();
        let asked = std::thread::spawn(move || {
            // It may be killed in the middle of it.
            let mut told = Vec::new();
            let _ = stream.write_all(request.as_bytes());
            let _ = stream.read_to_end(&mut told);
            answer(&String::from_utf8_lossy(&told)).status
        });
        std::thread::sleep(Duration::from_millis(delay_ms));
        program.signal("KILL");
        program.end();
        let status = asked.join().expect("no panic");
        answered += u32::from(status == 200);
        let program = rig.start();
        let now = model(&program);
        assert!(now["hash"] == before || now["hash"] == after, "{now}");
        assert!(now["trouble"].is_null(), "{now}");
        if status == 200 {
            assert_eq!(now["hash"], after, "round {round}: the answer had come");
        }
        // Whichever it is: it corrects.
        arms(&program);
    }
    println!("{answered} of 8 were answered before the kill");
    assert!(answered > 0, "none was ever put in force");
}

/// A fault in the middle of the ramp to a new model: no step, and the new model goes on once the fault is over.
#[test]
fn a_fault_on_the_ramp_makes_no_step() {
    let rig = Rig::new("auto_arm = true");
    let program = rig.start();
    y(&program, -20.0);
    let made = machine_file(&program, &with_y(100.0));
    let asked = activate(&program, &made, None).json();
    let step = rig.largest_step();
    assert_eq!(activate(&program, &made, Some(&asked["model"])).status, 200);
    rig.control
        .world()
        .alarms
        .push((7, "on the ramp".to_owned()));
    program
        .wait(|state| state["reasons"].to_string().contains("alarm"))
        .unwrap_or_else(|state| panic!("it sees no alarm: {state}"));
    let largest = *step.lock().expect("no panic");
    assert!(largest < 20.0, "a step of {largest} µm");
    rig.control.world().alarms.clear();
    y(&program, -100.0);
    let largest = *step.lock().expect("no panic");
    assert!(largest > 0.0 && largest < 20.0, "a step of {largest} µm");
}

/// A damaged file of the model in force: the configured one holds, which is told; arming compares with what was armed last.
#[test]
fn a_damaged_model_is_not_loaded() {
    let rig = Rig::new("");
    let mut program = rig.start();
    let made = machine_file(&program, &with_y(25.0));
    assert_eq!(activate(&program, &made, None).status, 200);
    program.signal("TERM");
    program.end();
    let folder = rig.dir.path().join("audit/models");
    let hash = made["result"]["hash"]
        .as_str()
        .expect("a hash")
        .replace("sha256:", "");
    let file = folder.join(format!("machine-{hash}.toml"));
    change(&file, "25.0", "26.0");
    let program = rig.start();
    let now = model(&program);
    assert_eq!(now["from"], "file", "{now}");
    assert!(
        program.log().contains("the configured machine file holds"),
        "{}",
        program.log()
    );
    // The page says so, too, and goes on to.
    let is_told = |now: &Value| {
        let trouble = now["trouble"].as_str().unwrap_or_default();
        trouble.contains(&hash) && trouble.contains("was not loaded")
    };
    let now = wait_model(&program, |now| {
        is_told(now) && now["history"][0]["from"] == "file"
    });
    assert!(now["put_in_force"].is_null(), "{now}");
    std::thread::sleep(Duration::from_secs(3));
    let now = model(&program);
    assert!(is_told(&now), "{now}");
    // Somebody says that the configured one shall hold.
    let taken = post(&program, "back", &json!({ "hash": null }));
    assert_eq!(taken.status, 200, "{}", taken.body);
    let now = wait_model(&program, |now| now["trouble"].is_null());
    assert_eq!(now["from"], "file", "{now}");
}

/// What is put in force is what was looked at: a hash of another result, and none, put nothing in force.
#[test]
fn only_the_result_that_was_looked_at_is_put_in_force() {
    let rig = Rig::new("");
    let program = rig.start();
    let before = model(&program)["hash"].clone();
    let made = machine_file(&program, &with_y(21.0));
    let other = json!({ "candidate": made["id"], "hash": before });
    let refused = post(&program, "activate", &other);
    assert_eq!(refused.status, 409, "{}", refused.body);
    let hash = made["result"]["hash"].as_str().expect("a hash");
    assert!(refused.body.contains(hash), "{}", refused.body);
    // No question that could be confirmed.
    assert!(refused.json()["model"].is_null(), "{}", refused.body);
    let none = post(&program, "activate", &json!({ "candidate": made["id"] }));
    assert_eq!(none.status, 400, "{}", none.body);
    assert_eq!(model(&program)["hash"], before);
    assert_eq!(activate(&program, &made, None).status, 200);
    assert_eq!(model(&program)["hash"], hash);
}

/// The disk is full: the file is refused, and nothing of it stays. A small file system stands for it.
#[test]
fn a_full_disk_refuses_files_and_keeps_the_log() {
    let rig = Rig::new("");
    let folder = rig.dir.path().join("audit");
    std::fs::create_dir_all(&folder).expect("writable");
    let mounted = Command::new("mount")
        .args(["-t", "tmpfs", "-o", "size=8m", "tmpfs"])
        .arg(&folder)
        .status();
    if !mounted.is_ok_and(|status| status.success()) {
        volcomp_test_support::peers::not_run("the right to mount");
        return;
    }
    let program = rig.start();
    // Less than what the audit log needs is free from the start.
    let refused = upload(&program, "kind=measurement&name=a.csv", b"1,2\n");
    arms(&program);
    drop(program);
    // Nothing else can be done where it fails.
    let _ = Command::new("umount").arg("-l").arg(&folder).status();
    assert_eq!(refused.status, 507, "{}", refused.body);
    assert!(refused.body.contains("full"), "{}", refused.body);
}

/// A file that cannot be read is named once, with its reason, and the error that is missing because of it; taken off the list it is
/// gone, and what was made of it, too.
#[test]
fn a_file_that_is_not_used_is_told_with_the_error_that_it_would_have_given() {
    let rig = measured_rig();
    let program = rig.start();
    let id = send_measurements(&program);
    let query = format!("kind=measurement&name=EYZ-Bericht.xlsx&candidate={id}");
    let sent = upload(&program, &query, b"PK rubbish");
    assert_eq!(sent.status, 200, "{}", sent.body);
    post(&program, "draft", &json!({ "candidate": id }));
    let made = settled(&program);
    let left_over = made["draft"]["left_over"][0].as_str().expect("told");
    assert_eq!(left_over.matches("Bericht").count(), 1, "{left_over}");
    assert!(
        left_over.ends_with("; it would have given EYZ"),
        "{left_over}"
    );
    // The unit of the level asks for more, which is answered as well.
    answers(&program, &id, &all_answers(&made));
    let more = settled(&program);
    answers(&program, &id, &all_answers(&more));
    let ready = settled(&program);
    let first = ready["result"]["warnings"][0].as_str().expect("told");
    assert!(
        first.starts_with(
            "EYZ is taken as 0, because its file was not used: files/EYZ-Bericht.xlsx: "
        ),
        "{ready}"
    );
    let off = |name: &str| {
        let body = json!({ "candidate": id, "name": name });
        post(&program, "take-off", &body).status
    };
    assert_eq!(off("../files/exx.csv"), 404);
    assert_eq!(off("EYZ-Bericht.xlsx"), 200);
    let now = settled(&program);
    assert_eq!(now["step"], "uploading", "{now}");
    assert!(now["draft"].is_null() && now["result"].is_null(), "{now}");
    assert_eq!(now["files"].as_array().expect("a list").len(), 5);
    let folder = rig.dir.path().join("audit/models/uploads").join(&id);
    assert!(!folder.join("files/EYZ-Bericht.xlsx").exists());
    post(&program, "draft", &json!({ "candidate": id }));
    let made = settled(&program);
    assert_eq!(made["draft"]["left_over"], json!([]), "{made}");
    for name in ["ebx.csv", "eyx.csv", "exy.csv", "ezx-level.csv"] {
        assert_eq!(off(name), 200);
        settled(&program);
    }
    assert_eq!(off("exx.csv"), 409, "the last one is discarded");
}

/// The example's measurement files to a model: looked through, asked, calibrated, in force. Meanwhile the cycle goes on.
#[test]
fn measurements_become_a_model_and_the_cycle_goes_on() {
    let rig = measured_rig();
    let program = rig.start();
    program.watch();
    let id = send_measurements(&program);
    // Not yet looked through.
    assert_eq!(answers(&program, &id, &[]).status, 409);
    assert_eq!(
        post(&program, "draft", &json!({ "candidate": id })).status,
        200
    );
    let made = settled(&program);
    validate("gateway-model-candidate.json", &made);
    assert_eq!(made["step"], "asking", "{made}");
    // A wrong answer and a missing one are told by key.
    let asked = &made["draft"]["questions"];
    let first_point = asked
        .as_array()
        .expect("a list")
        .iter()
        .find(|of| of["key"] == "point");
    let of = first_point.expect("asked")["of"].as_str().expect("a text");
    answers(
        &program,
        &id,
        &[json!({ "of": of, "key": "point", "value": "1, 2" })],
    );
    let wrong = settled(&program);
    assert!(
        wrong["error"]
            .as_str()
            .expect("told")
            .contains("three numbers"),
        "{wrong}"
    );
    // What was refused is kept, to be mended.
    assert_eq!(wrong["draft"]["answers"][0]["value"], "1, 2", "{wrong}");
    answers(&program, &id, &[]);
    let open = settled(&program);
    assert!(
        open["error"]
            .as_str()
            .expect("told")
            .contains("open questions: leave none empty"),
        "{open}"
    );
    assert!(!open["error"].to_string().contains("toml"), "{open}");
    // The unit of the level says that it stood on a bridge, which is asked about then.
    answers(&program, &id, &all_answers(&made));
    let more = settled(&program);
    assert!(
        more["draft"]["questions"].to_string().contains("bridge_mm"),
        "{more}"
    );
    assert!(more["error"].is_string(), "{more}");
    assert_eq!(answers(&program, &id, &all_answers(&more)).status, 200);
    let made = settled(&program);
    assert_eq!(made["step"], "ready", "{made}");
    validate("gateway-model-candidate.json", &made);
    is_undisturbed(&program, &id, &all_answers(&more));
    let made = settled(&program);
    assert_eq!(made["step"], "ready", "{made}");
    check_numbers(&made["result"]);
    let asked = activate(&program, &made, None);
    let taken = if asked.status == 409 {
        activate(&program, &made, Some(&asked.json()["model"]))
    } else {
        asked
    };
    assert_eq!(taken.status, 200, "{}", taken.body);
    let now = model(&program);
    assert_eq!(now["hash"], made["result"]["hash"]);
    assert_eq!(now["history"][0]["file"], "5 measurement files", "{now}");
}

/// The history counts the files that were used: what could not be read or was left out is no part of the model.
#[test]
fn the_history_counts_the_files_that_were_used() {
    let rig = measured_rig();
    let program = rig.start();
    let id = send_measurements(&program);
    let query = format!("kind=measurement&name=report.xlsx&candidate={id}");
    assert_eq!(upload(&program, &query, b"PK rubbish").status, 200);
    post(&program, "draft", &json!({ "candidate": id }));
    let made = settled(&program);
    answers(&program, &id, &all_answers(&made));
    let more = settled(&program);
    let mut all = all_answers(&more);
    let place = |name: &str| {
        let measurements = more["draft"]["measurements"].as_array().expect("a list");
        let mut files = measurements.iter().map(|of| of["files"].to_string());
        files.position(|files| files.contains(name)).expect("there")
    };
    for name in ["ezx-level.csv", "ebx.csv"] {
        let of = place(name).to_string();
        all.push(json!({ "of": of, "key": "leave_out", "value": "true" }));
    }
    answers(&program, &id, &all);
    let made = settled(&program);
    assert_eq!(made["step"], "ready", "{made}");
    assert_eq!(
        made["result"]["used"].as_array().expect("a list").len(),
        3,
        "{made}"
    );
    let asked = activate(&program, &made, None);
    let confirm = (asked.status == 409).then(|| asked.json()["model"].clone());
    if confirm.is_some() {
        let taken = activate(&program, &made, confirm.as_ref());
        assert_eq!(taken.status, 200, "{}", taken.body);
    }
    let now = model(&program);
    assert_eq!(now["history"][0]["file"], "3 measurement files", "{now}");
}

/// A wave that a curve of few terms follows, and a zigzag of 0.3 µm, ten times what the runs scatter, that only a table can: page Model warns of
/// the curve that was chosen, beside its numbers.
#[test]
fn a_curve_that_does_not_follow_its_readings_is_told_with_the_model() {
    let mut text = String::from("target,run,direction,deviation_um\n");
    for run in 1..=4 {
        for step in 0..=20 {
            let sign = |odd: i32| if odd % 2 == 0 { 1.0 } else { -1.0 };
            let wave = 50.0 * (std::f64::consts::TAU * f64::from(step) / 20.0).sin();
            let scatter = 0.02 * sign(run / 2 + step / 3) * sign(run);
            let read = wave + 0.3 * sign(step) + scatter;
            text += &[
                (step * 30).to_string(),
                run.to_string(),
                "+".to_owned(),
                read.to_string(),
            ]
            .join(",");
            text.push('\n');
        }
    }
    let rig = measured_rig();
    let program = rig.start();
    let sent = upload(&program, "kind=measurement&name=exx.csv", text.as_bytes());
    assert_eq!(sent.status, 200, "{}", sent.body);
    let id = sent.json()["id"].as_str().expect("named").to_owned();
    assert_eq!(
        post(&program, "draft", &json!({ "candidate": id })).status,
        200
    );
    let asked = settled(&program);
    assert_eq!(
        answers(&program, &id, &all_answers(&asked)).status,
        200,
        "{asked}"
    );
    let made = settled(&program);
    assert_eq!(made["step"], "ready", "{made}");
    let told = made["result"]["warnings"].to_string();
    assert!(told.contains("EXX: the curve chosen"), "{told}");
}

/// Before, answers that were given while a further file was on its way led to a model that left this file out.
#[test]
fn nobody_goes_on_while_a_file_is_on_its_way() {
    let rig = measured_rig();
    let program = rig.start();
    let id = send_measurements(&program);
    let draft = || post(&program, "draft", &json!({ "candidate": id }));
    assert_eq!(draft().status, 200);
    let made = settled(&program);
    assert_eq!(made["step"], "asking", "{made}");
    // Half of a further file.
    let mut stream = program.connect();
    let head = format!(
        "POST /api/model/upload?kind=measurement&name=late.csv&candidate={id} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: 8\r\nConnection: close\r\n\r\n1,2\n",
        program.address
    );
    stream.write_all(head.as_bytes()).expect("it listens");
    let folder = rig.dir.path().join("audit/models/uploads").join(&id);
    let end = Instant::now() + Duration::from_secs(20);
    while !folder.join("files/.late.csv.part").exists() {
        assert!(Instant::now() < end, "it does not begin");
        std::thread::sleep(Duration::from_millis(20));
    }
    for refused in [
        answers(&program, &id, &all_answers(&made)),
        draft(),
        activate(&program, &made, None),
    ] {
        assert_eq!(refused.status, 409, "{}", refused.body);
        assert!(refused.body.contains("late.csv"), "{}", refused.body);
    }
    stream.write_all(b"3,4\n").expect("it listens");
    let mut told = String::new();
    let _ = stream.read_to_string(&mut told);
    assert_eq!(answer(&told).status, 200, "{told}");
    let now = candidate(&program);
    assert_eq!(now["step"], "uploading", "{now}");
    assert!(now["draft"].is_null(), "{now}");
    assert!(now["files"].to_string().contains("late.csv"), "{now}");
    assert_eq!(draft().status, 200);
}

/// Before, only whole files counted: as many as are received at one time went over what all of them together may be.
#[test]
fn files_on_their_way_count_for_what_all_may_be() {
    let rig = Rig::new("");
    change(
        &rig.config,
        "[dashboard]\n",
        "[dashboard]\nupload_mib = 1\n",
    );
    let program = rig.start();
    let begun = upload(&program, "kind=measurement&name=x.csv", b"1,2\n").json();
    let id = begun["id"].as_str().expect("named").to_owned();
    let files = rig.dir.path().join("audit/models/uploads").join(&id);
    let begin = |name: &str| {
        let mut stream = program.connect();
        let head = format!(
            "POST /api/model/upload?kind=measurement&name={name}&candidate={id} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: {}\r\n\r\n1,2\n",
            program.address,
            1024 * 1024
        );
        stream.write_all(head.as_bytes()).expect("it listens");
        stream
    };
    // Three of a MiB each, and nothing comes of them.
    let streams: Vec<_> = ["a.csv", "b.csv", "c.csv"].into_iter().map(begin).collect();
    let end = Instant::now() + Duration::from_secs(20);
    for name in ["a", "b", "c"] {
        while !files.join(format!("files/.{name}.csv.part")).exists() {
            assert!(Instant::now() < end, "{name} does not begin");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    // Four bytes are there, 4 MiB is the most.
    let whole = vec![b'1'; 1024 * 1024];
    let query = format!("kind=measurement&name=d.csv&candidate={id}");
    let over = upload(&program, &query, &whole);
    assert_eq!(over.status, 413, "{}", over.body);
    assert!(over.body.contains("all files together"), "{}", over.body);
    let query = format!("kind=measurement&name=e.csv&candidate={id}");
    let fits = upload(&program, &query, &whole[4..]);
    assert_eq!(fits.status, 200, "{}", fits.body);
    // What is cut gives its share back.
    drop(streams);
    let end = Instant::now() + Duration::from_secs(20);
    let query = format!("kind=measurement&name=d.csv&candidate={id}");
    while upload(&program, &query, &whole).status != 200 {
        assert!(Instant::now() < end);
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// A model in force whose file cannot be kept is told until it can: before, the next line of the history wiped it out.
#[test]
fn a_model_that_cannot_be_kept_is_told_until_it_is() {
    let rig = Rig::new("");
    let program = rig.start();
    let machine = rig.dir.path().join("machine.toml");
    let text = std::fs::read_to_string(&machine).expect("there");
    let other = text.replace("EYX = 20.0", "EYX = 21.0");
    assert_ne!(text, other);
    let hash = volcomp_model::Machine::parse(&other, "machine.toml")
        .expect("right")
        .checksum();
    let digits = hash.strip_prefix("sha256:").expect("a hash");
    let kept = rig.dir.path().join("audit/models");
    // A folder in the place of the file that is written first.
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
    // Looked at anew, it is still so.
    std::thread::sleep(Duration::from_secs(3));
    let now = model(&program);
    assert!(is_told(&now), "{now}");
    std::fs::remove_dir(&stands_in).expect("empty");
    wait_model(&program, |now| now["trouble"].is_null());
    assert!(kept.join(format!("machine-{digits}.toml")).is_file());
}

/// The overruns of as many cycles with calibrations under way as without, in turns. Whatever else runs on this computer disturbs
/// both; the work adds to no more than one cycle in ten.
fn is_undisturbed(program: &Program, id: &str, all: &[Value]) {
    let counted = || {
        let cycle = &program.state()["cycle"];
        ["count", "overruns"].map(|of| cycle[of].as_u64().expect("counted"))
    };
    let mut totals = [[0; 2]; 2];
    for turn in 0..6 {
        let begun = counted();
        let mut now = begun;
        while now[0] < begun[0] + 150 {
            // As many requests in both: they are answered by the threads of the dashboard, which is no matter here.
            if turn % 2 == 1 {
                // One that is under way refuses the next.
                answers(program, id, all);
            } else {
                candidate(program);
            }
            std::thread::sleep(Duration::from_millis(25));
            now = counted();
        }
        totals[turn % 2][0] += now[0] - begun[0];
        totals[turn % 2][1] += now[1] - begun[1];
    }
    let [idle, work] = totals;
    println!(
        "overruns: {} of {} cycles idle, {} of {} with the work",
        idle[1], idle[0], work[1], work[0]
    );
    assert!(
        work[1] * idle[0] <= idle[1] * work[0] + work[0] * idle[0] / 10,
        "{idle:?} {work:?}"
    );
}

/// The machine of the example's measurements, and an engineer.
pub(crate) fn measured_rig_in(dir: &Path, control: &Simulator) -> PathBuf {
    let config = configuration(dir, control, "auto_arm = true");
    let machine = std::fs::read_to_string(examples().join("machine.toml")).expect("there");
    std::fs::write(dir.join("machine.toml"), machine).expect("writable");
    engineers(dir);
    config
}

fn measured_rig() -> Rig {
    let dir = tempfile::tempdir().expect("writable");
    let control = measured_control();
    let config = measured_rig_in(dir.path(), &control);
    Rig {
        dir,
        control,
        config,
    }
}

/// A control whose axes stay within the travels of the example.
pub(crate) fn measured_control() -> Simulator {
    let mut world = volcomp_focas::simulator::World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|elapsed| {
        let x = 300.0 + 200.0 * (elapsed.as_secs_f64() * 0.5).sin();
        vec![x, 150.0, -250.0]
    });
    Simulator::start(
        "127.0.0.1:0",
        volcomp_focas::simulator::Options::default(),
        world,
    )
    .expect("loopback")
}

pub(crate) fn examples() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../examples/calibration")
}

fn send_measurements(program: &Program) -> String {
    let mut id = String::new();
    for name in ["ebx.csv", "exx.csv", "eyx.csv", "exy.csv", "ezx-level.csv"] {
        let bytes = std::fs::read(examples().join(name)).expect("there");
        let at = if id.is_empty() {
            String::new()
        } else {
            format!("&candidate={id}")
        };
        let sent = upload(
            program,
            &format!("kind=measurement&name={name}{at}"),
            &bytes,
        );
        assert_eq!(sent.status, 200, "{}", sent.body);
        sent.json()["id"]
            .as_str()
            .expect("named")
            .clone_into(&mut id);
    }
    id
}

fn answers(program: &Program, id: &str, all: &[Value]) -> Answer {
    post(
        program,
        "answers",
        &json!({ "candidate": id, "answers": all }),
    )
}

/// What the calibration file of the example says, as answers.
fn all_answers(made: &Value) -> Vec<Value> {
    let questions = made["draft"]["questions"].as_array().expect("a list");
    let answer = |question: &Value| {
        let key = question["key"].as_str().expect("a text");
        let about = question["about"].as_str().expect("a text");
        let value = match key {
            "at.X" => "300",
            "at.Y" => "200",
            "at.Z" => "-300",
            "point" if about.contains("exx") => "0, 0, -350",
            "point" => "0, 0, -420",
            "rides" if about.contains("exx") => "carriage",
            "rides" => "other",
            "sign" if about.contains("ebx") || about.contains("ezx") => "-1",
            "sign" => "1",
            "bridge_mm" => "150",
            "reading" => "slope",
            "reference_angle_urad" => "2",
            "error" if about.contains("ebx") => "EBX",
            "error" if about.contains("exx") => "EXX",
            "error" if about.contains("eyx") => "EYX",
            "error" if about.contains("exy") => "EXY",
            "error" => "EZX",
            "unit" if about.contains("ebx") || about.contains("ezx") => "urad",
            "unit" => "um",
            other => panic!("{other} of {about}"),
        };
        json!({ "of": question["of"], "key": key, "value": value })
    };
    questions.iter().map(answer).collect()
}

/// The numbers of a result belong together: residuals are readings minus curve, a band lies around it.
fn check_numbers(result: &Value) {
    let list = |of: &Value| of.as_array().expect("a list").clone();
    let number = |of: &Value| of.as_f64().expect("a number");
    let fits = list(&result["fits"]);
    assert!(!fits.is_empty());
    for fit in &fits {
        let residuals = list(&fit["residuals"]);
        assert_eq!(residuals.len(), list(&fit["readings"]).len());
        let squares: f64 = residuals.iter().map(|of| number(&of[1]).powi(2)).sum();
        #[expect(clippy::cast_precision_loss, reason = "some tens")]
        let rms = (squares / residuals.len() as f64).sqrt();
        let told = number(&fit["residual_rms"]);
        assert!((rms - told).abs() < 1e-6, "{}: {rms}, {told}", fit["error"]);
        for (reading, residual) in list(&fit["readings"]).iter().zip(&residuals) {
            // Between the two curve points around it.
            let at = number(&reading[0]);
            let there = number(&reading[1]) - number(&residual[1]);
            let curve = list(&fit["fit"]);
            let near = |of: &&Value| (number(&of[0]) - at).abs();
            let near = curve
                .iter()
                .min_by(|a, b| near(a).total_cmp(&near(b)))
                .expect("a curve");
            let span = curve
                .iter()
                .map(|of| number(&of[1]).abs())
                .fold(1.0, f64::max);
            assert!(
                (number(&near[1]) - there).abs() < 0.25 * span,
                "{}",
                fit["error"]
            );
        }
        if let Some(band) = fit["band"].as_array() {
            for (of, curve) in band.iter().zip(list(&fit["fit"])) {
                assert!(number(&of[1]) <= number(&curve[1]) && number(&curve[1]) <= number(&of[2]));
            }
        }
    }
    assert_eq!(list(&result["diagonals"]).len(), 4);
}
