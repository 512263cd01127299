//! The shared key of gateway and bridge, which protects the axes from other programs on the control's computer.
//!
//! Without the key a program moves no axis and locks out no gateway. A program with the key counts as another gateway.
//! `check` reports a missing key, and what is missing in the INI file of the control.

use std::{
    net::UdpSocket,
    os::unix::fs::PermissionsExt as _,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use volcomp_devices::Address;
use volcomp_guard::{
    barrier::{FRAME_WORDS, Frame, Report},
    protocol::{Head, Layout},
};
use volcomp_linuxcnc::{COMMAND_BYTES, Command, Content, Key, STATE_BYTES, State};
use volcomp_port::Words;
use volcomp_test_support::{root, rows};
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{
    check::check,
    linuxcnc::{
        MOST, PORT, corrected_at, gateway, no_jump, part,
        peer::{LinuxCnc, alone},
        residuals, wait_corrected, wait_zero,
    },
    manual::machine,
};

alone!(key: without_the_key_nothing_moves_and_no_gateway_is_locked_out, a_program_with_the_key_is_another_gateway);

const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
/// Sockets that request states, many more than the bridge has slots.
const LISTENERS: usize = 100;

fn socket() -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("loopback");
    socket.connect(("127.0.0.1", PORT)).expect("loopback");
    let second = Some(Duration::from_secs(1));
    socket.set_read_timeout(second).expect("a socket");
    socket
}

fn encoded(answers: [u32; 2], content: Content, key: &Key) -> Vec<u8> {
    let mut bytes = [0; COMMAND_BYTES];
    let command = Command { machine: 1, answers, content };
    let length = command.encode(key, &mut bytes);
    bytes[..length].to_vec()
}

/// An attacker that knows everything about the bridge except possibly the key. It sends frames signed with a given key.
struct Beside {
    socket: UdpSocket,
    key: Key,
    last: Option<State>,
}

impl Beside {
    fn new(dir: &Path) -> Self {
        Self {
            socket: socket(),
            key: Key::read(&dir.join("volcomp.key")).expect("written"),
            last: None,
        }
    }

    fn answers(&self) -> [u32; 2] {
        (self.last.as_ref()).map_or([0; 2], |state| [state.run, state.sequence])
    }

    fn report(&mut self) -> Option<Report> {
        let listen = encoded(self.answers(), Content::Listen, &self.key);
        let _ = self.socket.send(&listen);
        let mut bytes = [0; STATE_BYTES];
        let length = self.socket.recv(&mut bytes).ok()?;
        let state = State::decode(&bytes[..length], &self.key).expect("the bridge's");
        let layout = Layout::of(AXES).expect("each once");
        let report = Report::decode(1, layout, state.report.as_slice());
        self.last = Some(state);
        report
    }

    /// Sends a frame that requests the bridge's full limit, with the number of the owner, and a sequence number `ahead`
    /// of the last accepted one.
    fn send(&self, report: &Report, ahead: u16, key: &Key) {
        let up = report.tick % 1000 < 500;
        let frame = Frame {
            head: Head {
                sequence: report.sequence.wrapping_add(ahead),
                owner: report.owner.max(1),
                ..report.head()
            },
            values: *PerChannel::leading([if up { 30_000 } else { -30_000 }; 3]),
        };
        let mut words = [0; FRAME_WORDS];
        let length = frame.encode(&report.settings, &mut words);
        let words = Words::new(&words[..length]).expect("few words");
        let _ = self.socket.send(&encoded(self.answers(), Content::Frame(words), key));
    }
}

/// A thread that runs all attacks until it is stopped.
struct Attack {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Attack {
    fn start(dir: &Path) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let mut beside = Beside::new(dir);
        let thread = std::thread::spawn(move || {
            let other = Key::new([9; 16]);
            let listeners: Vec<UdpSocket> = (0..LISTENERS).map(|_| socket()).collect();
            // Replayed valid frames must be rejected, because they are too old.
            beside.report();
            let recorded = encoded(beside.answers(), Content::Listen, &beside.key);
            let mut round = 0_usize;
            while !stopped.load(Ordering::Relaxed) {
                if let Some(report) = beside.report() {
                    beside.send(&report, 1, &other);
                    beside.send(&report, 2, &other);
                }
                // Each listener sends 40 times per second.
                for listener in listeners.iter().skip(round % 25).step_by(25) {
                    let forged = encoded(beside.answers(), Content::Listen, &other);
                    let _ = listener.send(&forged);
                    let _ = listener.send(&recorded);
                    let _ = listener.send(&recorded[..round % recorded.len()]);
                }
                round += 1;
            }
        });
        Self { stop, thread: Some(thread) }
    }

