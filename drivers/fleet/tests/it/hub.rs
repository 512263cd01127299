//! The centre's side, against the installed `nats-server`.

use std::time::Duration;

use bytes::Bytes;
use tokio::time::timeout;
use volcomp_fleet::{DesiredEvent, Hub, Kind, LinkSettings, MachineLink, StreamRetention};

use crate::Bench;

const SOON: Duration = Duration::from_secs(60);

async fn hub(bench: &Bench) -> Hub {
    let settings =
        LinkSettings { url: bench.url(), seed: bench.centre.seed().unwrap(), roots: None };
    let hub = Hub::connect(&settings).await.unwrap();
    let site = bench.machines[0].0.site.clone();
    hub.prepare(&[site], StreamRetention::default()).await.unwrap();
    hub
}

#[test]
fn unacknowledged_messages_are_redelivered() {
    Bench::run(async |bench| {
        let hub_one = hub(bench).await;
        let identity = bench.machines[0].0.clone();
        let link = MachineLink::connect(&bench.link(0), &identity).await.unwrap();
        for number in 0..5 {
            let id = format!("1-{number}");
            let text = Bytes::from(format!("message {number}"));
            link.publish(Kind::Condition, &id, text).await.unwrap();
        }
        let collection = |hub: &Hub| {
            let [telemetry, _] = hub.collections(&identity.site);
            telemetry.again_after(Duration::from_secs(2))
        };
        // The first centre stops before it has stored a message.
        let mut first = collection(&hub_one);
        let batch = timeout(SOON, first.next()).await.unwrap().unwrap();
        assert_eq!(batch.messages[0].bytes, "message 0");
        assert_eq!(batch.messages[0].identity, identity);
        assert_eq!(batch.messages[0].kind, Kind::Condition);
        drop((batch, first, hub_one));
        let hub_two = hub(bench).await;
        let mut second = collection(&hub_two);
        let mut seen = std::collections::BTreeSet::new();
        while seen.len() < 5 {
            // A server that is not running yet is reported as an error and retried.
            let Ok(batch) = timeout(SOON, second.next()).await.unwrap() else {
                continue;
            };
            seen.extend(batch.messages.iter().map(|message| message.sequence));
            batch.acknowledge().await.unwrap();
        }
        // The server is killed and restarted: new messages arrive, and some old ones may arrive again, since a server
        // stores acknowledgements with a delay.
        bench.stop();
        bench.restart();
        let end = tokio::time::Instant::now() + SOON;
        while link.publish(Kind::Condition, "1-5", "new".into()).await.is_err() {
            assert!(tokio::time::Instant::now() < end, "the server is not there again");
        }
        let mut is_there = false;
        while !is_there {
            let Ok(batch) = timeout(SOON, second.next()).await.unwrap() else {
                continue;
            };
            for message in &batch.messages {
                is_there |= message.bytes == "new";
                let known = seen.contains(&message.sequence);
                assert!(known || message.bytes == "new", "{message:?}");
            }
            batch.acknowledge().await.unwrap();
        }
    });
}

/// docs/src/fleet.md: a stolen nkey fills the streams of its site up to `telemetry_gib`. No stored audit record is
/// removed to make room for a new one, because the centre may not have collected it. The server compares only the body
/// of a message with the free space, so the bodies here are much larger than the 65 bytes of overhead per message. The
/// stream was created without limit by an earlier version.
#[test]
fn a_full_stream_of_audit_records_refuses_new_ones() {
    Bench::run(async |bench| {
        let hub = hub(bench).await;
        let identity = bench.machines[0].0.clone();
        let mut before = hub.context().get_stream("audit-berlin").await.unwrap();
        let unlimited = async_nats::jetstream::stream::Config {
            max_bytes: -1,
            discard: async_nats::jetstream::stream::DiscardPolicy::Old,
            ..before.info().await.unwrap().config.clone()
        };
        let earlier = hub.context().update_stream(unlimited).await;
        earlier.unwrap();
        let limited = |site_bytes| StreamRetention { site_bytes, ..StreamRetention::default() };
        let sites = [identity.site.clone()];
        hub.prepare(&sites, limited(100_000)).await.unwrap();
        let link = MachineLink::connect(&bench.link(0), &identity).await.unwrap();
        let mut number = 0;
        let mut publish = async |kind: Kind| {
            number += 1;
            let id = number.to_string();
            link.publish(kind, &id, vec![b'z'; 1000].into()).await
        };
        let refused = async {
            loop {
                if let Err(error) = publish(Kind::Audit).await
                    && error.to_string().contains("maximum bytes")
                {
                    return;
                }
            }
        };
        timeout(SOON, refused).await.expect("it is full at some time");
        for _ in 0..200 {
            publish(Kind::Condition).await.unwrap();
        }
        let state = async |stream: &str| {
            let mut stream = hub.context().get_stream(stream).await.unwrap();
            stream.info().await.unwrap().state.clone()
        };
        let (audit, telemetry) = (state("audit-berlin").await, state("telemetry-berlin").await);
        assert!(audit.bytes <= 25_000 && audit.first_sequence == 1, "{audit:?}");
        assert!(audit.messages > 20, "{audit:?}");
        assert!(telemetry.bytes <= 75_000 && telemetry.first_sequence > 1, "{telemetry:?}");
        // With a larger limit, messages are accepted again.
        hub.prepare(&sites, limited(200_000)).await.unwrap();
        publish(Kind::Audit).await.unwrap();
    });
}

#[test]
fn the_watch_reports_every_put() {
    Bench::run(async |bench| {
        let hub = hub(bench).await;
        let mut watch = hub.watch_desired().await.unwrap();
        let machine = bench.machines[1].0.machine.clone();
        assert_eq!(hub.desired(&machine).await.unwrap(), None);
        hub.put_desired(&machine, "own".into()).await.unwrap();
        assert_eq!(hub.desired(&machine).await.unwrap().unwrap(), "own");
        // Another client puts a value: a redirected response, with the other machine's credentials.
        bench.forge().await;
        let mut heard = Vec::new();
        while heard.len() < 2 {
            if let DesiredEvent::Put(found) = timeout(SOON, watch.next()).await.unwrap().unwrap() {
                assert_eq!(found.machine, machine);
                heard.push(found.value);
            }
        }
        assert_eq!(heard[0], "own");
        assert_ne!(heard[1], "own");
        // A direct request may return a change later than a consumer.
        let is_found = async { while hub.desired(&machine).await.unwrap().unwrap() != heard[1] {} };
        timeout(SOON, is_found).await.unwrap();
    });
}
