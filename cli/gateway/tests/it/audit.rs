//! The audit log by itself.

use volcomp_gateway::{
    audit::{AuditLog, verify},
    documents::{Details, Event},
};

/// What belongs to a record of these tests.
fn details(what: &str) -> Details {
    Details {
        model: "none".to_owned(),
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
