//! `send-map` as a program, with a map in a simulated SINUMERIK or FANUC control whose PLC interpolates the map. The
//! sender is stopped, killed, started twice, or given another map.

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    path::{Path, PathBuf},
    process::{ChildStdout, Command, Output, Stdio},
    time::Duration,
};

use serde_json::Value;
use volcomp_gateway::send_map;
use volcomp_tables::{
    ByteOrder, GRID_AXES, GridAxis, Output as MapOutput, Request, build, vocabulary::AxisName,
};
use volcomp_test_support::{Running, peers, root, rows, until};

use crate::{
    audit::preloaded,
    program::{change, path},
};

/// Timeout of all waits; long enough for a busy computer.
const PATIENCE: Duration = Duration::from_secs(90);
const MACHINE: u16 = 1002;
/// The map expires 2 s after its sender's last frame. Then the correction ramps to zero at 0.2 mm/s in steps of one
/// scan.
const PLC: &str = "machine=1002,capacity=700,limit=100,rate=2,scan_ms=10,hold=100,time_out=200";
const SENDER: &str = r#"
map = "machine.map"
url = "URL"
number = 1002
capacity = 700
scan_ms = 10.0
limit_um = 100.0
slew_um_per_s = 200.0
zero_after_ms = 2000.0
[sinumerik]
time_out_ms = 2000.0
"#;

/// The control. The command `report` on its standard input makes it print its state.
struct Control {
    running: Running,
    output: BufReader<ChildStdout>,
}

impl Control {
    /// A control at X = 500 mm, and its URL.
    fn start(listen: &str) -> Option<(Self, String)> {
        let mut command = Command::new(peers::python()?);
        command
            .arg(root().join("drivers/sinumerik/tests/peer/sinumerik-sim.py"))
            .args(["--listen", listen, "--json", "--map", PLC])
            .args(["--at", "X=500,Y=0,Z=0"])
            .stdin(Stdio::piped());
        let (running, line, output) = Running::start_and_hear(&mut command);
        let url = line.strip_prefix("listening on ");
        let url = url.unwrap_or_else(|| panic!("found {line:?}")).to_owned();
        Some((Self { running, output }, url))
    }

    fn report(&mut self) -> Value {
        let input = self.running.stdin.as_mut().expect("piped");
        writeln!(input, "report").expect("it runs");
        let mut line = String::new();
        self.output.read_line(&mut line).expect("a line");
        serde_json::from_str(&line).expect("JSON")
    }

    /// Correction of X from the control's map, µm.
    fn x_um(&mut self) -> f64 {
        let report = self.report();
        report["map_um"]["X"].as_f64().unwrap_or_else(|| panic!("{report}"))
    }

    fn reaches(&mut self, um: f64) {
        until("the correction", PATIENCE, || (self.x_um() - um).abs() <= 1.0);
    }
}

/// Writes a map over 1000 mm that corrects X by `largest_um` at its upper end, and the configuration of its sender, to
/// a folder.
fn write(dir: &Path, url: &str, largest_um: f64) -> PathBuf {
    write_map(dir, largest_um, 7);
    let file = dir.join("map-sender.toml");
    std::fs::write(&file, SENDER.replace("URL", url)).expect("writable");
    file
}

fn write_map(dir: &Path, largest_um: f64, counter: u16) {
    let names = [AxisName::X, AxisName::Y, AxisName::Z];
    let request = Request {
        axes: names.map(|name| GridAxis { name, travel: [0.0, 1000.0], step: 0.001 }).to_vec(),
        outputs: names.map(|name| MapOutput { name, step_mm: 0.001, limit_mm: 1.0 }).to_vec(),
        within_mm: 0.001,
        words: 700,
        counter,
        model: 1,
    };
    let field = |at: &[f64; GRID_AXES]| [largest_um * 1e-3 * at[0] / 1000.0, 0.0, 0.0];
    let map = build(&request, &field).expect("a map").map;
    let image = map.image(MACHINE, ByteOrder::HighFirst);
    std::fs::write(dir.join("machine.map"), image).expect("writable");
}

fn command(file: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command.args(["send-map", path(file)]).args(more);
    command
}

