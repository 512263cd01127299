//! The audit log: its chain, its files, and full or hanging disks. Neither disarming nor stopping waits for the disk.

use std::{
    io::Write,
    path::{Path, PathBuf},
    process::Command,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_gateway::{
    audit::{
        AuditLog, Entry, last_records, log_file, log_files, verify,
        writer::{AuditWriter, Receipt},
    },
    documents::{ByAxis, Details, Event},
    request::Operation,
};
use volcomp_test_support::{corpus, peers};
use volcomp_vocabulary::PerChannel;

use crate::{
    manual::{Gateway, configuration, controlled_configuration},
    models::{activate, candidate, engineers, machine_file, model, wait_model, with_y},
    program::{PATIENCE, Program, change, path},
    standing::SmallDisk,
};

fn details(what: &str) -> Details {
    Details {
        model: "none".to_owned(),
        output_um: ByAxis::new(),
        output_urad: ByAxis::new(),
        what: Event::Refused(what.to_owned()),
    }
}

/// Reading a pipe without a writer would never return, so the gateway would neither start nor report a reason.
#[test]
fn a_pipe_in_the_folder_is_refused() {
    for name in ["audit.log", "standing.slots", "output.json"] {
        let dir = tempfile::tempdir().expect("writable");
        let made = std::process::Command::new("mkfifo").arg(dir.path().join(name)).status();
        assert!(made.expect("of the system").success());
        let refused = AuditLog::open(dir.path()).err().expect("a pipe").to_string();
        assert!(refused.contains(name) && refused.contains("named pipe"), "{refused}");
    }
}

#[test]
fn the_chain_goes_on_from_file_to_file_and_the_oldest_goes() {
    let dir = tempfile::tempdir().expect("writable");
    let (log, found) = AuditLog::open(dir.path()).expect("new");
    assert_eq!((found.records, found.cut_bytes), (0, 0));
    let mut log = log.rotating_at(1000);
    for number in 0..60 {
        log.append("anna", "test", details(&number.to_string())).expect("room");
    }
    let mut files: Vec<_> = std::fs::read_dir(dir.path())
        .expect("readable")
        .map(|entry| entry.expect("readable").file_name())
        .collect();
    files.sort();
    assert_eq!(files.len(), 9, "{files:?}");
    let read = |name: &str| std::fs::read_to_string(dir.path().join(name)).expect("readable");
    // The rotated files, oldest first, form one hash chain.
    let names: Vec<String> =
        (1..=8).rev().map(|n| format!("audit.{n}.log")).chain(["audit.log".to_owned()]).collect();
    let all: String = names.iter().map(|name| read(name)).collect();
    let whole = verify(all.as_bytes());
    assert_eq!((whole.end, whole.broken), (all.len(), None));
    assert!(all.contains("\"what\":\"59\"") && !all.contains("\"what\":\"0\""));
    // A reopened log continues with the next number.
    drop(log);
    let (mut log, found) = AuditLog::open(dir.path()).expect("there");
    assert_eq!((found.cut_bytes, found.broken), (0, None));
    log.append("anna", "again", details("")).expect("room");
    assert!(read("audit.log").contains("\"seq\":61"));
    // The last records are returned newest first, across files. An invalid line is omitted.
    let mut file = std::fs::OpenOptions::new();
    let file = file.append(true).open(log_file(dir.path()));
    file.and_then(|mut file| file.write_all(b"no record\n")).expect("writable");
    let seqs = |count| {
        let last = last_records(dir.path(), count).expect("readable");
        last.iter().map(|record| record.seq).collect::<Vec<_>>()
    };
    assert_eq!(seqs(12), (50..=61).rev().collect::<Vec<_>>());
    let kept = whole.records + 1;
    let oldest = 61 - kept + 1;
    assert_eq!(seqs(usize::MAX), (oldest..=61).rev().collect::<Vec<_>>());
    assert!(seqs(0).is_empty());
    let missing = dir.path().join("none");
    assert_eq!(last_records(&missing, 5).map(|last| last.len()).ok(), Some(0));
}

fn whole_log(dir: &Path) -> String {
    let read = |path| std::fs::read_to_string(path).expect("readable");
    log_files(dir).into_iter().map(read).collect()
}

/// While the next file cannot be created, no record is lost, however often a rotation is attempted. The log continues
/// once there is space.
#[test]
fn a_log_that_cannot_be_rotated_loses_nothing() {
    let dir = tempfile::tempdir().expect("writable");
    let folder = dir.path().join("audit");
    let Some(_disk) = SmallDisk::at(folder.clone()) else {
        return;
    };
    let remounted = std::process::Command::new("mount")
        .args(["-o", "remount,nr_inodes=40"])
        .arg(&folder)
        .status();
    assert!(remounted.is_ok_and(|status| status.success()));
    let (log, _) = AuditLog::open(&folder).expect("new");
    let mut log = log.rotating_at(1000);
    let mut record = 0;
    let mut append = || {
        record += 1;
        log.append("anna", "test", details(&record.to_string()))
    };
    while log_files(&folder).len() < 9 {
        append().expect("room");
    }
    let filler = |n: usize| folder.join(format!("filler{n}"));
    let full = (0..100_000).find(|n| std::fs::File::create(filler(*n)).is_err());
    while append().is_ok() {}
    let before = whole_log(&folder);
    for _ in 0..20 {
        assert!(append().is_err());
        assert!(whole_log(&folder) == before);
    }
    (0..full.expect("full")).for_each(|n| std::fs::remove_file(filler(n)).expect("there"));
    append().expect("room");
    let after = whole_log(&folder);
    let found = verify(after.as_bytes());
    assert_eq!((found.end, found.broken), (after.len(), None));
    // Only the oldest file was removed.
    let [before, after] = [before, after].map(|log| log.lines().count());
    assert!(after > before * 3 / 4, "{before} {after}");
}

/// A rotation was interrupted before the current file was renamed, or before the next one was created. The next
/// rotation completes it.
#[test]
fn a_rotation_that_was_broken_off_is_completed() {
    for is_current_renamed in [false, true] {
        let dir = tempfile::tempdir().expect("writable");
        let (log, _) = AuditLog::open(dir.path()).expect("new");
        let mut log = log.rotating_at(1000);
        let mut append_until = |files: usize| {
            while log_files(dir.path()).len() != files {
                log.append("anna", "test", details("")).expect("room");
            }
        };
        append_until(8);
        let path = |n: usize| dir.path().join(format!("audit.{n}.log"));
        for n in (1..=7).rev() {
            std::fs::rename(path(n), path(n + 1)).expect("there");
        }
        if is_current_renamed {
            std::fs::rename(dir.path().join("audit.log"), path(1)).expect("there");
        }
        let before = whole_log(dir.path());
        append_until(9);
        assert!(whole_log(dir.path()).starts_with(&before), "{is_current_renamed}");
    }
}

/// The current file is moved away while the gateway runs. The next record starts a new file, and the chain continues.
#[test]
fn a_log_that_is_moved_away_is_continued() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut log, _) = AuditLog::open(dir.path()).expect("new");
    log.append("anna", "first", details("")).expect("room");
    let moved = dir.path().join("kept.log");
    std::fs::rename(dir.path().join("audit.log"), &moved).expect("there");
    log.append("anna", "second", details("")).expect("room");
    let chain = || std::fs::read_to_string(&moved).expect("there") + &whole_log(dir.path());
    let whole = chain();
    let found = verify(whole.as_bytes());
    assert_eq!((found.records, found.broken), (2, None), "{whole}");
}

