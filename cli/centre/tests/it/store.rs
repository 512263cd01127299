use std::time::Duration;

use serde_json::json;
use volcomp_centre::{
    Error,
    ingest::Ingest,
    records::Resolution,
    rollout::{Rules, UserRequest},
    store::{Retention, Store},
    users::{BootTime, Role, Session, Token, UserName},
};
use volcomp_fleet::{Kind, MachineId, Received};

use crate::support::{condition, envelope, identity, machine, model, model_text, received};

/// A database file, opened several times as by several programs.
struct DatabaseFile(tempfile::TempDir);

impl DatabaseFile {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn open(&self) -> Result<Store, Error> {
        Store::open(&self.0.path().join("centre.db"))
    }

    /// Executes a statement on a separate connection, as another program would.
    fn execute(&self, sql: &str) {
        let other = rusqlite::Connection::open(self.0.path().join("centre.db")).unwrap();
        other.execute(sql, []).unwrap();
    }
}

fn opened() -> (DatabaseFile, Store) {
    let place = DatabaseFile::new();
    let store = place.open().unwrap();
    (place, store)
}

fn mill() -> MachineId {
    identity("mill-a").machine
}

/// One condition per second from `from_s` on. The residual of each condition, µm, is its number.
fn conditions(numbers: std::ops::Range<u64>, from_s: f64) -> Vec<Received> {
    let one = |number: u64| {
        let envelope = envelope("run-1", number, condition(number as f64));
        let at_s = from_s + number as f64;
        received("mill-a", Kind::Condition, number + 1, at_s, &envelope)
    };
    numbers.map(one).collect()
}

#[test]
fn changes_of_machines_and_models_are_logged() {
    let (place, store) = opened();
    let mut mill = machine("mill-a");
    store.put_machine(&mill, "anna").unwrap();
    mill.canary = true;
    store.put_machine(&mill, "bert").unwrap();
    assert_eq!(store.machines().unwrap(), [mill.clone()]);
    let new = model(7);
    assert!(store.add_model(&new.model, &new.text).unwrap());
    assert!(!store.add_model(&new.model, &new.text).unwrap(), "once");
    assert_eq!(store.model(&new.model.sha256[..8]).unwrap(), Some(new.model.clone()));
    assert_eq!(store.model_text(&new.model.sha256).unwrap(), Some(model_text(7)));
    assert_eq!(store.model("").unwrap(), None);
    assert_eq!(store.model("%").unwrap(), None);
    let other = place.open().unwrap();
    assert!(other.remove_machine(&mill.identity.machine, "carl").unwrap());
    assert!(store.machines().unwrap().is_empty());
    let log = store.audit_records(None, 10).unwrap();
    let reported: Vec<(&str, &str)> =
        log.iter().map(|record| (record.by.as_str(), record.action.as_str())).collect();
    assert_eq!(
        reported,
        [
            ("carl", "machine.remove"),
            ("anna", "model.add"),
            ("bert", "machine.put"),
            ("anna", "machine.put"),
        ]
    );
    assert_eq!(store.broken_audit().unwrap(), None);
}

/// Another reader, such as a viewer or a backup, does not remove the centre's write-ahead log.
#[test]
fn a_concurrent_reader_loses_no_rows() {
    let (place, store) = opened();
    store.put_machine(&machine("mill-a"), "anna").unwrap();
    let file = place.0.path().join("centre.db");
    let read = "import sqlite3, sys; d = sqlite3.connect(sys.argv[1]); print(d.execute('SELECT count(*) FROM machines').fetchone()[0]); d.close()";
    let output = std::process::Command::new("python3").args(["-c", read]).arg(&file).output();
    let output = output.unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stdout), "1\n", "{output:?}");
    assert!(place.0.path().join("centre.db-wal").exists());
    store.put_machine(&machine("mill-b"), "anna").unwrap();
    assert_eq!(place.open().unwrap().machines().unwrap().len(), 2);
}

