//! Configuration and machine file read again while it corrects.

use crate::{
    controlled::{configuration, control},
    program::{Program, change, path},
};

/// Whether the reasons of a state or an answer hold these words.
fn says(answer: &serde_json::Value, words: &str) -> bool {
    answer["reasons"].to_string().contains(words)
}

/// Repeats a reload with the hash that was asked for.
fn confirm(program: &Program, asked: &serde_json::Value) {
    let body = format!("{{\"confirm\": {}}}", asked["model"]);
    let confirmed = program.post("/api/reload", &body);
    assert_eq!(confirmed.status, 200, "{}", confirmed.body);
}

/// What is told after 50 further cycles: more than a ramp of 0.1 s takes.
fn next_cycles(program: &Program) -> serde_json::Value {
    let cycle = |state: &serde_json::Value| state["cycle"]["count"].as_u64();
    let before = cycle(&program.state()).expect("a count");
    let next = program.wait(|state| cycle(state) > Some(before + 50));
    next.expect("it goes on")
}

fn ramps(program: &Program) -> usize {
    program.log().matches("state=\"arming\"").count()
}

/// The same files again: nothing happens, which it says. It went through the ramp.
fn unchanged_files_make_no_ramp(program: &Program) {
    program.wait_for("compensating");
    let before = ramps(program);
    let same = program.post("/api/reload", "");
    assert_eq!(same.status, 200, "{}", same.body);
    assert_eq!(same.json()["unchanged"], true);
    next_cycles(program);
    assert_eq!(ramps(program), before, "no ramp: {}", program.log());
}

#[test]
fn a_model_changes_through_the_ramp_and_a_large_change_is_confirmed() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let machine = dir.path().join("machine.toml");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    program
        .wait(|state| state["correction_um"]["Y"] == -20.0)
        .expect("what is applied follows");
    // 5 um at every corner: nobody is asked.
    change(&machine, "EYX = 20.0", "EYX = 25.0");
    program.signal("HUP");
    program
        .wait(|state| state["correction_um"]["Y"] == -25.0)
        .expect("the new model");
    assert_eq!(ramps(&program), 2, "through the ramp: {}", program.log());
    unchanged_files_make_no_ramp(&program);
    // 75 um: 409, and then with the hash.
    change(&machine, "EYX = 25.0", "EYX = 100.0");
    let asked = program.post("/api/reload", "");
    assert_eq!(asked.status, 409, "{}", asked.body);
    let asked = asked.json();
    assert!((asked["worst_corner_um"].as_f64().expect("a number") - 75.0).abs() < 0.1);
    let state = next_cycles(&program);
    assert_eq!(state["correction_um"]["Y"], -25.0, "nothing happened");
    let other = program.post("/api/reload", "{\"confirm\": \"sha256:00\"}");
    assert_eq!(other.status, 409);
    confirm(&program, &asked);
    program
        .wait(|state| state["correction_um"]["Y"] == -100.0)
        .expect("the new model");
    // A limit belongs to what a person confirms; the hash of the machine file alone confirms none. Then it is
    // approached.
    change(&config, "limit_um = 150.0", "limit_um = 50.0");
    let asked = program.post("/api/reload", "");
    assert_eq!(asked.status, 409, "{}", asked.body);
    let asked = asked.json();
    assert_eq!(
        asked["limits"]["limit_um"],
        serde_json::json!([150.0, 50.0])
    );
    assert_eq!(asked["worst_corner_um"], 0.0);
    // No rotary axis is corrected, and none is spoken of.
    assert!(asked["worst_corner_urad"].is_null(), "{asked}");
    assert!(!program.log().contains("µrad"), "{}", program.log());
    program
        .wait(|state| says(state, "must be confirmed"))
        .expect("it says so");
    let hash = program.state()["machine"]["hash"].clone();
    let of_machine = program.post("/api/reload", &format!("{{\"confirm\": {hash}}}"));
    assert_eq!(of_machine.status, 409);
    assert_eq!(program.state()["correction_um"]["Y"], -100.0);
    confirm(&program, &asked);
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    assert!(
        audit.contains("\"limits\":{\"limit_um\":[150.0,50.0]}"),
        "{audit}"
    );
    // The log tells the reasons in the order of the state, not by the alphabet.
    assert!(
        audit.contains("\"reasons\":[\"not proven what positions contain\","),
        "{audit}"
    );
    program
        .wait(|state| state["correction_um"]["Y"] == -50.0)
        .expect("the new limit");
    // What cannot change is said, what is wrong is refused, and all goes on.
    change(&config, "cycle_ms = 4.0", "cycle_ms = 8.0");
    let refused = program.post("/api/reload", "");
    assert_eq!(refused.status, 422);
    assert!(refused.body.contains("cycle_ms"), "{}", refused.body);
    change(&machine, "travel = [0.0, 250.0]", "travel = [250.0, 0.0]");
    change(&config, "cycle_ms = 8.0", "cycle_ms = 4.0");
    let refused = program.post("/api/reload", "");
    assert!(
        refused.status == 422 && refused.body.contains("machine.toml"),
        "{}",
        refused.body
    );
    program.wait_for("compensating");
    // The files on disk are not those that hold: it says so, also to whoever arms.
    let told = "files on disk not taken over";
    let says = |answer: &serde_json::Value| says(answer, told);
    assert_eq!(program.post("/api/disarm", "").status, 200);
    program.wait_for("disarmed");
    let armed = program.must_arm();
    assert!(says(&armed.json()), "{}", armed.body);
    assert!(says(&program.wait_for("compensating")));
    change(&machine, "travel = [250.0, 0.0]", "travel = [0.0, 250.0]");
    assert_eq!(program.post("/api/reload", "").status, 200);
    program.wait(|state| !says(state)).expect("all is in use");
    // Limits cannot be taken away while it runs.
    let text = std::fs::read_to_string(&config).expect("readable");
    let (before, rest) = text.split_once("[guard]").expect("there");
    let (_, after) = rest.split_once("[[controller]]").expect("there");
    std::fs::write(&config, format!("{before}[[controller]]{after}")).expect("writable");
    let refused = program.post("/api/reload", "");
    assert_eq!(refused.status, 422);
    assert!(
        refused.body.contains("[guard] is missing"),
        "{}",
        refused.body
    );
}

