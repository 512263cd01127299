//! The cluster port of the real server, by which servers join.

use std::{path::Path, time::Duration};

use async_nats::ConnectOptions;
use futures_util::StreamExt;
use nkeys::KeyPair;
use tokio::time::timeout;
use volcomp_fleet::{
    Cluster, RoutePassword, ServerConfigError, ServerSettings, StreamRetention,
    server::{Server, program},
};
use volcomp_test_support::free_address;

use crate::{identity, runtime};

/// Timeout for steps that succeed even on a slow computer.
const LONG: Duration = Duration::from_secs(60);
/// A message that does not arrive within this time counts as blocked.
const NEVER: Duration = Duration::from_millis(800);

fn settings(name: &str, folder: &Path, centre: &KeyPair, cluster: Cluster) -> ServerSettings {
    ServerSettings {
        name: name.to_owned(),
        listen: free_address(),
        store: folder.join("streams"),
        tls: None,
        cluster: Some(cluster),
        centres: vec![centre.public_key()],
        machines: Vec::new(),
    }
}

async fn connected(settings: &ServerSettings, centre: &KeyPair) -> async_nats::Client {
    let connecting = async {
        loop {
            let options = ConnectOptions::with_nkey(centre.seed().unwrap());
            match options.connect(format!("nats://{}", settings.listen)).await {
                Ok(client) => return client,
                Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
            }
        }
    };
    timeout(LONG, connecting).await.unwrap()
}

/// Three servers with one password form a cluster with a stream replica on each. A fourth server with another password
/// cannot join, and receives none of their messages.
#[test]
fn a_server_without_the_password_cannot_join() {
    if program().is_none() {
        volcomp_test_support::peers::not_run("nats-server is not installed");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let centre = KeyPair::new_user();
    let addresses = [(); 4].map(|()| free_address());
    let routes: Vec<String> =
        (addresses[..3].iter()).map(|address| format!("nats://{address}")).collect();
    let ours = RoutePassword::of_seed(&centre.seed().unwrap());
    let other = RoutePassword::of_seed(&KeyPair::new_user().seed().unwrap());
    let mut servers = Vec::new();
    for (place, listen) in addresses.iter().enumerate() {
        let folder = folder.path().join(place.to_string());
        std::fs::create_dir(&folder).unwrap();
        let cluster = Cluster {
            name: "shop".to_owned(),
            listen: listen.clone(),
            routes: routes.clone(),
            password: if place < 3 { &ours } else { &other }.clone(),
            roots: None,
        };
        let settings = settings(&format!("server-{place}"), &folder, &centre, cluster);
        let server = Server::spawn(&settings, &folder).unwrap();
        servers.push((server, settings, folder));
    }
    runtime().block_on(async {
        let mut clients = Vec::new();
        for (_, settings, _) in &servers {
            clients.push(connected(settings, &centre).await);
        }
        // Streams with three replicas can be created only once all three servers have joined.
        let context = async_nats::jetstream::new(clients[0].clone());
        let retention = StreamRetention { replicas: 3, ..StreamRetention::default() };
        let sites = [identity("mill-a").site];
        let prepared = async {
            while volcomp_fleet::prepare(&context, &sites, retention).await.is_err() {
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        };
        timeout(LONG, prepared).await.unwrap();
        // The fourth server has tried to join and was rejected.
        let refused = async {
            loop {
                let log = std::fs::read_to_string(servers[3].2.join("nats.log")).unwrap();
                if log.contains("Authorization Violation") {
                    break;
                }
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        };
        timeout(LONG, refused).await.unwrap();
        let mut friend = clients[1].subscribe("volcomp.>").await.unwrap();
        let mut stranger = clients[3].subscribe("volcomp.>").await.unwrap();
        clients[1].flush().await.unwrap();
        clients[3].flush().await.unwrap();
        let heard = async {
            loop {
                let said = clients[0].publish("volcomp.berlin.mill-a.x", "secret".into());
                said.await.unwrap();
                if timeout(NEVER, friend.next()).await.is_ok() {
                    break;
                }
            }
        };
        timeout(LONG, heard).await.unwrap();
        assert!(timeout(NEVER, stranger.next()).await.is_err());
    });
}

#[test]
fn the_password_appears_only_in_the_configuration() {
    let password = RoutePassword::of_seed("SUA");
    assert_eq!(password, RoutePassword::of_seed("SUA\n"));
    assert_ne!(password, RoutePassword::of_seed("SUB"));
    let cluster = |route: &str| Cluster {
        name: "shop".to_owned(),
        listen: "127.0.0.1:6222".to_owned(),
        routes: vec![route.to_owned()],
        password: password.clone(),
        roots: None,
    };
    let text = |cluster: Cluster| {
        let settings = settings("one", Path::new("/x"), &KeyPair::new_user(), cluster);
        settings.text()
    };
    let shown = text(cluster("nats://127.0.0.1:6223")).unwrap();
    // Expected password, from `printf 'volcomp route 1\0SUA' | sha256sum`.
    let secret = "3268c692553668c77a272fa3211ccc8b2f8f43ceff05aaba60f61a12e97a6df8";
    assert_eq!(shown.matches(secret).count(), 2, "{shown}");
    assert!(shown.contains(&format!("nats://route:{secret}@127.0.0.1:6223")));
    assert!(!format!("{:?}", cluster("nats://127.0.0.1:6223")).contains(secret));
    for wrong in [
        "127.0.0.1:6223",
        "tls://127.0.0.1:6223",
        "nats://",
        "nats://u:p@127.0.0.1:6223",
        "nats://127.0.0.1:6223/x",
    ] {
        let found = text(cluster(wrong)).unwrap_err();
        assert!(matches!(found, ServerConfigError::Route { .. }), "{wrong}");
        assert!(!found.to_string().contains("u:p"), "{found}");
    }
}