/// The program ends after a rotation, before the first record of the new file.
#[test]
fn an_empty_file_continues_the_one_before() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut log, _) = AuditLog::open(dir.path()).expect("new");
    log.append("anna", "first", details("")).expect("room");
    let path = |name: &str| dir.path().join(name);
    std::fs::rename(path("audit.log"), path("audit.1.log")).expect("there");
    std::fs::write(path("audit.log"), "").expect("writable");
    let (mut log, _) = AuditLog::open(dir.path()).expect("there");
    log.append("anna", "second", details("")).expect("room");
    let whole = whole_log(dir.path());
    let found = verify(whole.as_bytes());
    assert_eq!((found.records, found.broken), (2, None), "{whole}");
    assert!(whole.contains("\"seq\":2"), "{whole}");
}

/// The log is truncated at every byte of its last record. Complete records are kept, the partial one is removed, and
/// the log continues.
#[test]
fn a_tail_torn_anywhere_is_cut() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut log, _) = AuditLog::open(dir.path()).expect("new");
    for number in 0..3 {
        log.append("anna", "test", details(&number.to_string())).expect("room");
    }
    drop(log);
    let path = dir.path().join("audit.log");
    let text = std::fs::read(&path).expect("readable");
    let second = text
        .iter()
        .enumerate()
        .filter(|(_, byte)| **byte == b'\n')
        .map(|(at, _)| at + 1)
        .nth(1)
        .expect("lines");
    for length in second..text.len() {
        std::fs::write(&path, &text[..length]).expect("writable");
        let (mut log, found) = AuditLog::open(dir.path()).expect("there");
        assert_eq!(
            (found.records, found.cut_bytes, found.broken),
            (2, (length - second) as u64, None)
        );
        log.append("anna", "after", details("")).expect("room");
        let again = std::fs::read(&path).expect("readable");
        assert_eq!(verify(&again).records, 3);
        assert_eq!(verify(&again).end, again.len());
    }
}