/// The machine file becomes another machine's between two runs: arming asks.
#[test]
fn another_machines_file_is_not_armed_unasked() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "");
    let machine = dir.path().join("machine.toml");
    let arguments = ["--config", path(&config)];
    {
        let mut program = Program::start(dir.path(), &arguments);
        program
            .wait(|state| state["cycle"]["count"].as_u64() > Some(20))
            .expect("it runs");
        program.must_arm();
        program.signal("TERM");
        assert_eq!(program.end(), Some(0));
    }
    change(&machine, "EYX = 20.0", "EYX = -80.0");
    {
        let program = Program::start(dir.path(), &arguments);
        program
            .wait(|state| state["cycle"]["count"].as_u64() > Some(20))
            .expect("it runs");
        let asked = program.arm();
        assert_eq!(asked.status, 409, "{}", asked.body);
        let hash = asked.json()["model"].clone();
        assert_eq!(
            program
                .post("/api/arm", &format!("{{\"confirm\": {hash}}}"))
                .status,
            200
        );
    }
    // Of other axes: it does not even start.
    change(&machine, "w X' b Y Z t", "w X' b Y C Z t");
    change(
        &machine,
        "[errors]",
        "[axes.C]\ntravel = [-180.0, 180.0]\n[errors]",
    );
    let refused = std::process::Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
        .args(arguments)
        .output()
        .expect("built");
    assert_eq!(refused.status.code(), Some(2));
    let message = String::from_utf8_lossy(&refused.stderr);
    assert!(message.contains("axis C"), "{message}");
}

/// Times and confirmations decide how long a stale correction stays and how far a model may move it unasked: before, a
/// reload took them without a question.
#[test]
fn times_and_confirmations_are_asked_about() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    let text = std::fs::read_to_string(&config).expect("readable");
    for key in ["hold_ms", "confirm_um", "zero_after_ms"] {
        let line = text.lines().find(|line| line.starts_with(key));
        let line = line.unwrap_or_else(|| panic!("{key} is in {text}"));
        let before: f64 = line
            .split('=')
            .nth(1)
            .and_then(|x| x.trim().parse().ok())
            .expect(key);
        change(&config, line, &format!("{key} = {}", before - 1.0));
        let asked = program.post("/api/reload", "");
        assert_eq!(asked.status, 409, "{key}: {}", asked.body);
        let asked = asked.json();
        assert_eq!(
            asked["limits"][key],
            serde_json::json!([before, before - 1.0])
        );
        confirm(&program, &asked);
    }
}
