//! Server features that the fleet uses, on the installed `nats-server` (2.9 in Debian 12): buckets, direct requests,
//! object stores, permissions.

use std::time::Duration;

use async_nats::jetstream;
use bytes::Bytes;
use futures_util::StreamExt;
use tokio::time::timeout;
use volcomp_fleet::{Identity, Kind, MachineLink, ModelRef, put_model};

use crate::{Bench, runtime};

const SOON: Duration = Duration::from_secs(5);
/// A request not answered within this time counts as rejected.
const NEVER: Duration = Duration::from_millis(400);

async fn bucket(context: &jetstream::Context) -> jetstream::kv::Store {
    context.get_key_value("desired").await.unwrap()
}

async fn link(bench: &Bench, machine: usize) -> MachineLink {
    MachineLink::connect(&bench.link(machine), &bench.machines[machine].0).await.unwrap()
}

#[test]
fn a_machine_receives_its_value_at_start_and_on_change() {
    Bench::run(async |bench| {
        let context = bench.prepared().await;
        let store = bucket(&context).await;
        store.put("mill-a", "first".into()).await.unwrap();
        store.put("mill-b", "other".into()).await.unwrap();
        let mut link = link(bench, 0).await;
        let next = async |link: &mut MachineLink| timeout(SOON, link.next_desired()).await.unwrap();
        assert_eq!(next(&mut link).await, "first");
        store.put("mill-b", "not for a".into()).await.unwrap();
        store.put("mill-a", "second".into()).await.unwrap();
        assert_eq!(next(&mut link).await, "second");
        // Putting the same value again does not count as a change.
        store.put("mill-a", "second".into()).await.unwrap();
        store.put("mill-a", "third".into()).await.unwrap();
        assert_eq!(next(&mut link).await, "third");
    });
}

#[test]
fn a_reconnected_machine_receives_the_missed_value() {
    Bench::run(async |bench| {
        let context = bench.prepared().await;
        let store = bucket(&context).await;
        store.put("mill-a", "before".into()).await.unwrap();
        let mut link = link(bench, 0).await;
        assert_eq!(timeout(SOON, link.next_desired()).await.unwrap(), "before");
        bench.stop();
        let error = link.publish(Kind::Condition, "1-1", "lost?".into()).await;
        assert!(error.is_err(), "it was not stored");
        bench.restart();
        let store = bucket(&context).await;
        store.put("mill-a", "after".into()).await.unwrap();
        assert_eq!(timeout(4 * SOON, link.next_desired()).await.unwrap(), "after");
        // An unacknowledged message is sent again, and the server stores it once.
        for _ in 0..2 {
            let sent = link.publish(Kind::Condition, "1-1", "once".into()).await;
            sent.unwrap();
        }
        let stream = context.get_stream("telemetry-berlin").await.unwrap();
        assert_eq!(stream.cached_info().state.messages, 1);
    });
}

#[test]
fn a_large_model_is_fetched_completely_or_rejected() {
    Bench::run(async |bench| {
        let context = bench.prepared().await;
        let text = "# a line of a large model\n".repeat(60_000);
        let model = ModelRef::of(text.as_bytes());
        let (identity, _) = &bench.machines[0];
        let link = link(bench, 0).await;
        assert!(link.fetch_model(&model).await.is_err(), "not there yet");
        let put = async |text: &str| {
            let (machine, sha256) = (&identity.machine, &model.sha256);
            put_model(&context, machine, sha256, text.as_bytes(), 1).await
        };
        put(&text).await.unwrap();
        assert_eq!(link.fetch_model(&model).await.unwrap(), text);
        // Another model is stored under the same name.
        let other = text.replacen("line", "lime", 1);
        put(&other).await.unwrap();
        let error = link.fetch_model(&model).await.unwrap_err().to_string();
        assert!(error.contains("checksum"), "{error}");
    });
}

