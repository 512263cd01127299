//! Ingestion: an unreadable message does no harm, and a redelivered message counts once.

use std::{path::Path, time::Duration};

use volcomp_centre::{ingest::Ingest, records::Resolution, store::Store};
use volcomp_fleet::{
    Acknowledgement, AuditLine, Kind, MachineId, Outcome, Received, StreamRetention,
};

use crate::{
    shop::{LONG, Shop, until},
    support::{condition, envelope, identity, machine, received},
};

const FROM_S: f64 = 1_800_000_000.0;

fn store(folder: &Path) -> Store {
    Store::open(&folder.join("centre.db")).unwrap()
}

/// The history continues after a number that becomes infinite when rounded to three digits, and after a row that is not
/// JSON.
#[test]
fn large_numbers_and_broken_rows_do_not_stop_the_history() {
    let folder = tempfile::tempdir().unwrap();
    let store = store(folder.path());
    let mut ingest = Ingest::of(&store).unwrap();
    let mut large = condition(4.0);
    large.temperatures_degc.insert("bed".into(), Some(1e306));
    let bad = received("mill-b", Kind::Condition, 1, FROM_S, &envelope("b", 1, large));
    let good = received("mill-a", Kind::Condition, 2, FROM_S, &envelope("a", 1, condition(4.0)));
    ingest.take(&store, &[bad, good]).unwrap();
    let raw = rusqlite::Connection::open(folder.path().join("centre.db")).unwrap();
    let sql =
        "INSERT INTO recent (machine, at_s, document) VALUES ('mill-b', ?1, '{\"at_s\":null}')";
    raw.execute(sql, [FROM_S + 1.0]).unwrap();
    store.close_minutes(FROM_S + 120.0).unwrap();
    for machine in ["mill-a", "mill-b"] {
        for resolution in [Resolution::Raw, Resolution::Minute, Resolution::Hour] {
            let machine = &identity(machine).machine;
            let reported =
                store.history(machine, resolution, FROM_S - 60.0, FROM_S + 120.0, 10).unwrap();
            assert_eq!(reported.len(), 1, "{machine} {resolution:?}");
            assert!(!reported[0].temperatures_degc.contains_key("bed"));
        }
    }
}

/// A gateway was restarted 17 times offline and sends its queue. The centre is killed between commit and
/// acknowledgement. The redelivered batch is stored once.
#[test]
fn a_redelivered_batch_of_many_instances_is_stored_once() {
    let folder = tempfile::tempdir().unwrap();
    let store = store(folder.path());
    let mut ingest = Ingest::of(&store).unwrap();
    let batch: Vec<Received> = (0..17)
        .map(|start: u64| {
            let one = envelope(&format!("run-{start}"), 1, condition(4.0));
            received("mill-a", Kind::Condition, start + 1, FROM_S + start as f64, &one)
        })
        .collect();
    assert_eq!(ingest.take(&store, &batch).unwrap().stored, 17);
    let mut again = Ingest::of(&store).unwrap();
    let taken = again.take(&store, &batch).unwrap();
    assert_eq!((taken.stored, taken.duplicates), (0, 17));
}

/// A gateway is killed after the server has stored an audit record and before the gateway has saved its cursor. It
/// sends the record again under a new instance, after the server has forgotten the ID. The record is stored once.
#[test]
fn an_audit_record_resent_after_a_restart_is_stored_once() {
    let folder = tempfile::tempdir().unwrap();
    let store = store(folder.path());
    let mut ingest = Ingest::of(&store).unwrap();
    let line = AuditLine { checksum: "ab".repeat(32), record: "{\"what\":\"armed\"}".into() };
    for (place, start) in ["before", "after"].into_iter().enumerate() {
        let at_s = FROM_S + 600.0 * place as f64;
        let one = envelope(start, 1, line.clone());
        let message = received("mill-a", Kind::Audit, place as u64 + 1, at_s, &one);
        ingest.take(&store, &[message]).unwrap();
    }
    let kept = store.machine_records(&identity("mill-a").machine, 10).unwrap();
    assert_eq!(kept.len(), 1, "the machine armed once");
    let one = envelope("a", 1, line);
    let other = received("mill-b", Kind::Audit, 3, FROM_S, &one);
    ingest.take(&store, &[other]).unwrap();
    let kept = store.machine_records(&identity("mill-b").machine, 10);
    assert_eq!(kept.unwrap().len(), 1);
}