#[test]
fn a_file_that_is_no_database_keeps_its_permissions() {
    use std::os::unix::fs::PermissionsExt;
    let place = DatabaseFile::new();
    let notes = place.0.path().join("centre.db");
    std::fs::write(&notes, "notes of a person, longer than the head of a database\n".repeat(9))
        .unwrap();
    std::fs::set_permissions(&notes, std::fs::Permissions::from_mode(0o644)).unwrap();
    assert!(place.open().is_err());
    let mode = std::fs::metadata(&notes).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o644);
    let Err(device) = Store::open(std::path::Path::new("/dev/null")) else {
        panic!("a device is no database");
    };
    let device = device.to_string();
    assert!(device.contains("no regular file"), "{device}");
}

/// The serial number of a machine cannot change during a roll-out. Otherwise another machine could take its name and
/// get a model that was measured on this machine.
#[test]
fn the_serial_number_is_fixed_during_a_rollout() {
    let (_place, store) = opened();
    let mill = machine("mill-a");
    let mut other = mill.clone();
    other.serial = "9999".into();
    store.put_machine(&mill, "anna").unwrap();
    let machines = [(mill.identity.machine.clone(), true)];
    store.begin_rollout("ab", &machines, Rules::default(), "anna").unwrap();
    // Other fields may change. The serial number may not, even if the machine is removed first.
    store.put_machine(&mill, "anna").unwrap();
    let refused = |found: Result<(), Error>| {
        let said = found.unwrap_err().to_string();
        assert!(said.contains("mill-a is in roll-out 1"), "{said}");
    };
    refused(store.put_machine(&other, "anna"));
    store.remove_machine(&mill.identity.machine, "anna").unwrap();
    refused(store.put_machine(&other, "anna"));
}

#[test]
fn a_changed_or_removed_audit_record_is_detected() {
    let place = &DatabaseFile::new();
    for (change, seen) in [
        ("UPDATE audit SET document = replace(document, 'anna', 'bert') WHERE number = 2", 2),
        ("DELETE FROM audit WHERE number = 2", 2),
        ("UPDATE audit SET number = 9 WHERE number = 3", 3),
    ] {
        let store = place.open().unwrap();
        place.execute("DELETE FROM audit");
        for number in 0..4 {
            let details = json!({ "number": number });
            store.audit("anna", "test", "x", details).unwrap();
        }
        assert_eq!(store.broken_audit().unwrap(), None);
        place.execute(change);
        assert_eq!(store.broken_audit().unwrap(), Some(seen), "{change}");
    }
}

#[test]
fn messages_are_stored_once_and_averaged() {
    let (place, store) = opened();
    let mut ingest = Ingest::of(&store).unwrap();
    let from_s = 1_800_000_000.0;
    let batch = conditions(0..90, from_s);
    let taken = ingest.take(&store, &batch[..50]).unwrap();
    assert_eq!((taken.stored, taken.duplicates), (50, 0));
    // A part of the batch is redelivered after a lost acknowledgement and after a restart of the centre.
    let taken = ingest.take(&store, &batch[40..60]).unwrap();
    assert_eq!((taken.stored, taken.duplicates), (10, 10));
    let store = {
        drop(store);
        place.open().unwrap()
    };
    let mut ingest = Ingest::of(&store).unwrap();
    let taken = ingest.take(&store, &batch).unwrap();
    assert_eq!((taken.stored, taken.duplicates), (30, 60));
    let history =
        |resolution| store.history(&mill(), resolution, from_s, from_s + 7200.0, 1000).unwrap();
    assert_eq!(history(Resolution::Raw).len(), 90);
    assert_eq!(store.close_minutes(from_s + 60.0).unwrap(), 60);
    assert_eq!(history(Resolution::Raw).len(), 90, "closed or not");
    assert_eq!(store.close_minutes(from_s + 120.0).unwrap(), 30);
    let minutes = history(Resolution::Minute);
    let means: Vec<(u64, f64)> =
        (minutes.iter()).map(|point| (point.count, point.residual_um.unwrap())).collect();
    // The means of the residuals 0 to 59 and 60 to 89.
    assert_eq!(means, [(60, 29.5), (30, 74.5)]);
    assert_eq!(minutes[1].residual_max_um, Some(89.0));
    let hours = history(Resolution::Hour);
    assert_eq!((hours[0].count, hours[0].residual_um), (90, Some(44.5)));
    assert_eq!(hours[0].temperatures_degc["scale X"], 21.5);
    // The means of a closed minute and its hour include 30 late conditions.
    ingest.take(&store, &conditions(90..120, from_s)).unwrap();
    assert_eq!(store.close_minutes(from_s + 180.0).unwrap(), 30);
    let minutes = history(Resolution::Minute);
    assert_eq!((minutes[1].count, minutes[1].residual_um), (60, Some(89.5)));
    let hours = history(Resolution::Hour);
    assert_eq!((hours[0].count, hours[0].residual_um), (120, Some(59.5)));
}

