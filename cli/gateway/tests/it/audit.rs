//! The audit log by itself.

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_gateway::{
    audit::{
        AuditLog, Entry,
        clerk::{Clerk, Receipt},
        verify,
    },
    documents::{ByAxis, Details, Event},
};

use crate::program::PATIENCE;

/// What belongs to a record of these tests.
fn details(what: &str) -> Details {
    Details {
        model: "none".to_owned(),
        output_um: ByAxis::new(),
        output_urad: ByAxis::new(),
        what: Event::Refused(what.to_owned()),
    }
}

#[test]
fn the_chain_goes_on_from_file_to_file_and_the_oldest_goes() {
    let dir = tempfile::tempdir().expect("writable");
    let (log, found) = AuditLog::open(dir.path()).expect("new");
    assert_eq!((found.records, found.cut_bytes), (0, 0));
    let mut log = log.rotating_at(1000);
    for number in 0..60 {
        log.append("anna", "test", details(&number.to_string()))
            .expect("room");
    }
    let mut files: Vec<_> = std::fs::read_dir(dir.path())
        .expect("readable")
        .map(|entry| entry.expect("readable").file_name())
        .collect();
    files.sort();
    assert_eq!(files.len(), 9, "{files:?}");
    let read = |name: &str| std::fs::read_to_string(dir.path().join(name)).expect("readable");
    // Oldest first: one chain.
    let names: Vec<String> = (1..=8)
        .rev()
        .map(|n| format!("audit.{n}.log"))
        .chain(["audit.log".to_owned()])
        .collect();
    let all: String = names.iter().map(|name| read(name)).collect();
    let whole = verify(all.as_bytes());
    assert_eq!((whole.end, whole.broken), (all.len(), None));
    assert!(all.contains("\"what\":\"59\"") && !all.contains("\"what\":\"0\""));
    // Opened again it goes on with the next number.
    drop(log);
    let (mut log, found) = AuditLog::open(dir.path()).expect("there");
    assert_eq!((found.cut_bytes, found.broken), (0, None));
    log.append("anna", "again", details("")).expect("room");
    assert!(read("audit.log").contains("\"seq\":61"));
}

/// Cut at every byte: what is whole is kept, the rest is cut, and it goes on.
#[test]
fn a_tail_torn_anywhere_is_cut() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut log, _) = AuditLog::open(dir.path()).expect("new");
    for number in 0..3 {
        log.append("anna", "test", details(&number.to_string()))
            .expect("room");
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

/// A disk that hangs while the first switch is on; the second one is on while a record waits for it.
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

/// A log on such a disk.
fn hanging(dir: &Path) -> (Clerk, Disk) {
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
    (
        Clerk::start(log, volcomp_port::Clock::system()).expect("a thread"),
        disk,
    )
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

/// Handing a record over waits for no disk. What finds no place is told, and counted in the next record.
#[test]
fn a_disk_that_hangs_holds_up_nobody_and_lost_records_are_counted() {
    let dir = tempfile::tempdir().expect("writable");
    let (clerk, disk) = hanging(dir.path());
    let first = clerk.record(entry("first"));
    soon(|| first.written() == Some(true));
    assert_eq!(clerk.trouble(), None);
    disk.hang(true);
    let at_hand = clerk.record(entry("at hand"));
    soon(|| disk.has_a_record());
    let receipts: Vec<Receipt> = (0..400)
        .map(|n| clerk.record(entry(&n.to_string())))
        .collect();
    // The disk has the one before, 256 wait.
    let lost = receipts
        .iter()
        .filter(|r| r.written() == Some(false))
        .count();
    assert_eq!(lost, 400 - 256);
    assert_eq!(at_hand.written(), None);
    assert_eq!(clerk.trouble(), Some("records of the audit log were lost"));
    assert!(
        !clerk.settle(Duration::from_millis(20)),
        "the end does not wait for ever"
    );
    disk.hang(false);
    assert!(clerk.settle(PATIENCE));
    assert_eq!(clerk.trouble(), None);
    let text = std::fs::read_to_string(dir.path().join("audit.log")).expect("readable");
    assert_eq!(verify(text.as_bytes()).end, text.len());
    assert_eq!(text.matches(&format!("\"lost\":{lost}")).count(), 1);
    assert_eq!(text.matches("\"lost\":").count(), 1);
}

/// A record on its way for longer than a second forbids arming.
#[test]
fn a_disk_that_does_not_answer_is_told() {
    let dir = tempfile::tempdir().expect("writable");
    let (clerk, disk) = hanging(dir.path());
    disk.hang(true);
    let receipt = clerk.record(entry("waits"));
    soon(|| clerk.trouble() == Some("the disk of the audit log does not answer"));
    assert_eq!(receipt.written(), None);
    disk.hang(false);
    soon(|| receipt.written() == Some(true));
    soon(|| clerk.trouble().is_none());
}

/// A record that cannot be written is counted in the first that can.
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
    let mut clerk = Clerk::start(log, clock.clone()).expect("a thread");
    for what in ["one", "two"] {
        let receipt = clerk.record(entry(what));
        soon(|| receipt.written() == Some(false));
    }
    assert_eq!(clerk.trouble(), Some("the audit log cannot be written"));
    // The first try fails, too, and is no loss of its own.
    for _ in 0..2 {
        assert!(clerk.settle(PATIENCE));
        clerk.try_again(|| panic!("too soon"));
        clock.advance(Duration::from_millis(101));
        clerk.try_again(|| entry("again"));
        assert!(clerk.settle(PATIENCE));
    }
    assert_eq!(clerk.trouble(), None);
    let text = std::fs::read_to_string(dir.path().join("audit.log")).expect("readable");
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(text.contains("\"lost\":2,"), "{text}");
}
