//! The gateway over the vcan0 of the guest, and over its simulated digital lines. Run by `./test` in the guest, or by
//! `tests/guest/run`.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

#[path = "../it/program.rs"]
#[expect(dead_code, reason = "more is needed where there is a network")]
mod program;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use program::{MACHINE, Program, path, token_file};
use volcomp_can::{CanPort, CanSocket, Frame, Message, Received, SHIPPED_DBC, SignalTable};

fn configuration(dir: &Path, controller: &str) -> PathBuf {
    fs::write(dir.join("machine.toml"), MACHINE).unwrap();
    token_file(dir);
    let text = format!(
        "machine = \"machine.toml\"\ncycle_ms = 20.0\nauto_arm = true\n[guard]\nrapid_m_per_min = 10000\nlimit_um = 100.0\nslew_um_per_s = 200.0\nhold_ms = 200\nzero_after_ms = 2000\n[[controller]]\n{controller}\n[dashboard]\ntoken_file = \"tokens\"\n"
    );
    let file = dir.join("G.toml");
    fs::write(&file, text).unwrap();
    file
}

/// A simulated control on the bus: accepts every write as long as it responds.
struct Control {
    stop: Arc<AtomicBool>,
    silent: Arc<AtomicBool>,
    /// Applied corrections of X, Y and Z, µm.
    applied: Arc<Mutex<[f64; 3]>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

fn message(table: &SignalTable, name: &str) -> Message {
    table.messages.iter().find(|m| m.name == name).unwrap().clone()
}

fn frame(message: &Message, values: &[f64], counter: u64) -> Frame {
    let mut data = vec![0; message.length];
    for (signal, value) in message.signals.iter().zip(values) {
        signal.put(&mut data, *value);
    }
    message.seal(&mut data, counter);
    Frame::new(message.id, message.extended, false, &data).unwrap()
}

impl Control {
    fn start() -> Self {
        let (stop, silent) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let applied = Arc::new(Mutex::new([0.0; 3]));
        let (ends, quiet, takes) = (Arc::clone(&stop), Arc::clone(&silent), Arc::clone(&applied));
        let thread = std::thread::spawn(move || {
            let table = SignalTable::parse(SHIPPED_DBC).unwrap();
            let [xy, z, state, correction] = ["POSITION_XY", "POSITION_ZC", "STATE", "CORRECTION"]
                .map(|name| message(&table, name));
            let mut socket = CanSocket::open("vcan0").unwrap();
            let soon = || Instant::now() + Duration::from_millis(100);
            for counter in 0.. {
                if ends.load(Ordering::Relaxed) {
                    break;
                }
                if !quiet.load(Ordering::Relaxed) {
                    let applied = *takes.lock().unwrap();
                    let flags = state.signals.iter().map(|s| match &*s.name {
                        "X_APPLIED" => applied[0],
                        "Y_APPLIED" => applied[1],
                        "Z_APPLIED" => applied[2],
                        "REFERENCED" => 1.0,
                        _ => 0.0,
                    });
                    let flags: Vec<f64> = flags.collect();
                    for frame in [
                        frame(&xy, &[200.0, 50.0], counter),
                        frame(&z, &[10.0, 0.0], counter),
                        frame(&state, &flags, counter),
                    ] {
                        socket.send(&frame, soon()).unwrap();
                    }
                }
                while let Ok(Some(received)) = socket.receive(Instant::now()) {
                    if let Received::Frame(frame, _) = received
                        && frame.id == correction.id
                        && correction.is_whole(frame.data())
                    {
                        let value = |name: &str| {
                            correction
                                .signals
                                .iter()
                                .find(|s| s.name == name)
                                .unwrap()
                                .value(frame.data())
                        };
                        *takes.lock().unwrap() = ["X_CORR", "Y_CORR", "Z_CORR"].map(value);
                    }
                }
                std::thread::sleep(Duration::from_millis(10));
            }
        });
        Self { stop, silent, applied, thread: Some(thread) }
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(std::thread::JoinHandle::join);
    }
}

#[test]
fn over_vcan() {
    let dir = tempfile::tempdir_in("/var/tmp").unwrap();
    let control = Control::start();
    let config = configuration(dir.path(), "url = \"can://vcan0\"\naxes = [\"X\", \"Y\", \"Z\"]");
    let mut program = Program::start(dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    program.wait(|state| state["correction_um"]["Y"] == -20.0).unwrap();
    std::thread::sleep(Duration::from_millis(200));
    // 0.05 µm/mm at 200 mm, and 20 µm.
    assert_eq!(*control.applied.lock().unwrap(), [-10.0, -20.0, 0.0]);
    control.silent.store(true, Ordering::Relaxed);
    program.wait(|state| state["state"] == "holding" || state["state"] == "ramping-out").unwrap();
    control.silent.store(false, Ordering::Relaxed);
    program.wait_for("compensating");
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(*control.applied.lock().unwrap(), [0.0; 3]);
}

fn bank(label: &str) -> PathBuf {
    for device in fs::read_dir("/sys/devices/platform").unwrap().flatten() {
        for chip in fs::read_dir(device.path()).into_iter().flatten().flatten() {
            let is_chip = chip.file_name().to_string_lossy().starts_with("gpiochip");
            let named = || {
                fs::read_to_string(chip.path().join("sim_gpio0")).is_ok()
                    || chip.path().join("sim_gpio0").is_dir()
            };
            if is_chip && named() && label_of(&chip.file_name().to_string_lossy()) == label {
                return chip.path();
            }
        }
    }
    panic!("no chip {label}")
}

fn label_of(chip: &str) -> String {
    let info = gpiocdev::Chip::from_path(format!("/dev/{chip}")).and_then(|chip| chip.info());
    info.map(|info| info.label).unwrap_or_default()
}

#[test]
fn over_digital_lines() {
    let dir = tempfile::tempdir_in("/var/tmp").unwrap();
    let (outputs, inputs) = (bank("panel-out"), bank("panel-in"));
    let shows = |word: u32| {
        for line in 0..15 {
            let pull = if word >> line & 1 == 1 { "pull-up" } else { "pull-down" };
            fs::write(outputs.join(format!("sim_gpio{line}/pull")), pull).unwrap();
        }
    };
    // Two's complement, µm.
    let sees = || {
        let level = |line: u32| {
            let text = fs::read_to_string(inputs.join(format!("sim_gpio{line}/value"))).unwrap();
            u8::from(text.trim() == "1") << line
        };
        (0..8).map(level).sum::<u8>().cast_signed()
    };
    // 32 counts per mm.
    shows(200 * 32);
    let controller = "url = \"gpio://?position=panel-out:0-14&correction=panel-in:0-7\"\naxes = [\"X\"]\nfixed = { Y = 50.0, Z = 0.0 }\nunwatched = true\nunseen = [\"referenced\", \"alarm\", \"emergency_stop\"]";
    let config = configuration(dir.path(), controller);
    let mut program = Program::start(dir.path(), &["--config", path(&config)]);
    let state = program.wait_for("compensating");
    let reasons = state["reasons"].to_string();
    for reason in ["unwatched", "cannot see other gateways", "not proven what positions contain"] {
        assert!(reasons.contains(reason), "{reasons}");
    }
    program.wait(|state| state["correction_um"]["X"] == -10.0).unwrap();
    assert_eq!(sees(), -10);
    shows(600 * 32);
    program.wait(|state| state["correction_um"]["X"] == -30.0).unwrap();
    assert_eq!(sees(), -30);
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    assert_eq!(sees(), 0);
}
