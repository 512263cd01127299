//! Files that are no model of this machine, and users who may not upload one.

use std::time::{Duration, Instant};

use serde_json::json;

use super::{
    ENGINEER, OTHER_ENGINEER, Rig, activate, machine_file, model, post, settled, upload, upload_as,
    wait_model, with_y,
};
use crate::{
    documents::validate,
    program::{MACHINE, OPERATE, VIEW},
};

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