#[test]
fn expired_rows_are_deleted_and_hours_kept() {
    let (_place, store) = opened();
    let mut ingest = Ingest::of(&store).unwrap();
    let from_s = 1_800_000_000.0;
    ingest.take(&store, &conditions(0..60, from_s)).unwrap();
    let telemetry: Vec<Received> = (60..70)
        .map(|number| {
            let envelope = envelope("run-1", number, json!({ "number": number }));
            let at_s = from_s + number as f64;
            received("mill-a", Kind::Telemetry, number + 1, at_s, &envelope)
        })
        .collect();
    ingest.take(&store, &telemetry).unwrap();
    ingest.store_live(&store).unwrap();
    assert_eq!(store.telemetry(&mill()).unwrap().unwrap().1["number"], 69);
    store.close_minutes(from_s + 60.0).unwrap();
    let keep = Retention::default();
    let points = |resolution| {
        let points = store.history(&mill(), resolution, from_s, from_s + 60.0, 1000);
        points.unwrap().len()
    };
    let mut after = |days: f64| {
        let at_s = from_s + days * 86_400.0;
        let newest = envelope(&format!("run of day {days}"), 0, condition(4.0));
        ingest.take(&store, &[received("mill-a", Kind::Condition, 100, at_s, &newest)]).unwrap();
        store.close_minutes(at_s + 60.0).unwrap();
        store.delete_expired(keep, at_s).unwrap();
    };
    // The clock of the centre was set too far.
    store.delete_expired(keep, from_s + 40.0 * 86_400.0).unwrap();
    assert_eq!((points(Resolution::Raw), points(Resolution::Minute)), (60, 1));
    after(0.1);
    assert_eq!(points(Resolution::Raw), 60);
    after(2.0);
    assert_eq!(points(Resolution::Raw), 0);
    assert_eq!(points(Resolution::Minute), 1);
    // The first telemetry message of the hour is kept longer.
    assert_eq!(store.telemetry(&mill()).unwrap().unwrap().1["number"], 60);
    after(40.0);
    assert_eq!(points(Resolution::Minute), 0);
    assert_eq!(points(Resolution::Hour), 1);
    assert_eq!(store.telemetry(&mill()).unwrap(), None);
}

/// On a full disk no part of a batch is stored, the state does not change, and the batch can be passed again.
#[test]
fn a_rejected_batch_is_not_stored_in_part() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("centre.db")).unwrap();
    let mut ingest = Ingest::of(&store).unwrap();
    let from_s = 1_800_000_000.0;
    ingest.take(&store, &conditions(0..10, from_s)).unwrap();
    let full = |pages: u32| store.limit_pages(pages).unwrap();
    full(1);
    let large = conditions(10..2000, from_s);
    let refused = ingest.take(&store, &large);
    assert!(matches!(refused, Err(Error::Sqlite(_))), "{refused:?}");
    let count = || {
        let points = store.history(&mill(), Resolution::Raw, from_s, from_s + 3000.0, 10_000);
        points.unwrap().len()
    };
    assert_eq!(count(), 10);
    full(u32::MAX - 1);
    let taken = ingest.take(&store, &large).unwrap();
    assert_eq!((taken.stored, taken.duplicates), (1990, 0));
    assert_eq!(count(), 2000);
    drop(folder);
}