#[test]
fn stolen_credentials_give_no_further_access() {
    Bench::run(async |bench| {
        let (context, store) = bench.with_values().await;
        for (identity, _) in &bench.machines {
            put_model(&context, &identity.machine, "model", b"content", 1).await.unwrap();
        }
        let thief = bench.stolen(0).await;
        let own = thief
            .request("$JS.API.DIRECT.GET.KV_desired.$KV.desired.mill-a", Bytes::new())
            .await
            .unwrap();
        assert_eq!(own.payload, "a", "its own key is answered");
        for subject in [
            "$JS.API.DIRECT.GET.KV_desired.$KV.desired.mill-b",
            "$JS.API.DIRECT.GET.KV_desired",
            "$JS.API.STREAM.MSG.GET.KV_desired",
            "$JS.API.STREAM.INFO.KV_desired",
            "$JS.API.STREAM.PURGE.KV_desired",
            "$JS.API.STREAM.DELETE.KV_desired",
            "$JS.API.STREAM.UPDATE.KV_desired",
            "$JS.API.STREAM.CREATE.mine",
            "$JS.API.STREAM.NAMES",
            "$JS.API.INFO",
            "$JS.API.STREAM.INFO.telemetry-berlin",
            "$JS.API.DIRECT.GET.telemetry-berlin",
            "$JS.API.STREAM.MSG.GET.telemetry-berlin",
            "$JS.API.STREAM.INFO.OBJ_models-mill-b",
            "$JS.API.DIRECT.GET.OBJ_models-mill-b.$O.models-mill-b.M.bW9kZWw=",
            "$JS.API.STREAM.MSG.GET.OBJ_models-mill-b",
            "$JS.API.STREAM.DELETE.OBJ_models-mill-a",
            "$JS.API.STREAM.PURGE.OBJ_models-mill-a",
            // A consumer could send messages to any subject.
            "$JS.API.CONSUMER.CREATE.OBJ_models-mill-a",
            "$JS.API.CONSUMER.CREATE.OBJ_models-mill-a.one.>",
            "$JS.API.CONSUMER.DURABLE.CREATE.OBJ_models-mill-a.one",
            "$JS.API.CONSUMER.CREATE.KV_desired.one.$KV.desired.mill-a",
        ] {
            let answer = timeout(NEVER, thief.request(subject, Bytes::new())).await;
            assert!(!matches!(answer, Ok(Ok(_))), "{subject}: {answer:?}");
        }
        // Subscriptions to all subjects, and to subjects of another machine, are rejected.
        for subject in [
            ">",
            "*.*.*.*",
            "$KV.desired.mill-b",
            "$KV.desired.>",
            "_INBOX_mill-b.>",
            "_INBOX.>",
            "volcomp.berlin.mill-b.condition",
            "volcomp.berlin.mill-a.condition",
        ] {
            let mut heard = thief.subscribe(subject).await.unwrap();
            thief.flush().await.unwrap();
            store.put("mill-b", "secret".into()).await.unwrap();
            // Both machines publish, and the thief receives neither message.
            for machine in [0, 1] {
                let link = link(bench, machine).await;
                let sent = link.publish(Kind::Condition, subject, "said".into());
                sent.await.unwrap();
            }
            let message = timeout(NEVER, heard.next()).await;
            assert!(!matches!(message, Ok(Some(_))), "{subject}: {message:?}");
        }
        // Publications on another machine's subjects, to its key and to its objects are rejected.
        let before = messages(&context).await;
        for subject in [
            "$KV.desired.mill-a",
            "$KV.desired.mill-b",
            "volcomp.berlin.mill-b.condition",
            "volcomp.berlin.mill-b.ack",
            "volcomp.paris.mill-a.condition",
            "$O.models-mill-a.M.bW9kZWw=",
            "$O.models-mill-b.M.bW9kZWw=",
        ] {
            thief.publish(subject, "forged".into()).await.unwrap();
        }
        thief.flush().await.unwrap();
        tokio::time::sleep(NEVER).await;
        assert_eq!(messages(&context).await, before);
    });
}

/// Last sequence number of every stream.
async fn messages(context: &jetstream::Context) -> Vec<(String, u64)> {
    let mut streams = context.streams();
    let mut found = Vec::new();
    while let Some(stream) = streams.next().await {
        let info = stream.unwrap();
        found.push((info.config.name, info.state.last_sequence));
    }
    found.sort();
    found
}

/// The server does not check the reply subject of a request. So a thief of one machine's credentials can have a server
/// response stored under another machine's key. The thief cannot choose the content, no machine accepts it, and the
/// centre detects a value that it did not put.
#[test]
fn a_redirected_response_is_no_manifest() {
    Bench::run(async |bench| {
        bench.with_values().await;
        let mut machine = link(bench, 1).await;
        assert_eq!(timeout(SOON, machine.next_desired()).await.unwrap(), "b");
        bench.forge().await;
        if let Ok(value) = timeout(SOON, machine.next_desired()).await {
            assert!(volcomp_fleet::Desired::parse(&value).is_err(), "{value:?}");
            assert!(!value.windows(6).any(|part| part == b"forged"));
        }
    });
}

#[test]
fn the_seed_is_not_logged() {
    let seed = nkeys::KeyPair::new_user().seed().unwrap();
    let settings = volcomp_fleet::LinkSettings {
        url: "nats://127.0.0.1:1".to_owned(),
        seed: seed.clone(),
        roots: None,
    };
    let shown = format!("{settings:?}");
    assert!(shown.contains("127.0.0.1") && !shown.contains(&seed), "{shown}");
}

#[test]
fn an_invalid_seed_is_rejected() {
    let settings = volcomp_fleet::LinkSettings {
        url: "nats://127.0.0.1:1".to_owned(),
        seed: "SU".to_owned(),
        roots: None,
    };
    let identity: &Identity = &crate::identity("mill-a");
    let connected = runtime().block_on(MachineLink::connect(&settings, identity));
    assert!(matches!(connected, Err(volcomp_fleet::LinkError::Seed)));
}