fn said(output: &Output) -> String {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}

/// The hash that confirms the map, as printed by a call without confirmation.
fn hash(file: &Path) -> String {
    let output = command(file, &[]).output().expect("it starts");
    let text = said(&output);
    assert_eq!(output.status.code(), Some(0), "{text}");
    let hash = text.trim_end().rsplit(' ').next().unwrap_or_default();
    hash.to_owned()
}

/// A simulated control, and the files of a sender, which is not started yet. The disk of the sender hangs while a
/// certain file exists.
struct Rig {
    dir: tempfile::TempDir,
    control: Control,
    url: String,
    file: PathBuf,
    disk: Disk,
}

/// A library that makes the disk hang while the file `hangs` exists.
struct Disk {
    library: PathBuf,
    hangs: PathBuf,
}

impl Disk {
    /// `None` if there is no C compiler.
    fn new(dir: &Path) -> Option<Self> {
        let hangs = dir.join("hangs");
        preloaded(dir).map(|library| Self { library, hangs })
    }

    fn hang(&self) {
        std::fs::write(&self.hangs, "").expect("writable");
    }
}

struct Sender {
    running: Running,
    output: BufReader<ChildStdout>,
    log: PathBuf,
}

impl Rig {
    /// `None` if the simulated control is missing.
    fn new() -> Option<Self> {
        let dir = tempfile::tempdir().expect("writable");
        let disk = Disk::new(dir.path())?;
        let (control, url) = Control::start("127.0.0.1:0")?;
        let file = write(dir.path(), &url, 80.0);
        Some(Self { dir, control, url, file, disk })
    }

    /// Starts a sender of the map `number`, and waits until the control applies its correction.
    fn sender(&mut self, number: u16) -> Sender {
        let sender = Sender::start(&self.file, self.dir.path(), number, &self.disk);
        self.control.reaches(40.0);
        sender
    }

    /// Confirms a new map for the running sender. Returns exit status and output.
    fn replace(&self) -> (Option<i32>, String) {
        let call = ["--confirm", &hash(&self.file), "--replace"];
        result(&self.file, &call)
    }

    fn must_replace(&self) {
        let (status, text) = self.replace();
        assert_eq!(status, Some(0), "{text}");
    }

    fn keeps(&mut self, um: f64) {
        assert!((self.control.x_um() - um).abs() <= 1.0);
    }
}

impl Sender {
    fn start(file: &Path, dir: &Path, number: u16, disk: &Disk) -> Self {
        let mut command = command(file, &["--confirm", &hash(file)]);
        command.env("LD_PRELOAD", &disk.library).env("HANGS", &disk.hangs);
        let log = dir.join("sender.log");
        let errors = std::fs::File::create(&log).expect("writable");
        let (running, line, output) = Running::start_and_hear(command.stderr(errors));
        assert_eq!(line, format!("map {number} is in use"));
        Self { running, output, log }
    }

    fn log(&self) -> String {
        std::fs::read_to_string(&self.log).expect("a log")
    }

    /// Waits until the sender rejects another map for the reason `why`.
    fn refuses(&self, why: &str) {
        until(why, PATIENCE, || {
            let log = self.log();
            log.contains("another map is not sent") && log.contains(why)
        });
    }

    fn uses(&mut self, number: u16) {
        let mut line = String::new();
        self.output.read_line(&mut line).expect("a line");
        assert_eq!(line, format!("map {number} is in use\n"));
    }

    fn stop(mut self) -> String {
        self.running.signal("TERM");
        let mut rest = String::new();
        self.output.read_to_string(&mut rest).expect("text");
        let ended = self.running.ended(PATIENCE).expect("it ends");
        assert_eq!(ended.code(), Some(0), "{}", self.log());
        assert_eq!(rest, "the corrections are zero\n");
        self.log()
    }
}

fn result(file: &Path, more: &[&str]) -> (Option<i32>, String) {
    let output = command(file, more).output().expect("it starts");
    (output.status.code(), said(&output))
}

/// Checks that a call fails with the status `expected` and the message `words`.
fn refused(file: &Path, more: &[&str], expected: i32, words: &str) {
    let (status, text) = result(file, more);
    assert_eq!(status, Some(expected), "{text}");
    assert!(text.contains(words), "{words}: {text}");
}