#[test]
fn unreadable_messages_are_kept() {
    let (_place, store) = opened();
    let mut ingest = Ingest::of(&store).unwrap();
    for (sequence, bytes) in [&b"no JSON"[..], b"{}", b"\xff\xfe", b"[1e999]"].iter().enumerate() {
        for kind in Kind::ALL {
            let message = Received {
                identity: identity("mill-a"),
                kind,
                sequence: sequence as u64,
                stored_s: 1.0,
                bytes: bytes.to_vec().into(),
            };
            // The message is stored once, however often it is delivered.
            for _ in 0..2 {
                let taken = ingest.take(&store, std::slice::from_ref(&message)).unwrap();
                assert_eq!(taken.stored, 0);
            }
        }
    }
    assert_eq!(store.machine_records(&mill(), 100).unwrap().len(), 16);
    let (_, why) = ingest.machine(&mill()).unwrap().unreadable.as_ref().unwrap();
    assert!(why.starts_with("telemetry: "), "{why}");
}

#[test]
fn a_machine_is_in_one_open_rollout() {
    let (_place, store) = opened();
    let start = |names: &[&str]| {
        let machines: Vec<(MachineId, bool)> =
            (names.iter()).map(|name| (name.parse().unwrap(), false)).collect();
        store.begin_rollout("model", &machines, Rules::default(), "anna")
    };
    assert_eq!(start(&["a", "b"]).unwrap().id, 1);
    let refused = start(&["b", "c"]).unwrap_err().to_string();
    assert!(refused.starts_with("b is in roll-out 1"), "{refused}");
    assert_eq!(start(&["c"]).unwrap().id, 2);
    assert_eq!(store.open_rollouts().unwrap(), [1, 2]);
    store.request_rollout_change(1, &UserRequest::Abort, "anna").unwrap();
    assert!(matches!(
        store.request_rollout_change(3, &UserRequest::Abort, "anna"),
        Err(Error::Missing { .. })
    ));
}

#[test]
fn a_failed_transaction_is_rolled_back() {
    let (place, store) = opened();
    store.put_machine(&machine("mill-a"), "anna").unwrap();
    // The audit record is the second of the two statements of the transaction.
    place.execute("ALTER TABLE audit RENAME TO gone");
    store.put_machine(&machine("mill-b"), "anna").unwrap_err();
    place.execute("ALTER TABLE gone RENAME TO audit");
    assert_eq!(store.machines().unwrap().len(), 1);
    store.put_machine(&machine("mill-b"), "anna").unwrap();
    assert_eq!(store.machines().unwrap().len(), 2);
    assert_eq!(store.broken_audit().unwrap(), None);
}

#[test]
fn a_database_of_a_newer_program_is_rejected() {
    let place = &DatabaseFile::new();
    drop(place.open().unwrap());
    place.execute("UPDATE schema SET steps = 99");
    assert!(matches!(place.open(), Err(Error::Newer { found: 99, .. })));
}