#[test]
fn a_limited_history_returns_its_newest_points() {
    let folder = tempfile::tempdir().unwrap();
    let store = store(folder.path());
    let mut ingest = Ingest::of(&store).unwrap();
    let batch: Vec<Received> = (0..100)
        .map(|number: u64| {
            let one = envelope("a", number, condition(number as f64));
            received("mill-a", Kind::Condition, number + 1, FROM_S + 60.0 * number as f64, &one)
        })
        .map(|mut message| {
            let mut json: serde_json::Value = serde_json::from_slice(&message.bytes).unwrap();
            json["uptime_s"] = (message.stored_s - FROM_S).into();
            message.bytes = serde_json::to_vec(&json).unwrap().into();
            message
        })
        .collect();
    ingest.take(&store, &batch).unwrap();
    store.close_minutes(FROM_S + 6000.0).unwrap();
    let machine = identity("mill-a").machine;
    let all = store.history(&machine, Resolution::Minute, FROM_S, FROM_S + 6000.0, 1000).unwrap();
    let some = store.history(&machine, Resolution::Minute, FROM_S, FROM_S + 6000.0, 20).unwrap();
    assert_eq!(all.len(), 100);
    assert_eq!(
        some.last().map(|point| point.at_s),
        all.last().map(|point| point.at_s),
        "the newest is left out"
    );
}

#[test]
fn message_numbers_up_to_the_maximum_are_counted() {
    let mut instances = volcomp_centre::instance::Instances::default();
    for instance in ["a", "b"] {
        for number in [0, u64::MAX] {
            instances.take(&volcomp_centre::instance::Header {
                instance,
                number,
                uptime_s: 1.0,
                stored_s: FROM_S,
                passing: None,
            });
        }
    }
    instances.count_missing();
    assert!(instances.count_missing() > 0);
}