#[test]
fn a_control_keeps_the_map_of_its_sender_until_its_end() {
    let Some(mut rig) = Rig::new() else {
        return;
    };
    let (status, text) = rig.replace();
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains("found no sender that runs"), "{text}");
    let mut sender = rig.sender(7);
    others_are_refused(&mut rig);
    another_map_takes_the_place_of_the_one_in_use(&mut rig, &mut sender);
    a_confirmation_during_a_refusal_is_separate(&mut rig, &mut sender);
    a_disk_that_hangs_keeps_the_map_in_use(&mut rig, &mut sender);

    // After a kill the control ramps to zero without a sender. Then another sender takes over. It sends the map again
    // to a control that lost everything.
    sender.running.kill();
    rig.control.reaches(0.0);
    write_map(rig.dir.path(), 80.0, 11);
    let mut sender = rig.sender(11);
    let listen = rig.url.trim_start_matches("opc.tcp://");
    let listen = listen.split('/').next().expect("one part at least");
    rig.control.running.kill();
    let (mut control, _) = Control::start(listen).expect("it was there before");
    control.reaches(40.0);
    sender.uses(11);

    sender.stop();
    assert!(control.x_um().abs() < 0.5);

    // A full disk behind the output of the sender does not end the sending.
    write_map(rig.dir.path(), 80.0, 12);
    let full = || std::fs::File::options().write(true).open("/dev/full").expect("of the system");
    let mut command = command(&rig.file, &["--confirm", &hash(&rig.file)]);
    let mut running = Running::start(command.stdout(full()).stderr(full()));
    control.reaches(40.0);
    assert_eq!(running.ended(Duration::from_secs(4)), None);
    control.reaches(40.0);
    running.kill();
    control.reaches(0.0);

    // The audit log has every step from the start to the end.
    let files = std::fs::read_dir(rig.dir.path().join("audit")).expect("a folder");
    let texts = files.map(|file| std::fs::read(file.expect("listed").path()).unwrap_or_default());
    let log = String::from_utf8_lossy(&texts.collect::<Vec<_>>().concat()).into_owned();
    for what in ["a map is going to be sent", "the map is in use", "the corrections are zero"] {
        assert!(log.contains(what), "{what}: {log}");
    }
}

/// When a map is replaced, the correction changes from the old to the new value at the control's rate, never through
/// zero. A map that cannot replace the active one changes nothing.
fn another_map_takes_the_place_of_the_one_in_use(rig: &mut Rig, sender: &mut Sender) {
    // The same number again, other limits, and limits of the control that are narrower than those of the file.
    write_map(rig.dir.path(), 60.0, 7);
    rig.must_replace();
    sender.refuses("found the number 7 of the map in use");
    write_map(rig.dir.path(), 60.0, 8);
    change(&rig.file, "limit_um = 100.0", "limit_um = 90.0");
    rig.must_replace();
    sender.refuses("found other keys than `map` changed");
    change(&rig.file, "limit_um = 90.0", "limit_um = 100.0");
    rig.keeps(40.0);

    rig.must_replace();
    let mut seen = Vec::new();
    until("the other map", PATIENCE, || {
        let um = rig.control.x_um();
        seen.push(um);
        (um - 30.0).abs() <= 0.5
    });
    sender.uses(8);
    seen.extend((0..100).map(|_| rig.control.x_um()));
    // The correction falls monotonically from 40 to 30 µm.
    let (least, most) = (
        seen.iter().copied().fold(f64::INFINITY, f64::min),
        seen.iter().copied().fold(0.0, f64::max),
    );
    assert!(least >= 29.0 && most <= 41.0, "{least} to {most} µm");
    assert!(seen.is_sorted_by(|was, is| is <= was), "{seen:?}");
}

