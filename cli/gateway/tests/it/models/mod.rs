//! New models over HTTP: uploaded, confirmed, in force through the ramp, gone back from; and what is refused.

mod files;
mod in_force;
mod refused;

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use volcomp_focas::simulator::Simulator;

use crate::{
    controlled::{configuration, control},
    program::{Answer, MACHINE, PATIENCE, Program, answer, path},
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

/// The machine of the example's measurements, and an engineer.
pub(crate) fn measured_rig_in(dir: &Path, control: &Simulator) -> PathBuf {
    let config = configuration(dir, control, "auto_arm = true");
    let machine = std::fs::read_to_string(examples().join("machine.toml")).expect("there");
    std::fs::write(dir.join("machine.toml"), machine).expect("writable");
    engineers(dir);
    config
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