/// Minutes of many machines, of which some are late or out of order. Each machine has its own means.
#[test]
fn minutes_are_closed_machine_by_machine() {
    const MACHINES: u64 = 70;
    let (_place, store) = opened();
    let mut ingest = Ingest::of(&store).unwrap();
    let from_s = 1_800_000_000.0;
    let name = |machine: u64| format!("mill-{machine}");
    // Machine m reports a residual of 1000 m + n µm in second n for three minutes. Every third machine is silent in the
    // second minute.
    let tells =
        |machine: u64, second: u64| !(machine.is_multiple_of(3) && (60..120).contains(&second));
    let batch: Vec<Received> = (0..180)
        .step_by(10)
        .flat_map(|second| (0..MACHINES).map(move |machine| (machine, second)))
        .filter(|(machine, second)| tells(*machine, *second))
        .map(|(machine, second)| {
            let residual_um = (1000 * machine + second) as f64;
            let envelope = envelope("run-1", second, condition(residual_um));
            let at_s = from_s + second as f64;
            received(&name(machine), Kind::Condition, second + 1, at_s, &envelope)
        })
        .collect();
    let (early, late) = batch.split_at(batch.len() / 2);
    ingest.take(&store, late).unwrap();
    let closed = store.close_minutes(from_s + 120.0).unwrap();
    ingest.take(&store, early).unwrap();
    let closed = closed + store.close_minutes(from_s + 120.0).unwrap();
    let within = batch.iter().filter(|one| one.stored_s < from_s + 120.0);
    assert_eq!(closed, within.count() as u64);
    assert_eq!(store.close_minutes(from_s + 120.0).unwrap(), 0);
    for machine in 0..MACHINES {
        let id: MachineId = name(machine).parse().unwrap();
        let history = |resolution| {
            let points = store.history(&id, resolution, from_s, from_s + 600.0, 1000);
            points.unwrap()
        };
        let base = (1000 * machine) as f64;
        let silent = machine.is_multiple_of(3);
        let means: Vec<(f64, u64, Option<f64>)> = (history(Resolution::Minute).iter())
            .map(|point| (point.at_s - from_s, point.count, point.residual_um))
            .collect();
        // Six conditions per minute, at 0, 10, … 50 s.
        let first = (0.0, 6, Some(base + 25.0));
        let second = (60.0, 6, Some(base + 85.0));
        let expected = if silent { vec![first] } else { vec![first, second] };
        assert_eq!(means, expected, "{id}");
        let hour = &history(Resolution::Hour)[0];
        let of_hour = if silent { (6, base + 25.0) } else { (12, base + 55.0) };
        assert_eq!((hour.count, hour.residual_um), (of_hour.0, Some(of_hour.1)));
        let reported: Vec<f64> =
            (history(Resolution::Raw).iter()).map(|point| point.at_s - from_s).collect();
        let expected = (0..180).step_by(10).filter(|second| tells(machine, *second));
        let expected: Vec<f64> = expected.map(|second| second as f64).collect();
        assert_eq!(reported, expected, "{id}");
    }
}

#[test]
fn a_panic_in_a_transaction_is_rolled_back() {
    let (place, store) = opened();
    store.put_machine(&machine("mill-a"), "anna").unwrap();
    let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        store.change_machine(&mill(), "anna", |_| -> Result<_, Error> { panic!("in the middle") })
    }));
    assert!(ended.is_err());
    store.put_machine(&machine("mill-b"), "anna").unwrap();
    assert_eq!(place.open().unwrap().machines().unwrap().len(), 2);
    assert_eq!(store.broken_audit().unwrap(), None);
}

#[test]
fn an_older_database_is_migrated() {
    let (place, store) = opened();
    let mut ingest = Ingest::of(&store).unwrap();
    let from_s = 1_800_000_000.0;
    ingest.take(&store, &conditions(0..90, from_s)).unwrap();
    drop(store);
    let store = place.open().unwrap();
    store.begin_rollout("", &[(mill(), false)], Rules::default(), "anna").unwrap();
    drop(store);
    for sql in [
        // A pending request in the first schema.
        "UPDATE rollouts SET wish = '[{\"wish\":\"pause\"},\"anna\"]'",
        "DROP INDEX records_once",
        "ALTER TABLE records DROP COLUMN record",
        "DROP INDEX recent_of",
        "CREATE INDEX recent_at ON recent (at_s)",
        "DROP TABLE wishes",
        "UPDATE schema SET steps = 1",
    ] {
        place.execute(sql);
    }
    let store = place.open().unwrap();
    assert_eq!(store.close_minutes(from_s + 60.0).unwrap(), 60);
    // The request is still pending: any other count violates the constraint.
    place.execute("CREATE TABLE counted (count BIGINT CHECK (count = 1))");
    place.execute("INSERT INTO counted SELECT count(*) FROM wishes WHERE rollout = 1");
    drop(place.open().unwrap());
}

