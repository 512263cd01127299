//! The store, carried over to another database: everything arrives, or nothing.

use std::path::Path;

use volcomp_centre::{ingest::Ingest, records::Resolution, store::Store};
use volcomp_fleet::{Acknowledgement, Kind, Outcome};

use crate::{
    command::{Called, call},
    support::{condition, envelope, identity, machine, model_text, received, rollout},
};

/// A folder with a centre whose SQLite file holds something in every table that a centre fills.
fn filled() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    configure(at, "centre.toml", "file = \"centre.db\"");
    let done = |arguments: &str| {
        let called = call(at, arguments);
        assert_eq!(called.status, 0, "{arguments}: {}", called.err);
    };
    done("key new main");
    done("key nkey centre.nkey");
    std::fs::write(at.join("model.toml"), model_text(7)).unwrap();
    done("model add model.toml");
    let store = Store::open(&at.join("centre.db")).unwrap();
    for name in ["mill-a", "mill-b"] {
        let mut machine = machine(name);
        machine.note = "ä, 2 µm, \"quoted\"; \u{1f527}".into();
        store.put_machine(&machine, "anna").unwrap();
    }
    store.start_rollout(rollout).unwrap();
    let mut ingest = Ingest::of(&store).unwrap();
    // More rows than are fetched, or wait to be sent, at one time.
    for part in 0..4_u64 {
        let mut messages = Vec::new();
        for number in part * 1000..(part + 1) * 1000 {
            let envelope = envelope("run-1", number, condition(number as f64 / 7.0));
            let at_s = 1_800_000_000.0 + number as f64 / 3.0;
            let (kind, sequence) = (Kind::Condition, number + 1);
            messages.push(received("mill-a", kind, sequence, at_s, &envelope));
        }
        ingest.take(&store, &messages).unwrap();
        // The first parts in minutes, the last one as they came.
        if part == 2 {
            ingest.store_live(&store).unwrap();
            store.close_minutes(1_800_000_900.0).unwrap();
        }
    }
    let answer = Acknowledgement {
        version: 1,
        value_sha256: "00".to_owned(),
        outcome: Outcome::Activated,
    };
    let answer = envelope("run-1", 4000, answer);
    let answer = received("mill-a", Kind::Ack, 4001, 1.8e9, &answer);
    ingest.take(&store, &[answer]).unwrap();
    folder
}

fn configure(folder: &Path, name: &str, store: &str) {
    let text = format!("[nats]\nurl = \"nats://127.0.0.1:4222\"\n[store]\n{store}\n");
    std::fs::write(folder.join(name), text).unwrap();
}

/// A file that an older program has written is named, and not a byte of it is changed: before, copying brought it up.
#[test]
fn a_file_of_an_older_program_is_refused_and_stays_as_it_is() {
    let folder = filled();
    let at = folder.path();
    let file = at.join("centre.db");
    {
        let old = rusqlite::Connection::open(&file).unwrap();
        old.execute_batch(
            "PRAGMA journal_mode = DELETE; DROP INDEX records_once; ALTER TABLE records DROP COLUMN record; UPDATE schema SET steps = 3;",
        )
        .unwrap();
    }
    let before = std::fs::read(&file).unwrap();
    configure(at, "new.toml", "file = \"new.db\"");
    let refused = call(at, "store copy --to new.toml");
    assert_eq!(refused.status, 1, "{}{}", refused.out, refused.err);
    assert!(
        refused.err.contains("its schema has 3 steps, expected 4"),
        "{}",
        refused.err
    );
    assert!(std::fs::read(&file).unwrap() == before, "it was changed");
    // Whatever is done with it brings it up.
    assert_eq!(call(at, "machine list").status, 0);
    assert_eq!(call(at, "store copy --to new.toml").status, 0);
}

/// Everything that a store tells.
fn told(store: &Store) -> Vec<String> {
    let mill = identity("mill-a").machine;
    let history = |resolution| {
        let points = store.history(&mill, resolution, 0.0, 3e9, 100_000).unwrap();
        assert!(!points.is_empty());
        format!("{points:?}")
    };
    vec![
        format!("{:?}", store.machines().unwrap()),
        format!("{:?}", store.models().unwrap()),
        format!("{:?}", store.rollouts(100).unwrap()),
        format!("{:?}", store.live().unwrap()),
        history(Resolution::Raw),
        history(Resolution::Minute),
        history(Resolution::Hour),
    ]
}

fn rows_of(file: &Path, table: &str) -> u64 {
    let file = rusqlite::Connection::open(file).unwrap();
    let sql = format!("SELECT count(*) FROM {table}");
    let count: i64 = file.query_row(&sql, [], |row| row.get(0)).unwrap();
    count.unsigned_abs()
}

