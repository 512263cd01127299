//! A server with a centre and two machines, for the tests.

use async_nats::{ConnectOptions, jetstream};
use nkeys::KeyPair;
use volcomp_fleet::{
    Identity, Keeping, LinkSettings, MachineUser, ServerSettings,
    server::{Server, program},
};

/// A server with its users.
pub(crate) struct Bench {
    /// The running server; `None` while it is stopped.
    pub(crate) server: Option<Server>,
    pub(crate) settings: ServerSettings,
    pub(crate) centre: KeyPair,
    pub(crate) machines: [(Identity, KeyPair); 2],
    pub(crate) folder: tempfile::TempDir,
}

pub(crate) fn identity(machine: &str) -> Identity {
    Identity {
        site: "berlin".parse().unwrap(),
        machine: machine.parse().unwrap(),
    }
}

impl Bench {
    /// A running server; `None` where the program is not installed, which fails under CI.
    pub(crate) fn start() -> Option<Self> {
        if program().is_none() {
            volcomp_test_support::peers::not_run("nats-server is not installed");
            return None;
        }
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
        Some(Self {
            server: Some(server),
            settings,
            centre,
            machines,
            folder,
        })
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

    /// The settings of a machine's connection.
    pub(crate) fn link(&self, machine: usize) -> LinkSettings {
        LinkSettings {
            url: self.url(),
            seed: self.machines[machine].1.seed().unwrap(),
            roots: None,
        }
    }

    /// The centre's connection, with bucket and streams made.
    pub(crate) async fn prepared(&self) -> jetstream::Context {
        let client = ConnectOptions::with_nkey(self.centre.seed().unwrap())
            .connect(self.url())
            .await
            .unwrap();
        let context = jetstream::new(client);
        let sites = [self.machines[0].0.site.clone()];
        volcomp_fleet::prepare(&context, &sites, Keeping::default())
            .await
            .unwrap();
        context
    }

    /// A connection with the credentials of a machine and nothing else of ours.
    pub(crate) async fn stolen(&self, machine: usize) -> async_nats::Client {
        let (identity, key) = &self.machines[machine];
        ConnectOptions::with_nkey(key.seed().unwrap())
            .custom_inbox_prefix(format!("_INBOX_{}", identity.machine))
            .connect(self.url())
            .await
            .unwrap()
    }
}
