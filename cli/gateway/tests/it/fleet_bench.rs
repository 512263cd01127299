//! A centre on a real `nats-server`, and the configuration of a machine of its fleet.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_fleet::{
    Desired, Identity, MachineUser, Manifest, ModelRef, ServerSettings, SigningKey,
    StreamRetention,
    server::{Server, program},
};
use volcomp_vocabulary::AxisName;

use crate::{
    manual::{Served, served_configuration},
    program::{Client, MACHINE},
};

const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) struct Centre {
    pub(crate) server: Option<Server>,
    settings: ServerSettings,
    folder: tempfile::TempDir,
    own: nkeys::KeyPair,
    machine: nkeys::KeyPair,
    identity: Identity,
    pub(crate) key: SigningKey,
    runtime: tokio::runtime::Runtime,
}

/// The machine file with a straightness EYX of `eyx_um`, µm.
pub(crate) fn machine_with(eyx_um: f64) -> String {
    MACHINE.replace("EYX = 20.0", &format!("EYX = {eyx_um:.1}"))
}

impl Centre {
    /// A running server. `None` if no server is installed, which is a failure under CI.
    pub(crate) fn start() -> Option<Self> {
        if program().is_none() {
            volcomp_test_support::peers::not_run("nats-server");
            return None;
        }
        let folder = tempfile::tempdir().expect("writable");
        let [centre, machine] = [nkeys::KeyPair::new_user(), nkeys::KeyPair::new_user()];
        let identity = Identity {
            site: "berlin".parse().expect("a name"),
            machine: "mill-1".parse().expect("a name"),
        };
        let settings = ServerSettings {
            name: "one".to_owned(),
            listen: volcomp_test_support::free_address(),
            store: folder.path().join("streams"),
            tls: None,
            cluster: None,
            centres: vec![centre.public_key()],
            machines: vec![MachineUser { identity: identity.clone(), nkey: machine.public_key() }],
        };
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .expect("a runtime");
        let mut bench = Self {
            server: None,
            settings,
            folder,
            own: centre,
            machine,
            identity,
            key: SigningKey::from_bytes(&[7; 32]),
            runtime,
        };
        bench.restart();
        bench.prepare(StreamRetention::default());
        Some(bench)
    }

    pub(crate) fn stop(&mut self) {
        self.server = None;
    }

    pub(crate) fn restart(&mut self) {
        let server = Server::start(&self.settings, self.folder.path());
        self.server = Some(server.expect("it starts"));
    }

    fn context(&self) -> async_nats::jetstream::Context {
        let url = format!("nats://{}", self.settings.listen);
        let seed = self.own.seed().expect("a seed");
        self.runtime.block_on(async move {
            let client =
                async_nats::ConnectOptions::with_nkey(seed).connect(url).await.expect("it listens");
            async_nats::jetstream::new(client)
        })
    }

    pub(crate) fn prepare(&self, retention: StreamRetention) {
        let context = self.context();
        let sites = [self.identity.site.clone()];
        let made = volcomp_fleet::prepare(&context, &sites, retention);
        self.runtime.block_on(made).expect("streams");
    }

    /// Sets the maximum size of messages in the stream of audit records and acknowledgements, bytes; -1: unlimited.
    pub(crate) fn limit_audit_messages(&self, bytes: i32) {
        let context = self.context();
        self.runtime.block_on(async move {
            let stream = context.get_stream("audit-berlin").await.expect("it is there");
            let mut config = stream.cached_info().config.clone();
            config.max_message_size = bytes;
            context.update_stream(config).await.expect("updated");
        });
    }

    /// Stores a value under the machine's key.
    pub(crate) fn put(&self, value: &[u8]) {
        let context = self.context();
        let value = value.to_vec();
        self.runtime.block_on(async move {
            let acknowledged =
                context.publish("$KV.desired.mill-1", value.into()).await.expect("sent");
            acknowledged.await.expect("stored");
        });
    }

    /// Stores a model in the machine's object store, possibly under the checksum of another text.
    pub(crate) fn store(&self, sha256: &str, text: &str) {
        let context = self.context();
        let put =
            volcomp_fleet::put_model(&context, &self.identity.machine, sha256, text.as_bytes(), 1);
        self.runtime.block_on(put).expect("stored");
    }

    pub(crate) fn manifest(&self, version: u64, model: &str) -> Manifest {
        Manifest {
            machine: self.identity.machine.clone(),
            serial: "4711".to_owned(),
            version,
            axes: vec![AxisName::X, AxisName::Y, AxisName::Z],
            model: ModelRef::of(model.as_bytes()),
            enable: true,
            confirm: None,
            condition_s: Some(1),
            telemetry_s: Some(1),
            issued: "a test".to_owned(),
        }
    }

    /// Signs a manifest, and stores it under the machine's key. Returns the stored value.
    pub(crate) fn send(&self, manifest: &Manifest, model: &str) -> Vec<u8> {
        let desired = Desired::sign(manifest, model, &self.key).expect("plain data");
        let value = desired.bytes().expect("plain data");
        self.put(&value);
        value
    }

    /// Signs a manifest with this version and machine file, and stores it under the machine's key.
    pub(crate) fn roll_out(&self, version: u64, model: &str) -> Vec<u8> {
        self.send(&self.manifest(version, model), model)
    }

