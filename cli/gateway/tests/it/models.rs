//! New models over HTTP: upload, confirmation, activation through the ramp, reverting, and rejections.

mod files;
mod in_force;
mod refused;

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use serde_json::{Value, json};

use crate::{
    manual::{Served, served_configuration},
    program::{Answer, Client, MACHINE, PATIENCE, answer},
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
    // A candidate without a result has no hash.
    let hash = candidate["result"]["hash"].as_str().unwrap_or("none");
    let mut body = json!({ "candidate": candidate["id"], "hash": hash });
    if let Some(hash) = confirm {
        body["confirm"] = hash.clone();
    }
    post(program, "activate", &body)
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