/// Texts that the database cannot store or index do not block messages of other gateways.
#[test]
fn unstorable_instance_names_do_not_block_a_batch() {
    let (_place, store) = opened();
    let mut ingest = Ingest::of(&store).unwrap();
    // Multiples of an odd number, which a database cannot compress.
    let digits = (0..10_000_u64).map(|place| place.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let digits: Vec<String> = digits.map(|digits| format!("{digits:x}")).collect();
    let long = digits.concat();
    let batch: Vec<Received> = ["a\0b", "\0", "a\u{fffd}b", &long, "", "ÄÖ€😀"]
        .iter()
        .zip(1..)
        .map(|(instance, sequence)| {
            let envelope = envelope(instance, 1, condition(1.0));
            received("mill-a", Kind::Condition, sequence, 1.8e9, &envelope)
        })
        .collect();
    let taken = ingest.take(&store, &batch).unwrap();
    assert_eq!((taken.stored, taken.duplicates), (5, 0));
    // The message with the long name is kept as unreadable.
    let kept = store.machine_records(&mill(), 10).unwrap();
    assert_eq!(kept.len(), 1);
    let why = kept[0].1["why"].as_str().unwrap();
    assert!(why.contains("bytes, expected at most 256"), "{why}");
    drop(Ingest::of(&store).unwrap());
    store.audit("anna\0", "test", "x", json!({ "zero": "\0" })).unwrap();
    assert_eq!(store.broken_audit().unwrap(), None);
}

#[test]
fn numbers_are_stored_exactly() {
    let (_place, store) = opened();
    let mut ingest = Ingest::of(&store).unwrap();
    let at_s = 1_800_000_000.123_456_7;
    let body = json!({ "tiny": 5e-324, "third": 1.0 / 3.0, "large": u64::MAX });
    let telemetry =
        received("mill-a", Kind::Telemetry, 1, at_s, &envelope("run-1", 0, body.clone()));
    ingest.take(&store, &[telemetry]).unwrap();
    assert_eq!(store.telemetry(&mill()).unwrap(), Some((at_s, body)));
    // A version above the database's maximum integer is stored as that maximum.
    let answer = volcomp_fleet::Acknowledgement {
        version: u64::MAX,
        value_sha256: "00".to_owned(),
        outcome: volcomp_fleet::Outcome::Activated,
    };
    let answer = received("mill-a", Kind::Ack, 2, at_s, &envelope("run-1", 1, answer));
    let taken = ingest.take(&store, &[answer]).unwrap();
    assert_eq!(taken.stored, 1);
}

/// Several programs write concurrently: every change is stored, and the audit log stays one chain.
#[test]
fn two_programs_write_concurrently() {
    let place = &DatabaseFile::new();
    std::thread::scope(|scope| {
        for program in 0..4 {
            scope.spawn(move || {
                let store = place.open().unwrap();
                for number in 0..25 {
                    let name = format!("mill-{program}-{number}");
                    store.put_machine(&machine(&name), "anna").unwrap();
                }
            });
        }
    });
    let store = place.open().unwrap();
    assert_eq!(store.machines().unwrap().len(), 100);
    assert_eq!(store.audit_records(None, 1000).unwrap().len(), 100);
    assert_eq!(store.broken_audit().unwrap(), None);
    for name in ["ab", "a-c"] {
        store.put_machine(&machine(name), "anna").unwrap();
    }
    // The machines are sorted by bytes, independent of the locale.
    let mut expected: Vec<String> = (0..4)
        .flat_map(|program| (0..25).map(move |number| format!("mill-{program}-{number}")))
        .collect();
    expected.extend(["a-c".to_owned(), "ab".to_owned()]);
    expected.sort();
    let machines = store.machines().unwrap();
    let names: Vec<&str> =
        (machines.iter()).map(|machine| machine.identity.machine.as_str()).collect();
    assert_eq!(names, expected);
}

/// The database holds password hashes and models. Only its owner can read it, even if the file was created with other
/// permissions.
#[test]
fn the_sqlite_file_is_private() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("centre.db");
    let modes = || {
        std::fs::read_dir(folder.path())
            .unwrap()
            .map(|file| file.unwrap().metadata().unwrap().permissions().mode() & 0o777)
            .collect::<Vec<_>>()
    };
    let store = Store::open(&path).unwrap();
    assert_eq!(modes(), [0o600; 3], "the file, its log and its index");
    drop(store);
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o644)).unwrap();
    let _store = Store::open(&path).unwrap();
    assert_eq!(modes(), [0o600; 3]);
}