    /// All messages of a stream: the last part of the subject, and the document.
    pub(crate) fn reported(&self, stream: &str) -> Vec<(String, Value)> {
        let context = self.context();
        let name = format!("{stream}-berlin");
        self.runtime.block_on(async move {
            let stream = context.get_stream(name).await.expect("it is there");
            let state = &stream.cached_info().state;
            let mut messages = Vec::new();
            for sequence in state.first_sequence.max(1)..=state.last_sequence {
                let message = stream.get_raw_message(sequence).await.expect("it is there");
                let kind = message.subject.rsplit('.').next().unwrap_or("").to_owned();
                let document: Value = serde_json::from_slice(&message.payload).expect("JSON");
                // A client that knows the id could send it first, and the server would drop the message.
                let id = message.headers.get("Nats-Msg-Id").expect("an id").as_str();
                let instance = document["instance"].as_str().expect("text");
                assert!(!id.contains(instance), "{id}");
                messages.push((kind, document));
            }
            messages
        })
    }

    pub(crate) fn bodies(&self, stream: &str, kind: &str) -> Vec<Value> {
        let reported = self.reported(stream).into_iter();
        let of_kind = reported.filter(|(found, _)| found == kind);
        of_kind.map(|(_, document)| document["body"].clone()).collect()
    }

    pub(crate) fn acknowledged(&self, version: u64, outcome: &str) -> Value {
        let end = Instant::now() + PATIENCE;
        loop {
            let acks = self.bodies("audit", "ack");
            let fits = |ack: &&Value| ack["version"] == version && ack["outcome"] == outcome;
            if let Some(ack) = acks.iter().find(fits) {
                return ack.clone();
            }
            assert!(Instant::now() < end, "no {outcome} of version {version}: {acks:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until a version is rejected with a reason that contains `words`. Returns the reason.
    pub(crate) fn refused(&self, version: u64, words: &str) -> String {
        let end = Instant::now() + PATIENCE;
        loop {
            let acks = self.bodies("audit", "ack");
            let whys = acks.iter().filter(|ack| ack["version"] == version);
            let mut whys = whys.filter_map(|ack| ack["why"].as_str());
            if let Some(why) = whys.find(|why| why.contains(words)) {
                return why.to_owned();
            }
            assert!(
                Instant::now() < end,
                "version {version} is not refused for {words:?}: {acks:?}"
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// The configuration of the machine, with `[fleet]`, in a folder.
    pub(crate) fn configuration(&self, dir: &Path) -> PathBuf {
        use base64::{Engine, engine::general_purpose::STANDARD};
        let config = served_configuration(dir, "auto_arm = true");
        let member = Member {
            url: &format!("nats://{}", self.settings.listen),
            machine: "mill-1",
            serial: "4711",
            seed: &self.machine.seed().expect("a seed"),
            key: &STANDARD.encode(self.key.verifying_key().to_bytes()),
        };
        member.join(dir, &config);
        config
    }
}

/// A machine of the fleet, as its configuration names it.
pub(crate) struct Member<'a> {
    pub(crate) url: &'a str,
    pub(crate) machine: &'a str,
    pub(crate) serial: &'a str,
    pub(crate) seed: &'a str,
    /// Trusted public key, base64.
    pub(crate) key: &'a str,
}

impl Member<'_> {
    /// Adds `[fleet]` to a configuration, and writes the nkey file next to it.
    pub(crate) fn join(&self, dir: &Path, config: &Path) {
        use std::os::unix::fs::PermissionsExt;
        let file = dir.join("nkey");
        std::fs::write(&file, format!("{}\n", self.seed)).expect("writable");
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).expect("ours");
        let text = std::fs::read_to_string(config).expect("readable");
        let Self { url, machine, serial, key, .. } = self;
        let text = format!(
            r#"{text}
[fleet]
url = "{url}"
site = "berlin"
machine = "{machine}"
serial = "{serial}"
nkey_file = "nkey"
trusted_keys = ["{key}"]
dir = "fleet"
"#
        );
        std::fs::write(config, text).expect("writable");
    }
}

/// A gateway of the fleet that compensates.
pub(crate) fn compensating(config: &Path) -> Served {
    let gateway = Served::start(config);
    gateway.wait_for("compensating");
    gateway
}

/// Waits until `done` holds for the state. Panics with `what` on timeout.
pub(crate) fn wait(gateway: &Client, what: &str, done: impl Fn(&Value) -> bool) -> Value {
    let state = gateway.wait(done);
    state.unwrap_or_else(|state| panic!("{what}: {state}\n{}", gateway.log()))
}

/// Waits until the control applies the correction `um` to Y, µm.
pub(crate) fn corrects_y(gateway: &Client, um: f64) {
    wait(gateway, &format!("Y is corrected by {um} µm"), |state| {
        state["correction_um"]["Y"] == um
    });
}

/// Checks that the machine still corrects Y by `um`, µm.
pub(crate) fn goes_on(state: &Value, um: f64) {
    let is_so = state["state"] == "compensating" && state["correction_um"]["Y"] == um;
    assert!(is_so, "{state}");
}