    fn end(mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take().expect("ended once");
        thread.join().expect("no panic");
    }
}

/// The bridge reports its state only to a program with its key, not to one with another key or none.
fn a_probe_needs_the_key(dir: &Path) {
    let other = dir.join("other.key");
    std::fs::write(&other, "09".repeat(16)).expect("writable");
    let mode = std::fs::Permissions::from_mode(0o600);
    std::fs::set_permissions(&other, mode).expect("ours");
    let probe = |key: &str| {
        let url = format!("linuxcnc://127.0.0.1:{PORT}{key}");
        let address = Address::parse(&url).expect("a URL");
        volcomp_devices::probe(&address, Duration::from_secs(2))
    };
    let with = |file: &Path| probe(&format!("?key_file={}", file.display()));
    let right = with(&dir.join("volcomp.key")).expect("it answers");
    let names: Vec<&String> = right.positions_mm.keys().collect();
    assert_eq!(names, ["X", "Y", "Z"]);
    let wrong = with(&other).expect_err("another key").to_string();
    println!("{wrong}");
    assert!(wrong.contains("does not answer"), "{wrong}");
    let none = probe("").expect_err("no key").to_string();
    assert!(none.contains("found no key_file"), "{none}");
}

/// Attacks before a gateway connects and while it corrects: frames with the owner's number and the right epoch, tick
/// and sequence; a hundred listeners; replayed requests. No axis moves, and the gateway keeps its correction.
fn without_the_key_nothing_moves_and_no_gateway_is_locked_out() {
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), |ini| ini);
    a_probe_needs_the_key(dir.path());
    let attack = Attack::start(dir.path());
    control.do_it("up");
    control.mdi("G21 G90 G0 X20 Y10 Z-5");
    control.wait("volcomp.forged", |forged| forged > 3000.0);
    // The attack runs before a gateway connects.
    let cycles = control.record(|_| std::thread::sleep(Duration::from_secs(1)));
    assert!(cycles.len() > 100, "{} cycles", cycles.len());
    assert!(cycles.iter().all(|cycle| cycle.offset == [0.0; 3]));
    assert_eq!(control.pin("volcomp.owner"), 0.0);
    assert_eq!(control.pin("volcomp.taken"), 0.0);

    let config = crate::linuxcnc::configuration(dir.path(), PORT);
    let (text, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 0, "{errors}");
    assert!(text.contains("# protocol = 2\n"), "{text}");
    let program = gateway(dir.path(), PORT);
    wait_corrected(&mut control, &program);
    let cycles = control.record(|control| control.mdi("G1 F600 X60 Y45 Z-25"));
    no_jump(&cycles, MOST);
    // The gateway's frames may queue behind those of the attack for some cycles.
    let found = residuals(&cycles);
    let [median, most] = [50, 99].map(|of| part(&found, of));
    println!("beside an attack: residual {median:.2} nm median, {most:.1} nm p99");
    assert!(median < 20.0 && most < 200.0, "{median} nm, {most} nm");
    let state = program.state();
    assert_eq!(state["state"], "compensating", "{state}");
    attack.end();
}

/// A frame with the gateway's number that the gateway did not send is detected and causes a fault.
fn a_program_with_the_key_is_another_gateway() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut control, program) = corrected_at("X50 Y40 Z-20", dir.path(), |ini| ini);
    let mut beside = Beside::new(dir.path());
    let cycles = control.record(|control| {
        for _ in 0..1000 {
            if let Some(report) = beside.report() {
                beside.send(&report, 2, &beside.key);
            }
        }
        let state = program.wait_for("faulted");
        let reasons = state["reasons"].to_string();
        assert!(reasons.contains("another gateway"), "{state}");
        wait_zero(control);
    });
    no_jump(&cycles, MOST);
    let state = program.state();
    assert_eq!(state["state"], "faulted", "an operator must acknowledge it: {state}");
}