/// A confirmation that arrives while another one is being rejected is processed separately.
fn a_confirmation_during_a_refusal_is_separate(rig: &mut Rig, sender: &mut Sender) {
    // A reader of this map waits until the map is written.
    let pipe = rig.dir.path().join("pipe.map");
    let made = Command::new("mkfifo").arg(&pipe).status();
    assert!(made.expect("of the system").success());
    change(&rig.file, "machine.map", "pipe.map");
    let confirmation = rig.dir.path().join("audit/confirmed-map");
    std::fs::write(&confirmation, "0123456789abcdef").expect("writable");
    until("it is taken", PATIENCE, || !confirmation.exists());
    // The sender has opened the pipe for reading, so the rejection is in progress.
    let mut bytes = std::fs::File::options().write(true).open(&pipe).expect("it is read");
    change(&rig.file, "pipe.map", "machine.map");
    write_map(rig.dir.path(), 80.0, 9);
    rig.must_replace();
    let refusals = |sender: &Sender| sender.log().matches("another map is not sent").count();
    let before = refusals(sender);
    bytes.write_all(b"no map").expect("it is read");
    drop(bytes);
    until("the refusal", PATIENCE, || refusals(sender) > before);
    sender.uses(9);
    rig.control.reaches(40.0);
}

/// While the disk hangs, the record of another map does not block the frames that keep the first map valid. The other
/// map is rejected after a timeout, and is not activated later.
fn a_disk_that_hangs_keeps_the_map_in_use(rig: &mut Rig, sender: &mut Sender) {
    rig.disk.hang();
    write_map(rig.dir.path(), 60.0, 10);
    rig.must_replace();
    until("it is given up", PATIENCE, || {
        rig.keeps(40.0);
        let why = "another map is not sent: the disk of the audit log";
        sender.log().contains(why)
    });
    let log = sender.log();
    assert!(log.contains("the map stays in use"), "{log}");
    std::fs::remove_file(&rig.disk.hangs).expect("ours");
    until("the disk is back", PATIENCE, || {
        rig.keeps(40.0);
        sender.log().contains("the audit log is written again")
    });
    // A second confirmation activates the map.
    rig.must_replace();
    rig.control.reaches(30.0);
    sender.uses(10);
}

fn others_are_refused(rig: &mut Rig) {
    let confirmed = hash(&rig.file);
    refused(&rig.file, &["--confirm", &confirmed], 1, "another gateway");
    // The second sender uses another folder, and another name for the same control.
    let other = tempfile::tempdir().expect("writable");
    let elsewhere = write(other.path(), &rig.url.replace("127.0.0.1", "localhost"), -80.0);
    let why = "another gateway on this computer uses it";
    refused(&elsewhere, &["--confirm", &hash(&elsewhere)], 1, why);
    rig.keeps(40.0);
    // The map file changed after its confirmation.
    let file = write(other.path(), &rig.url, 60.0);
    refused(&file, &["--confirm", &confirmed], 2, "expected");
}

/// A FANUC control simulated by `focas-sim`, a program of another package that was built before, and its address.
/// `None`: it was not built.
fn fanuc(listen: &str) -> Option<(Running, String, BufReader<ChildStdout>)> {
    let built = Path::new(env!("CARGO_BIN_EXE_volcomp-gateway")).with_file_name("focas-sim");
    if !built.exists() {
        peers::not_run("focas-sim (cargo build -p focas-sim)");
        return None;
    }
    let options = "--map-words 700 --json --machine-number 1002 --limit-um 100 --scan-ms 10 --rate-um-per-s 200 --hold-ms 800 --time-out-ms 2000";
    let mut command = Command::new(built);
    command.arg("--listen").args(listen.split_whitespace()).args(options.split_whitespace());
    let (control, line, lines) = Running::start_and_hear(command.stdin(Stdio::piped()));
    let address = line.strip_prefix("listening on ").expect("an address").to_owned();
    Some((control, address, lines))
}

/// The sender of a FANUC control at this address.
fn write_for_fanuc(dir: &Path, address: &str) -> PathBuf {
    let file = write(dir, &format!("focas://{address}"), 80.0);
    change(&file, "[sinumerik]\ntime_out_ms = 2000.0\n", "[pmc]\ntime_out_ms = 2000.0\n");
    file
}

