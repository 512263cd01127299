//! Messages that wait for the server.

use std::path::Path;

use volcomp_fleet::{Kind, Lane, Spool, SpoolLimits, Waiting};

fn message(kind: Kind, number: usize, length: usize) -> Waiting {
    Waiting {
        kind,
        id: format!("{}-{number}", kind.name()),
        bytes: vec![u8::try_from(number % 251).unwrap(); length],
    }
}

fn fill(spool: &mut Spool, kind: Kind, numbers: std::ops::Range<usize>) {
    for number in numbers {
        spool.push(message(kind, number, 100));
    }
}

fn conditions(numbers: std::ops::RangeInclusive<usize>) -> Vec<String> {
    numbers.map(|number| format!("condition-{number}")).collect()
}

fn open(folder: &Path) -> Spool {
    Spool::open(folder, SpoolLimits::default()).unwrap()
}

fn all(spool: &mut Spool) -> Vec<String> {
    let mut ids = Vec::new();
    for lane in [Lane::Kept, Lane::Passing] {
        while let Some(message) = spool.first(lane) {
            ids.push(message.id.clone());
            spool.done(lane);
        }
    }
    ids
}

fn files(folder: &Path) -> usize {
    let count = |lane: &str| std::fs::read_dir(folder.join(lane)).unwrap().count();
    count("kept") + count("passing")
}

#[test]
fn messages_are_sent_once_and_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let mut spool = open(folder.path());
    for number in 0..500 {
        spool.push(message(Kind::Condition, number, 100));
        if number % 100 == 0 {
            spool.push(message(Kind::Audit, number, 100));
        }
    }
    assert!(files(folder.path()) > 0, "more waits than memory holds");
    let kept = (0..5).map(|number| format!("audit-{}", number * 100));
    let expected: Vec<String> = kept.chain(conditions(0..=499)).collect();
    assert_eq!(all(&mut spool), expected);
    assert_eq!((spool.dropped(), files(folder.path())), (0, 0));
}

#[test]
fn a_message_stays_until_it_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let mut spool = open(folder.path());
    spool.push(message(Kind::Condition, 1, 10));
    spool.push(message(Kind::Audit, 1, 10));
    // The two lanes do not wait for each other.
    for _ in 0..2 {
        assert_eq!(spool.first(Lane::Kept).unwrap().id, "audit-1");
        assert_eq!(spool.first(Lane::Passing).unwrap().id, "condition-1");
    }
    spool.done(Lane::Passing);
    assert_eq!(all(&mut spool), ["audit-1"]);
}

#[test]
fn a_reachable_server_causes_no_disk_write() {
    let folder = tempfile::tempdir().unwrap();
    let mut spool = open(folder.path());
    for number in 0..1000 {
        spool.push(message(Kind::Condition, number, 100));
        assert_eq!(spool.first(Lane::Passing).unwrap().id, format!("condition-{number}"));
        spool.done(Lane::Passing);
        assert_eq!(files(folder.path()), 0);
    }
}

#[test]
fn flushed_messages_survive_and_done_ones_do_not_return() {
    let folder = tempfile::tempdir().unwrap();
    let mut spool = open(folder.path());
    fill(&mut spool, Kind::Condition, 0..300);
    spool.flush();
    let mut spool = open(folder.path());
    let first = spool.first(Lane::Passing).unwrap().id.clone();
    assert_eq!(first, "condition-0");
    assert_eq!(all(&mut spool).len(), 300);
    assert_eq!(all(&mut open(folder.path())), [""; 0]);
}

/// A program that is killed while it sends a file sends that file again. No message is lost, and ids identify
/// duplicates.
#[test]
fn a_crash_loses_no_message_on_disk() {
    let folder = tempfile::tempdir().unwrap();
    let mut spool = open(folder.path());
    fill(&mut spool, Kind::Condition, 0..300);
    spool.flush();
    for _ in 0..10 {
        assert!(spool.first(Lane::Passing).is_some());
        spool.done(Lane::Passing);
    }
    drop(spool);
    let again = all(&mut open(folder.path()));
    let expected = conditions(10..=299);
    assert_eq!(again[again.len() - expected.len()..], expected[..]);
}

#[test]
fn the_oldest_telemetry_is_dropped_and_no_audit_record() {
    let folder = tempfile::tempdir().unwrap();
    let limits = SpoolLimits { kept_bytes: 1 << 20, passing_bytes: 64 << 10 };
    let mut spool = Spool::open(folder.path(), limits).unwrap();
    fill(&mut spool, Kind::Audit, 0..20);
    fill(&mut spool, Kind::Condition, 0..5000);
    spool.flush();
    let on_disk: u64 = std::fs::read_dir(folder.path().join("passing"))
        .unwrap()
        .map(|entry| entry.unwrap().metadata().unwrap().len())
        .sum();
    assert!(on_disk <= limits.passing_bytes, "{on_disk}");
    let ids = all(&mut spool);
    assert_eq!(ids.iter().filter(|id| id.starts_with("audit")).count(), 20);
    assert_eq!(ids.last().unwrap(), "condition-4999", "the newest stay");
    let left = ids.len() - 20;
    assert_eq!(spool.dropped(), 5000 - left as u64, "every one is counted");
}

/// If the folder rejects files, as on a full disk, a bounded number of messages waits in memory; the error and the
/// dropped messages are reported.
#[test]
fn a_failing_disk_is_reported_and_sending_continues() {
    let folder = tempfile::tempdir().unwrap();
    let mut spool = open(folder.path());
    let lane = folder.path().join("passing");
    std::fs::remove_dir(&lane).unwrap();
    fill(&mut spool, Kind::Condition, 0..3000);
    assert!(spool.trouble().is_some());
    assert!(spool.dropped() > 0);
    std::fs::create_dir(&lane).unwrap();
    spool.push(message(Kind::Condition, 3000, 100));
    assert_eq!(spool.trouble(), None);
    let dropped = usize::try_from(spool.dropped()).unwrap();
    assert_eq!(all(&mut spool), conditions(dropped..=3000));
}

/// Messages on a temporarily unreadable disk (unmounted, read error, no free descriptor) are sent later.
#[test]
fn a_temporary_read_failure_loses_no_message() {
    let folder = tempfile::tempdir().unwrap();
    let [place, away] = ["spool", "away"].map(|name| folder.path().join(name));
    let mut spool = open(&place);
    fill(&mut spool, Kind::Ack, 0..500);
    std::fs::rename(&place, &away).unwrap();
    assert!(spool.first(Lane::Kept).is_some(), "what is in memory comes");
    assert!(spool.trouble().is_some());
    std::fs::rename(&away, &place).unwrap();
    assert_eq!((all(&mut spool).len(), spool.dropped()), (500, 0));
    assert_eq!(spool.trouble(), None);
}

#[test]
fn messages_lost_with_a_damaged_file_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut spool = open(folder.path());
    fill(&mut spool, Kind::Ack, 0..500);
    spool.flush();
    drop(spool);
    let kept = std::fs::read_dir(folder.path().join("kept")).unwrap();
    let mut files: Vec<_> = kept.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let mut bytes = std::fs::read(&files[0]).unwrap();
    bytes[20] ^= 1;
    std::fs::write(&files[0], bytes).unwrap();
    let mut spool = open(folder.path());
    let came = all(&mut spool).len();
    assert!(came < 500);
    assert_eq!(came as u64 + spool.dropped(), 500, "{came} came");
}
