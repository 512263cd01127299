//! The real program on a hanging disk: neither disarming nor stopping waits for the disk.

use std::{
    path::{Path, PathBuf},
    process::Command,
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_test_support::peers;

use crate::{
    controlled::configuration,
    models::{activate, candidate, engineers, machine_file, model, wait_model, with_y},
    program::{Program, change, path},
};

/// A gateway that corrects a machine at standstill. Its disk hangs while the file `hangs` exists.
struct Rig {
    control: Simulator,
    program: Program,
    hangs: PathBuf,
    dir: tempfile::TempDir,
}

impl Rig {
    fn start() -> Option<Self> {
        let dir = tempfile::tempdir().expect("writable");
        let library = preloaded(dir.path())?;
        let mut world = World::new(&['X', 'Y', 'Z']);
        world.motion = Arc::new(|_| vec![400.0, 150.0, 50.0]);
        let control = Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback");
        let config = configuration(dir.path(), &control, "auto_arm = true");
        engineers(dir.path());
        // A ramp of 20 µm in 20 cycles, so that every cycle of the ramp writes a new value.
        change(&config, "ramp_s = 0.1", "ramp_s = 0.08\nstop_s = 2");
        let hangs = dir.path().join("hangs");
        let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
        command.env("LD_PRELOAD", library).env("HANGS", &hangs);
        let program = Program::spawn(command, dir.path(), &["--config", path(&config)]);
        let rig = Self { control, program, hangs, dir };
        rig.corrects(-20.0);
        Some(rig)
    }

    fn corrects(&self, um: f64) {
        let corrects = |state: &serde_json::Value| state["correction_um"]["Y"] == um;
        self.program.wait(corrects).expect("it corrects");
    }

    fn hang(&self) {
        std::fs::write(&self.hangs, "").expect("writable");
    }

    fn audit(&self) -> String {
        let file = self.dir.path().join("audit/audit.log");
        std::fs::read_to_string(file).expect("a log")
    }
}

/// The preloaded library that makes the disk hang; `None` if there is no C compiler.
pub(crate) fn preloaded(dir: &Path) -> Option<PathBuf> {
    let library = dir.join("hung_disk.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/hung_disk.c");
    let built = Command::new("cc")
        .args(["-shared", "-fPIC", "-o", path(&library), path(&source)])
        .args(["-ldl"])
        .status();
    let Ok(status) = built else {
        peers::not_run("cc");
        return None;
    };
    assert!(status.success(), "cc");
    Some(library)
}

/// While the disk hangs, a request for a model times out, and the model is not activated later. Disarming and stopping
/// take effect and are answered without waiting for the disk.
#[test]
fn on_a_hanging_disk_models_time_out_and_disarming_and_stopping_act() {
    let Some(mut rig) = Rig::start() else {
        return;
    };
    model_times_out(&rig);
    disarming_acts_first(&rig);
    rig.corrects(-21.0);
    rig.hang();
    let begun = Instant::now();
    rig.program.signal("TERM");
    assert_eq!(rig.program.end(), Some(0));
    println!("disk hangs: ended after {:.1} s", begun.elapsed().as_secs_f64());
    assert_eq!(rig.control.world().shifts(), [0.0; 3]);
    assert!(rig.hangs.exists());
    let reported = "the disk of the audit log does not answer";
    assert!(rig.program.log().contains(reported));
}

fn model_times_out(rig: &Rig) {
    let program = &rig.program;
    let made = machine_file(program, &with_y(21.0));
    assert_eq!(made["step"], "ready", "{made}");
    let before = model(program)["hash"].clone();
    rig.hang();
    let given_up = activate(program, &made, None);
    assert!(rig.hangs.exists());
    assert_eq!(given_up.status, 503, "{}", given_up.body);
    assert!(given_up.body.contains("will not be later"), "{}", given_up.body);
    std::fs::remove_file(&rig.hangs).expect("ours");
    let now = wait_model(program, |now| {
        let newest = &now["history"][0];
        newest["hash"] == made["result"]["hash"] && newest["outcome"] == "refused"
    });
    assert_eq!(now["hash"], before);
    // A repeated request is executed.
    let taken = activate(program, &candidate(program), None);
    assert_eq!(taken.status, 200, "{}", taken.body);
    assert_eq!(model(program)["hash"], made["result"]["hash"]);
    rig.corrects(-21.0);
}

fn disarming_acts_first(rig: &Rig) {
    let held = rig.control.world().shifts();
    rig.hang();
    let (control, program) = (&rig.control, &rig.program);
    let pressed = Instant::now();
    let answer = std::thread::scope(|scope| {
        let answer = scope.spawn(|| {
            let answer = program.post("/api/disarm", "");
            (pressed.elapsed(), answer)
        });
        while control.world().shifts() == held {
            std::thread::yield_now();
        }
        let first = pressed.elapsed();
        let (answered, answer) = answer.join().expect("no panic");
        println!(
            "disk hangs: first write on the way out after {:.1} ms (cycle 4 ms), answer after {:.1} ms",
            first.as_secs_f64() * 1e3,
            answered.as_secs_f64() * 1e3
        );
        answer
    });
    assert_eq!(answer.status, 200, "{}", answer.body);
    program.wait_for("disarmed");
    assert_eq!(control.world().shifts(), [0.0; 3]);
    // The disk still hangs, so arming is rejected with that reason.
    assert!(rig.hangs.exists());
    program
        .wait(|state| state["reasons"].to_string().contains("audit log"))
        .expect("it is reported");
    let armed = program.post("/api/arm", "");
    assert!(matches!(armed.status, 409 | 503), "{}", armed.body);
    assert_eq!(program.state()["state"], "disarmed");
    std::fs::remove_file(&rig.hangs).expect("ours");
    program
        .wait(|state| !state["reasons"].to_string().contains("audit log"))
        .expect("the disk is back");
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(program.state()["state"], "disarmed", "nothing arms late");
    assert!(rig.audit().contains("\"who\":\"anna\",\"what\":\"disarm\""));
    program.must_arm();
}