/// The axes move, so that the corrections of the first sender never stand still. A second one, as of another computer,
/// ends nevertheless.
#[test]
fn a_second_sender_ends_while_the_first_one_corrects() {
    let Some((_control, address, _)) = fanuc("0.0.0.0:0 --stroke-mm 400 --period-s 4") else {
        return;
    };
    let dirs = [(); 2].map(|()| tempfile::tempdir().expect("writable"));
    // Different addresses of this computer have different locks.
    let [first, second] = ["127.0.0.1", "127.0.0.2"].map(|host| address.replace("0.0.0.0", host));
    let file = write_for_fanuc(dirs[0].path(), &first);
    let Some(disk) = Disk::new(dirs[0].path()) else {
        return;
    };
    let sender = Sender::start(&file, dirs[0].path(), 7, &disk);
    let file = write_for_fanuc(dirs[1].path(), &second);
    let mut command = command(&file, &["--confirm", &hash(&file)]);
    let log = dirs[1].path().join("second.log");
    let errors = std::fs::File::create(&log).expect("writable");
    let mut running = Running::start(command.stderr(errors));
    let ended = running.ended(PATIENCE);
    let log = std::fs::read_to_string(log).expect("a log");
    assert_eq!(ended.and_then(|status| status.code()), Some(1), "{log}");
    assert!(log.contains("another sender") && log.contains("holds the control"), "{log}");
    sender.stop();
}

/// The same test with the PMC of a FANUC control. On a hanging disk the sender also ends properly, and reports the missing records.
#[test]
fn a_fanuc_control_looks_up_as_well() {
    let Some((mut control, address, mut lines)) = fanuc("127.0.0.1:0 --at X=500") else {
        return;
    };
    let mut x_um = || {
        writeln!(control.stdin.as_mut().expect("piped"), "report").expect("it runs");
        let mut line = String::new();
        lines.read_line(&mut line).expect("a line");
        let report: Value = serde_json::from_str(&line).expect("JSON");
        report["correction_um"]["X"].as_f64().expect("a number")
    };
    let dir = tempfile::tempdir().expect("writable");
    let file = write_for_fanuc(dir.path(), &address);
    let Some(disk) = Disk::new(dir.path()) else {
        return;
    };
    let sender = Sender::start(&file, dir.path(), 7, &disk);
    until("the correction", PATIENCE, || (x_um() - 40.0).abs() <= 1.0);
    disk.hang();
    let log = sender.stop();
    assert_eq!(x_um(), 0.0);
    assert!(log.contains("the last records are lost"), "{log}");
}

#[test]
fn files_of_a_sender_that_are_wrong() {
    let dir = tempfile::tempdir().expect("writable");
    for [url, from, to, words] in rows(
        r#"
modbus://127.0.0.1 |  |  | expected opc.tcp://HOST:4840 (SINUMERIK) or focas://HOST:8193 (FANUC)
focas://127.0.0.1 |  |  | expected it only for opc.tcp://
opc.tcp://127.0.0.1 | [sinumerik]\ntime_out_ms | [pmc]\ntime_out_ms | expected it only for focas://
focas://127.0.0.1 | [sinumerik]\ntime_out_ms = 2000.0 | [pmc]\nreport = { pmc = "D", at = 100 } | mailbox and report
focas://127.0.0.1 | [sinumerik]\ntime_out_ms = 2000.0 | [pmc]\nbuffers = { pmc = "D", at = 64000 } | byte 65535
focas://127.0.0.1 | [sinumerik]\ntime_out_ms = 2000.0 | [pmc]\nmailbox = { pmc = "G", at = 0 } | expected R or D
"#,
    ) {
        let file = write(dir.path(), url, 80.0);
        if !from.is_empty() {
            change(&file, from, to);
        }
        refuses(&file, words);
    }
}

/// Checks that a configuration is rejected with the message `words` before any device is opened.
fn refuses(file: &Path, words: &str) {
    let error = send_map::check(file).expect_err(words);
    assert_eq!(error.status(), 2, "{error}");
    assert!(error.to_string().contains(words), "{words}: {error}");
}

#[test]
fn a_map_beyond_the_limits_is_refused_before_anything_is_opened() {
    let dir = tempfile::tempdir().expect("writable");
    let file = write(dir.path(), "opc.tcp://127.0.0.1:1", 130.0);
    refuses(&file, "100");
}