/// A simulated disk. It hangs while `hangs` is set. `waits` is set while a record waits for the disk.
#[derive(Clone, Default)]
struct Disk {
    hangs: Arc<AtomicBool>,
    waits: Arc<AtomicBool>,
}

impl Disk {
    fn hang(&self, hangs: bool) {
        self.hangs.store(hangs, Ordering::Relaxed);
    }

    fn has_a_record(&self) -> bool {
        self.waits.load(Ordering::Relaxed)
    }
}

fn hanging(dir: &Path) -> (AuditWriter, Disk) {
    let disk = Disk::default();
    let (log, _) = AuditLog::open(dir).expect("new");
    let of_log = disk.clone();
    let log = log.synced_by(move |file| {
        while of_log.hangs.load(Ordering::Relaxed) {
            of_log.waits.store(true, Ordering::Relaxed);
            std::thread::sleep(Duration::from_millis(1));
        }
        of_log.waits.store(false, Ordering::Relaxed);
        file.sync_data()
    });
    (AuditWriter::start(log, volcomp_port::Clock::system()).expect("a thread"), disk)
}

fn entry(what: &str) -> Entry {
    Entry::new("anna", "test", details(what))
}

fn soon(done: impl Fn() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !done() {
        assert!(Instant::now() < end, "it does not come");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// While the disk hangs, queuing a record does not block. Records that do not fit into the queue are lost; the next
/// record states their number.
#[test]
fn a_hanging_disk_blocks_no_caller_and_lost_records_are_counted() {
    let dir = tempfile::tempdir().expect("writable");
    let (writer, disk) = hanging(dir.path());
    let first = writer.record(entry("first"));
    soon(|| first.written() == Some(true));
    assert_eq!(writer.trouble(), None);
    disk.hang(true);
    let at_hand = writer.record(entry("at hand"));
    soon(|| disk.has_a_record());
    let receipts: Vec<Receipt> = (0..400).map(|n| writer.record(entry(&n.to_string()))).collect();
    // 256 records are queued behind the record that waits for the disk.
    let lost = receipts.iter().filter(|r| r.written() == Some(false)).count();
    assert_eq!(lost, 400 - 256);
    assert_eq!(at_hand.written(), None);
    assert_eq!(writer.trouble(), Some("records of the audit log were lost"));
    assert!(!writer.settle(Duration::from_millis(20)), "the end does not wait for ever");
    disk.hang(false);
    assert!(writer.settle(PATIENCE));
    assert_eq!(writer.trouble(), None);
    let text = std::fs::read_to_string(dir.path().join("audit.log")).expect("readable");
    assert_eq!(verify(text.as_bytes()).end, text.len());
    assert_eq!(text.matches(&format!("\"lost\":{lost}")).count(), 1);
    assert_eq!(text.matches("\"lost\":").count(), 1);
}

/// A record that is pending for more than one second forbids arming.
#[test]
fn a_silent_disk_is_reported() {
    let dir = tempfile::tempdir().expect("writable");
    let (writer, disk) = hanging(dir.path());
    disk.hang(true);
    let receipt = writer.record(entry("waits"));
    soon(|| writer.trouble() == Some("the disk of the audit log does not answer"));
    assert_eq!(receipt.written(), None);
    disk.hang(false);
    soon(|| receipt.written() == Some(true));
    soon(|| writer.trouble().is_none());
}

#[test]
fn a_record_that_fails_is_counted_in_the_next() {
    let dir = tempfile::tempdir().expect("writable");
    let (log, _) = AuditLog::open(dir.path()).expect("new");
    let mut failures = 3;
    let log = log.synced_by(move |file| {
        failures -= 1;
        if failures >= 0 {
            return Err(std::io::Error::other("full"));
        }
        file.sync_data()
    });
    let clock = volcomp_port::Clock::manual();
    let mut writer = AuditWriter::start(log, clock.clone()).expect("a thread");
    for what in ["one", "two"] {
        let receipt = writer.record(entry(what));
        soon(|| receipt.written() == Some(false));
    }
    assert_eq!(writer.trouble(), Some("the audit log cannot be written"));
    // The first retry fails as well and does not count as a loss.
    for _ in 0..2 {
        assert!(writer.settle(PATIENCE));
        writer.retry(|| panic!("too soon"));
        clock.advance(Duration::from_millis(101));
        writer.retry(|| entry("again"));
        assert!(writer.settle(PATIENCE));
    }
    assert_eq!(writer.trouble(), None);
    let text = std::fs::read_to_string(dir.path().join("audit.log")).expect("readable");
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(text.contains("\"lost\":2,"), "{text}");
}

/// Result of the check of the log at start-up, from the last `start` record.
fn found(log: &str) -> Value {
    let line = log.lines().rfind(|line| line.contains("\"started\""));
    let (_, record) = line.and_then(|line| line.split_once(' ')).expect("a start");
    let record: Value = serde_json::from_str(record).expect("JSON");
    record["details"]["what"].clone()
}

#[test]
fn a_torn_log_is_cut_and_a_forged_one_put_aside() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let log = dir.path().join("audit/audit.log");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    let rig = gateway.stop();
    let whole = std::fs::read_to_string(&log).expect("a log");
    let torn = &whole[..whole.len() - 40];
    std::fs::write(&log, torn).expect("writable");
    let gateway = Gateway::again(rig, &config);
    let again = gateway.audit();
    let kept = &whole[..=torn.rfind('\n').expect("lines")];
    assert!(again.starts_with(kept) && again.len() > kept.len());
    assert_eq!(found(&again)["cut_bytes"], torn.len() - kept.len());
    let rig = gateway.stop();
    let text = std::fs::read_to_string(&log).expect("a log");
    let forged = text.replacen("\"who\":\"auto_arm\"", "\"who\":\"nobody\"", 1);
    assert_ne!(forged, text);
    std::fs::write(&log, forged).expect("writable");
    let gateway = Gateway::again(rig, &config);
    let aside = dir.path().join("audit/audit.broken-1.log");
    assert!(aside.exists());
    let broken = found(&gateway.audit())["broken"].clone();
    assert_eq!(broken["aside"], json!(aside.display().to_string()));
    assert!(broken["line"].as_u64() > Some(0), "{broken}");
}

#[test]
fn a_full_disk_forbids_arming_but_not_correcting_nor_disarming() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(disk) = SmallDisk::at(dir.path().join("audit")) else {
        return;
    };
    let config = configuration(dir.path(), "auto_arm = true");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    disk.fill(0);
    gateway.run(Duration::from_secs(30));
    assert_eq!(gateway.state()["state"], "compensating");
    // Records are accepted until the last block is full.
    let mut refused = None;
    for _ in 0..50 {
        assert_eq!(gateway.ask(Operation::Disarm).0, 200);
        gateway.wait_for("disarmed");
        assert_eq!(gateway.shifts(), PerChannel::ZERO);
        let (status, answer) = gateway.ask(Operation::Arm(None));
        if status != 200 {
            refused = Some((status, answer));
            break;
        }
    }
    let (status, answer) = refused.expect("the log is full by now");
    assert_eq!(status, 409, "{answer}");
    let words = "audit log cannot be written";
    assert!(answer.to_string().contains(words), "{answer}");
    assert_eq!(gateway.state()["state"], "disarmed");
    // The records before the block that was refused are complete.
    drop(gateway);
    let (_, found) = AuditLog::open(&disk.0).expect("readable");
    assert_eq!((found.cut_bytes, found.broken), (0, None));
}

/// Replays the stored inputs of the fuzz target.
#[test]
fn audit_logs() {
    corpus::replay("audit", |_, bytes| {
        let found = verify(bytes);
        assert_eq!(verify(&bytes[..found.end]).records, found.records);
        let is_whole = found.broken.is_none() && found.end == bytes.len();
        is_whole.then_some(()).ok_or(found.end)
    });
}

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
        let config = controlled_configuration(dir.path(), &control, "auto_arm = true");
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