/// The tables that a copy told, each with its number of rows.
fn copied(called: &Called) -> Vec<(String, u64)> {
    assert_eq!(called.status, 0, "{}", called.err);
    let lines = called.out.lines().filter(|line| line.contains(" rows "));
    let copied: Vec<(String, u64)> = lines
        .map(|line| {
            let mut words = line.split_whitespace();
            let table = words.next().unwrap().to_owned();
            (table, words.next().unwrap().parse().unwrap())
        })
        .collect();
    assert!(copied.len() > 15, "{}", called.out);
    let empty = copied.iter().filter(|(_, rows)| *rows == 0).count();
    assert!(empty < 9, "{}", called.out);
    copied
}

/// Copies into a database, and refuses what must be refused. `count` counts the rows of a table there.
fn carried_over(folder: &Path, store: &Store, count: impl Fn(&str) -> u64) {
    let file = folder.join("centre.db");
    let before = Store::open(&file).unwrap();
    let (expected, last) = (told(&before), before.audit_records(None, 1).unwrap());
    let copy = || call(folder, "store copy --to new.toml");
    // The centre has it open.
    let refused = copy();
    assert_eq!(refused.status, 1, "{}", refused.err);
    assert!(
        refused.err.contains("another program has it open"),
        "{}",
        refused.err
    );
    drop(before);
    let same = call(folder, "store copy --to centre.toml");
    assert_eq!(same.status, 2, "{}", same.err);
    assert!(
        same.err.contains("expected another database"),
        "{}",
        same.err
    );

    for (table, rows) in copied(&copy()) {
        let further = u64::from(table == "audit");
        assert_eq!(rows, rows_of(&file, &table), "{table}");
        assert_eq!(count(&table), rows + further, "{table}");
    }
    assert_eq!(told(store), expected);
    assert_eq!(store.broken_audit().unwrap(), None);
    let records = store.audit_records(None, 2).unwrap();
    assert_eq!(records[0].action, "store.copy");
    assert_eq!(records[0].by, "anna");
    assert_eq!(records[1], last[0], "the chain goes on");
    // What it took its numbers from goes on, too, and the file is as it was.
    store.put_machine(&machine("mill-c"), "anna").unwrap();
    assert_eq!(told(&Store::open(&file).unwrap()), expected);

    let again = copy();
    assert_eq!(again.status, 2, "{}", again.err);
    assert!(
        again.err.contains("rows, expected an empty database"),
        "{}",
        again.err
    );
    assert_eq!(store.machines().unwrap().len(), 3);
}

#[test]
fn from_one_file_to_another() {
    let folder = filled();
    configure(folder.path(), "new.toml", "file = \"new.db\"");
    let file = folder.path().join("new.db");
    let store = Store::open(&file).unwrap();
    carried_over(folder.path(), &store, |table| rows_of(&file, table));
    std::fs::remove_file(folder.path().join("centre.db")).unwrap();
    let gone = call(folder.path(), "store copy --to new.toml");
    assert_eq!(gone.status, 2, "{}", gone.err);
    assert!(
        gone.err.contains("found no file of a store"),
        "{}",
        gone.err
    );
}

#[cfg(feature = "postgres")]
#[test]
fn from_sqlite_to_postgresql() {
    use volcomp_centre::store::PostgresPlace;

    let Some(cluster) = crate::cluster::Cluster::shared() else {
        volcomp_test_support::peers::not_run("postgresql is not installed");
        return;
    };
    let name = cluster.database();
    let connection = cluster.connection(&name);
    let folder = filled();
    let at = folder.path();
    configure(at, "new.toml", &format!("postgres = \"{connection}\""));
    let count = |table: &str| -> u64 {
        let counted = cluster.execute(&name, &format!("SELECT count(*) FROM {table}"));
        counted.trim().parse().unwrap()
    };
    let place = PostgresPlace::of(&connection, None, None).unwrap();
    let store = Store::open_postgres(&place).unwrap();
    // One row that PostgreSQL does not take, behind many that it does: nothing of them is there.
    let file = at.join("centre.db");
    let spoil = |sql: &str| {
        let changed = rusqlite::Connection::open(&file).unwrap().execute(sql, []);
        assert_eq!(changed.unwrap(), 1);
    };
    spoil("INSERT INTO versions VALUES ('mill-a', 'none', 'm', NULL, '', '{}')");
    let called = call(at, "store copy --to new.toml");
    assert_eq!(called.status, 1, "{}", called.err);
    for table in [
        "acknowledgements",
        "audit",
        "machines",
        "recent",
        "versions",
    ] {
        assert_eq!(count(table), 0, "{table}");
    }
    spoil("DELETE FROM versions WHERE version = 'none'");
    carried_over(at, &store, count);
}