/// A gateway is killed after the server has stored an audit record, and sends the record again under the same ID. The
/// record is stored once, and no message counts as missing.
#[test]
fn a_record_resent_after_a_kill_is_no_gap() {
    Shop::run(1, 1, async |shop| {
        let hub = shop.hub().await;
        let identity = &shop.machines[0].0.identity;
        while hub
            .prepare(std::slice::from_ref(&identity.site), StreamRetention::default())
            .await
            .is_err()
        {
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        let link = shop.link(0).await;
        until("it is connected", || link.is_connected()).await;
        let line = AuditLine { checksum: "ab".repeat(32), record: "{}".into() };
        let record = |start| serde_json::to_vec(&envelope(start, 2, line.clone())).unwrap();
        let reported =
            |start, number| serde_json::to_vec(&envelope(start, number, condition(4.0))).unwrap();
        for (kind, id, bytes) in [
            (Kind::Condition, "one-1", reported("one", 1)),
            (Kind::Audit, "one-2", record("one")),
            (Kind::Condition, "two-1", reported("two", 1)),
            (Kind::Audit, "two-2", record("two")),
            (Kind::Condition, "two-3", reported("two", 3)),
        ] {
            link.publish(kind, id, bytes.into()).await.unwrap();
        }
        let mut ingest = Ingest::of(&shop.store).unwrap();
        for (mut collection, mut expected) in
            hub.collections(&identity.site).into_iter().zip([3_usize, 2])
        {
            while expected > 0 {
                let next = tokio::time::timeout(LONG, collection.next());
                if let Ok(batch) = next.await.expect("all that was published comes") {
                    expected -= batch.messages.len();
                    ingest.take(&shop.store, &batch.messages).unwrap();
                }
            }
        }
        ingest.count_missing();
        ingest.count_missing();
        let lost = ingest.machine(&identity.machine).unwrap().live.as_ref().unwrap().lost;
        assert_eq!(lost, 0, "nothing is missing");
        let kept = shop.store.machine_records(&identity.machine, 10).unwrap();
        assert_eq!(kept.len(), 1, "{kept:?}");
    });
}

/// docs/src/fleet.md: "no condition for five of its intervals, at least 15 s". Only the creation times of conditions
/// count. With an interval of 60 s, a condition from 20 s ago is current.
#[test]
fn a_machine_is_silent_by_its_conditions_and_interval() {
    let folder = tempfile::tempdir().unwrap();
    let store = store(folder.path());
    let mut ingest = Ingest::of(&store).unwrap();
    let name: MachineId = "mill-1".parse().unwrap();
    let limit = |condition_s| {
        let mut machine = machine("mill-1");
        machine.condition_s = condition_s;
        machine.silent_after_s()
    };
    assert_eq!([None, Some(2), Some(60)].map(limit), [15.0, 15.0, 300.0]);
    let heard = |ingest: &mut Ingest, condition_s| {
        ingest.take_observations(|_| limit(condition_s)).0[&name].reachable
    };
    // Other messages do not show the current state.
    let answer = envelope(
        "a",
        1,
        Acknowledgement { version: 1, value_sha256: "x".into(), outcome: Outcome::Activated },
    );
    let at_s = 1_800_000_000.0;
    ingest.take(&store, &[received("mill-1", Kind::Ack, 1, at_s, &answer)]).unwrap();
    assert!(!heard(&mut ingest, Some(60)));
    let reported = |number, stored_s| {
        received(
            "mill-1",
            Kind::Condition,
            number,
            stored_s,
            &envelope("a", number, condition(4.0)),
        )
    };
    ingest.take(&store, &[reported(2, at_s + 2.0)]).unwrap();
    assert!(heard(&mut ingest, None));
    let mut ingest = Ingest::of(&store).unwrap();
    // The condition was created at 3 s and queued for 20 s.
    ingest.take(&store, &[reported(3, at_s + 23.0)]).unwrap();
    assert!(!heard(&mut ingest, None));
    assert!(heard(&mut ingest, Some(60)));
    let silence_s = ingest.silence_s(&name);
    assert!((20.0..60.0).contains(&silence_s), "{silence_s}");
}

/// docs/src/fleet.md: the centre stores at most 128 MiB of the conditions and states of one machine at once, and then
/// 16 KiB a second. A week's backlog of messages at the server is stored.
#[test]
fn a_flood_of_one_machine_is_not_stored() {
    let folder = tempfile::tempdir().unwrap();
    let store = store(folder.path());
    let mut ingest = Ingest::of(&store).unwrap();
    let large = "z".repeat(1 << 20);
    let flood = |kind, number: u64, machine: &str, at_s| {
        let body = serde_json::json!({ "large": large });
        received(machine, kind, number, at_s, &envelope("a", number, body))
    };
    let stored = || {
        let raw = rusqlite::Connection::open(folder.path().join("centre.db")).unwrap();
        ["telemetry", "records"].map(|table| {
            let sql = format!("SELECT count(*) FROM {table} WHERE machine = 'mill-a'");
            raw.query_row(&sql, [], |row| row.get::<_, u64>(0)).unwrap()
        })
    };
    // For two minutes a megabyte arrives every second. A condition without its fields is unreadable and is stored
    // indefinitely.
    for number in 0..240 {
        let kind = [Kind::Telemetry, Kind::Condition][usize::from(number % 2 == 1)];
        let one = flood(kind, number, "mill-a", FROM_S + number as f64 / 2.0);
        ingest.take(&store, &[one]).unwrap();
    }
    let [states, unreadable] = stored();
    assert!((63..=66).contains(&states), "{states}");
    assert!((63..=66).contains(&unreadable), "{unreadable}");
    let reception = ingest.machine(&identity("mill-a").machine).unwrap();
    let (_, why) = reception.unreadable.as_ref().unwrap();
    assert!(why.contains("16 KiB a second"), "{why}");
    // The state of the machine is still known, and its audit records are stored.
    let shown = received(
        "mill-a",
        Kind::Condition,
        300,
        FROM_S + 121.0,
        &envelope("a", 300, condition(7.0)),
    );
    let record = flood(Kind::Audit, 301, "mill-a", FROM_S + 121.0);
    ingest.take(&store, &[shown, record]).unwrap();
    let reception = ingest.machine(&identity("mill-a").machine).unwrap();
    let live = reception.live.as_ref().unwrap();
    assert_eq!(live.condition.as_ref().unwrap().residual_um, Some(7.0));
    assert_eq!(stored()[1], unreadable + 1);
    // Another machine is not affected.
    let other = flood(Kind::Telemetry, 1, "mill-b", FROM_S + 121.0);
    ingest.take(&store, &[other]).unwrap();
    assert!(store.telemetry(&identity("mill-b").machine).unwrap().is_some());
    // A backlog of four hours at 10 KiB a second, which waited at the server while the centre was down, is stored.
    let waited: Vec<Received> = (1..=150)
        .map(|number| flood(Kind::Telemetry, number, "mill-c", FROM_S + 100.0 * number as f64))
        .collect();
    ingest.take(&store, &waited).unwrap();
    let reception = ingest.machine(&identity("mill-c").machine).unwrap();
    assert_eq!(reception.unreadable, None);
    // Two hours later messages of the first machine are stored again, even after the server's clock was set forward and
    // back.
    for (number, at_s) in [(400, 0.0), (401, 7200.0), (402, 0.0), (403, 7200.0)] {
        ingest.take(&store, &[flood(Kind::Telemetry, number, "mill-a", FROM_S + at_s)]).unwrap();
    }
    assert!(stored()[0] > states);
}