/// Runs `check` on the shipped example with a change in its INI file. Returns the status and the errors.
fn check_with(from: &str, to: &str) -> (u8, String) {
    let dir = tempfile::tempdir().expect("writable");
    for file in ["gateway.toml", "machine.toml", "mill.ini"] {
        let text = std::fs::read_to_string(root().join("examples/linuxcnc").join(file));
        let mut text = text.expect("shipped");
        if file == "mill.ini" {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
        std::fs::write(dir.path().join(file), text).expect("writable");
    }
    crate::linuxcnc::key_file(dir.path());
    let (_, said, status) = check(&dir.path().join("gateway.toml"), &[]);
    (status, said)
}

#[test]
fn check_names_what_is_missing_in_the_file() {
    let (status, said) = check_with("[JOINT_0]", "[JOINT_0]");
    assert_eq!(status, 0, "{said}");
    for [from, to, says] in rows(
        r"
[JOINT_0]\n | [JOINT_0]\nBACKLASH = 0.01\n | [JOINT_0]BACKLASH
[JOINT_2]\n | [JOINT_2]\nCOMP_FILE = z.comp\n | [JOINT_2]COMP_FILE
volcomp.tcl | nothing.tcl | [HAL]HALFILE
[AXIS_Z]\nOFFSET_AV_RATIO = 0.02 | [AXIS_Z] | [AXIS_Z]OFFSET_AV_RATIO is missing
LIMIT_UM = 30 | LIMIT_UM = 5 | [VOLCOMP]LIMIT_UM: found 5, expected 30 or more
RATE_UM_PER_S = 2000 | RATE_UM_PER_S = 10 | [VOLCOMP]RATE_UM_PER_S: found 10, expected 1000 or more
RATE_UM_PER_S = 2000 | RATE_UM_PER_S = 2000\nTIME_OUT_MS = 1100 | [VOLCOMP]TIME_OUT_MS: found 1100, expected 1000 or less
[JOINT_1]\n | [JOINT_1]\n#INCLUDE comp.inc\n | #INCLUDE comp.inc
LIMIT_UM = 30 | LIMIT_UM = 30\nKEY_FILE = other.key | [VOLCOMP]KEY_FILE:
",
    ) {
        let (status, said) = check_with(from, to);
        assert_eq!(status, 2, "{said}");
        assert!(said.contains(says) && said.contains("mill.ini"), "{said}");
    }
}

/// A gateway without a key file does not start. `check` names the error in a key file.
#[test]
fn a_gateway_without_a_key_is_refused() {
    let dir = tempfile::tempdir().expect("writable");
    let config = crate::linuxcnc::configuration(dir.path(), crate::linuxcnc::PORT);
    let file = dir.path().join("volcomp.key");
    let text = std::fs::read_to_string(&config).expect("written");
    for (key, mode, table, says) in [
        (Some("00"), 0o600, true, "expected 32 hexadecimal digits"),
        (Some("000102030405060708090a0b0c0d0e0f"), 0o644, true, "found mode 644, expected 600"),
        (None, 0o600, true, "volcomp.key: No such file"),
        (None, 0o600, false, "found no linuxcnc.key_file"),
    ] {
        match key {
            Some(key) => {
                std::fs::write(&file, key).expect("writable");
                let mode = std::fs::Permissions::from_mode(mode);
                std::fs::set_permissions(&file, mode).expect("ours");
            }
            None => _ = std::fs::remove_file(&file),
        }
        let line = "linuxcnc = { key_file = \"volcomp.key\" }\n";
        assert!(text.contains(line), "{text}");
        let with = if table { text.clone() } else { text.replace(line, "") };
        std::fs::write(&config, with).expect("writable");
        let check = check(&config, &[]);
        let daemon = machine(&config).plan().err().expect(says);
        assert_eq!((check.2, daemon.status()), (2, 2), "{says}");
        for said in [check.1, daemon.to_string()] {
            assert!(said.contains(says), "{says}: {said}");
        }
    }
}
