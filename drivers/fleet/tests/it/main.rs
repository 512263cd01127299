//! Tests of the fleet's documents, and of its connections to a real `nats-server`.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

mod acceptance;
mod cluster;
mod hub;
mod permissions;
mod server_2_9;
mod spool;

use async_nats::{
    ConnectOptions,
    jetstream::{self, kv},
};
use nkeys::KeyPair;
use volcomp_fleet::{
    Identity, LinkSettings, MachineUser, ServerSettings, StreamRetention,
    server::{Server, program},
};

pub(crate) struct Bench {
    /// `None` while the server is stopped.
    pub(crate) server: Option<Server>,
    pub(crate) settings: ServerSettings,
    pub(crate) centre: KeyPair,
    pub(crate) machines: [(Identity, KeyPair); 2],
    pub(crate) folder: tempfile::TempDir,
}

pub(crate) fn identity(machine: &str) -> Identity {
    Identity { site: "berlin".parse().unwrap(), machine: machine.parse().unwrap() }
}

impl Bench {
    /// Runs a test with a server. Without an installed `nats-server` the test is skipped; under CI that is a failure.
    pub(crate) fn run(test: impl AsyncFnOnce(&mut Self)) {
        if program().is_none() {
            volcomp_test_support::peers::not_run("nats-server is not installed");
            return;
        }
        let mut bench = Self::start();
        runtime().block_on(test(&mut bench));
    }

    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let centre = KeyPair::new_user();
        let machines = ["mill-a", "mill-b"].map(|name| (identity(name), KeyPair::new_user()));
        let settings = ServerSettings {
            name: "one".to_owned(),
            listen: volcomp_test_support::free_address(),
            store: folder.path().join("streams"),
            tls: None,
            cluster: None,
            centres: vec![centre.public_key()],
            machines: machines
                .iter()
                .map(|(identity, key)| MachineUser {
                    identity: identity.clone(),
                    nkey: key.public_key(),
                })
                .collect(),
        };
        let server = Server::start(&settings, folder.path()).unwrap();
        Self { server: Some(server), settings, centre, machines, folder }
    }

    pub(crate) fn url(&self) -> String {
        format!("nats://{}", self.settings.listen)
    }

    pub(crate) fn stop(&mut self) {
        self.server = None;
    }

    pub(crate) fn restart(&mut self) {
        self.server = Some(Server::start(&self.settings, self.folder.path()).unwrap());
    }

    pub(crate) fn link(&self, machine: usize) -> LinkSettings {
        LinkSettings {
            url: self.url(),
            seed: self.machines[machine].1.seed().unwrap(),
            roots: None,
        }
    }

    /// Connects as the centre and creates its bucket and streams.
    pub(crate) async fn prepared(&self) -> jetstream::Context {
        let client = ConnectOptions::with_nkey(self.centre.seed().unwrap())
            .connect(self.url())
            .await
            .unwrap();
        let context = jetstream::new(client);
        let sites = [self.machines[0].0.site.clone()];
        volcomp_fleet::prepare(&context, &sites, StreamRetention::default()).await.unwrap();
        context
    }

    /// Like [`Self::prepared`], with a value in the bucket for each machine.
    pub(crate) async fn with_values(&self) -> (jetstream::Context, kv::Store) {
        let context = self.prepared().await;
        let store = context.get_key_value("desired").await.unwrap();
        store.put("mill-a", "a".into()).await.unwrap();
        store.put("mill-b", "b".into()).await.unwrap();
        (context, store)
    }

    /// Stores a server response under the second machine's key, with the credentials of the first machine.
    pub(crate) async fn forge(&self) {
        let thief = self.stolen(0).await;
        let (subject, reply) = ("volcomp.berlin.mill-a.condition", "$KV.desired.mill-b");
        let sent = thief.publish_with_reply(subject, reply, "forged".into());
        sent.await.unwrap();
        thief.flush().await.unwrap();
    }

    /// Opens a plain NATS connection with a machine's credentials.
    pub(crate) async fn stolen(&self, machine: usize) -> async_nats::Client {
        let (identity, key) = &self.machines[machine];
        ConnectOptions::with_nkey(key.seed().unwrap())
            .custom_inbox_prefix(format!("_INBOX_{}", identity.machine))
            .connect(self.url())
            .await
            .unwrap()
    }
}

pub(crate) fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}