/// A login compares the password with a hash, and the user is changed before the session begins.
#[test]
fn a_session_begins_only_with_the_current_password_of_a_user_who_may_log_in() {
    let (_place, store) = opened();
    let [admin, anna] = ["otto", "anna"].map(|name| name.parse().unwrap());
    store.add_user(&admin, Role::Admin, "x", "test", "").unwrap();
    store.add_user(&anna, Role::Viewer, "old", "test", "").unwrap();
    let begins = |compared: &str| {
        let token = Token::generate().unwrap();
        let session = Session {
            user: anna.clone(),
            since: BootTime::now(),
            used: BootTime::now(),
            from: String::new(),
        };
        let begun = store.begin_session(&token, &session, compared).unwrap();
        let found = store.session(&token, &BootTime::now()).unwrap();
        assert_eq!(found.is_some(), begun);
        begun
    };
    let replaces =
        |compared: &str, new: &str| store.replace_password(&anna, compared, new, "").unwrap();
    assert!(begins("old") && replaces("old", "new"));
    assert!(!begins("old") && !replaces("old", "thief's"));
    let disable = |disabled| {
        let changed = store.change_user(&anna, Role::Viewer, disabled, "otto", "");
        changed.unwrap();
    };
    disable(true);
    assert!(!begins("new") && !replaces("new", "thief's"));
    disable(false);
    assert!(begins("new"));
    store.remove_user(&anna, "otto", "").unwrap();
    assert!(!begins("new") && !replaces("new", "thief's"));
}

/// The disk is full when the last use of a session is to be stored. The user stays logged in until the stored last use
/// is too old.
#[test]
fn a_session_is_valid_while_its_last_use_cannot_be_stored() {
    let (place, store) = opened();
    let anna: UserName = "anna".parse().unwrap();
    store.add_user(&anna, Role::Viewer, "hash", "test", "").unwrap();
    let (token, begun) = (Token::generate().unwrap(), BootTime::now());
    let session =
        Session { user: anna, since: begun.clone(), used: begun.clone(), from: String::new() };
    assert!(store.begin_session(&token, &session, "hash").unwrap());
    let is_valid = |after_s| {
        let now = begun.later(Duration::from_secs(after_s));
        store.session(&token, &now).unwrap().is_some()
    };
    place.execute(
        "CREATE TRIGGER full BEFORE UPDATE ON sessions
         BEGIN SELECT RAISE(ABORT, 'database or disk is full'); END",
    );
    assert!(is_valid(61) && is_valid(1800) && !is_valid(1801));
    assert!(store.trouble().is_some());
    place.execute("DROP TRIGGER full");
    assert!(is_valid(1800) && is_valid(3600) && !is_valid(5401));
}
