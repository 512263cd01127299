//! A server, a centre and gateways for end-to-end tests.

use std::{
    io,
    path::Path,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use nkeys::KeyPair;
use tokio::io::AsyncWriteExt;
use volcomp_centre::{
    engine::{Engine, Running, Settings},
    keys::Key,
    records::{AlarmKind, Machine},
    rollout::{Phase, Rollout, Rules},
    store::{Retention, SignedValue, Store},
};
use volcomp_fleet::{
    Desired, Hub, Kind, LinkSettings, MachineId, MachineLink, MachineUser, Manifest,
    ServerSettings, SigningKey, StreamRetention, Subjects,
    server::{Server, program},
};

use crate::{
    gateway::{self, GatewayState, Plan},
    support::{machine, model},
};

pub(crate) const LONG: Duration = Duration::from_secs(120);

impl GatewayState {
    pub(crate) fn version(&self) -> u64 {
        self.version.load(Ordering::Relaxed)
    }

    pub(crate) fn conditions(&self) -> u64 {
        self.conditions.load(Ordering::Relaxed)
    }
}

pub(crate) struct Shop {
    pub(crate) folder: tempfile::TempDir,
    pub(crate) servers: Vec<Option<Server>>,
    pub(crate) settings: Vec<ServerSettings>,
    pub(crate) centre: KeyPair,
    pub(crate) machines: Vec<(Machine, KeyPair)>,
    pub(crate) key: Key,
    pub(crate) store: Arc<Store>,
}

impl Shop {
    /// Runs a test with `servers` clustered servers and `machines` machines. Skipped if no server is installed, which
    /// is a failure under CI.
    pub(crate) fn run(servers: usize, machines: usize, test: impl AsyncFnOnce(&mut Self)) {
        if let Some(mut shop) = Self::new(servers, machines) {
            runtime().block_on(test(&mut shop));
        }
    }

    fn new(servers: usize, machines: usize) -> Option<Self> {
        if program().is_none() {
            volcomp_test_support::peers::not_run("nats-server is not installed");
            return None;
        }
        let folder = tempfile::tempdir().unwrap();
        let centre = KeyPair::new_user();
        let machines: Vec<(Machine, KeyPair)> = (0..machines)
            .map(|place| (machine(&format!("mill-{place}")), KeyPair::new_user()))
            .collect();
        let users: Vec<MachineUser> = (machines.iter())
            .map(|(machine, key)| MachineUser {
                identity: machine.identity.clone(),
                nkey: key.public_key(),
            })
            .collect();
        let routes: Vec<String> =
            (0..servers).map(|_| volcomp_test_support::free_address()).collect();
        let settings: Vec<ServerSettings> = (0..servers)
            .map(|place| ServerSettings {
                name: format!("server-{place}"),
                listen: volcomp_test_support::free_address(),
                store: folder.path().join(format!("streams-{place}")),
                tls: None,
                cluster: (servers > 1).then(|| volcomp_fleet::Cluster {
                    name: "shop".to_owned(),
                    listen: routes[place].clone(),
                    routes: routes.iter().map(|route| format!("nats://{route}")).collect(),
                    password: volcomp_fleet::RoutePassword::of_seed(&centre.seed().unwrap()),
                    roots: None,
                }),
                centres: vec![centre.public_key()],
                machines: users.clone(),
            })
            .collect();
        let store = Arc::new(Store::open(&folder.path().join("centre.db")).unwrap());
        for (machine, _) in &machines {
            store.put_machine(machine, "anna").unwrap();
        }
        let mut shop = Self {
            servers: (0..servers).map(|_| None).collect(),
            settings,
            centre,
            machines,
            key: Key { name: "main".to_owned(), key: SigningKey::from_bytes(&[7; 32]) },
            store,
            folder,
        };
        for place in 0..servers {
            shop.start_server(place);
        }
        Some(shop)
    }

    pub(crate) fn start_server(&mut self, place: usize) {
        let folder = self.folder.path().join(format!("server-{place}"));
        std::fs::create_dir_all(&folder).unwrap();
        let settings = &self.settings[place];
        let server = if self.settings.len() > 1 {
            Server::spawn(settings, &folder)
        } else {
            Server::start(settings, &folder)
        };
        self.servers[place] = Some(server.unwrap());
    }

    pub(crate) fn url(&self) -> String {
        let urls = self.settings.iter();
        let urls: Vec<String> = urls.map(|one| format!("nats://{}", one.listen)).collect();
        urls.join(",")
    }

    pub(crate) async fn centre(&self, url: &str) -> Running {
        let settings = Settings {
            link: LinkSettings { url: url.to_owned(), ..self.link_of(&self.centre) },
            stream_retention: StreamRetention {
                replicas: self.settings.len(),
                ..StreamRetention::default()
            },
            keep: Retention::default(),
            key: self.key.clone(),
            own: vec![self.key.clone()],
        };
        Engine::start(Arc::clone(&self.store), settings).await.unwrap()
    }

    pub(crate) fn plan(&self, place: usize, instance: &str) -> Plan {
        let (machine, key) = &self.machines[place];
        Plan {
            link: self.link_of(key),
            identity: machine.identity.clone(),
            serial: machine.serial.clone(),
            trusted: vec![self.key.key.verifying_key()],
            instance: instance.to_owned(),
            condition_every: Duration::from_millis(200),
            telemetry_every: Duration::from_secs(2),
            telemetry: Arc::from(
                serde_json::value::RawValue::from_string("{\"whole\":true}".to_owned()).unwrap(),
            ),
            residual_um: Arc::new(Mutex::new(4.0)),
        }
    }

    pub(crate) fn gateway(&self, place: usize) -> (GatewayState, tokio::task::JoinHandle<()>) {
        let reported = GatewayState::default();
        let plan = self.plan(place, &format!("run-{place}"));
        (reported.clone(), tokio::spawn(gateway::run(plan, reported)))
    }

    /// Waits until the value under the machine's key in the NATS store has this version; 0: the key
    /// is empty.
    pub(crate) async fn until_under_key(&self, place: usize, version: u64) {
        let hub = self.hub().await;
        let end = Instant::now() + LONG;
        loop {
            let found = hub.desired(self.name(place)).await;
            let found = found.map(|value| value.map_or(0, |value| manifest(&value).version));
            if found.as_ref().is_ok_and(|found| *found == version) {
                return;
            }
            assert!(Instant::now() < end, "version {version}: found {found:?}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    fn link_of(&self, key: &KeyPair) -> LinkSettings {
        LinkSettings { url: self.url(), seed: key.seed().unwrap(), roots: None }
    }

    pub(crate) async fn hub(&self) -> Hub {
        Hub::connect(&self.link_of(&self.centre)).await.unwrap()
    }

    pub(crate) async fn link(&self, place: usize) -> MachineLink {
        let (machine, key) = &self.machines[place];
        let link = MachineLink::connect(&self.link_of(key), &machine.identity).await;
        link.unwrap()
    }

    /// Sends a message of a machine. Returns when the server has acknowledged the message.
    pub(crate) async fn tell(&self, place: usize, kind: Kind, body: &impl serde::Serialize) {
        let link = self.link(place).await;
        let bytes = serde_json::to_vec(body).unwrap();
        while link.publish(kind, "b-1", bytes.clone().into()).await.is_err() {
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    }

    /// Uses the credentials of the first machine to store a server response under the key of the second machine.
    pub(crate) async fn forge(&self) {
        let (thief, key) = &self.machines[0];
        let client = async_nats::ConnectOptions::with_nkey(key.seed().unwrap())
            .custom_inbox_prefix("_INBOX_mill-0")
            .connect(self.url())
            .await
            .unwrap();
        let subject = Subjects::of(&thief.identity).condition;
        client.publish_with_reply(subject, "$KV.desired.mill-1", "forged".into()).await.unwrap();
        client.flush().await.unwrap();
    }

    pub(crate) fn raw(&self) -> rusqlite::Connection {
        let raw = rusqlite::Connection::open(self.folder.path().join("centre.db")).unwrap();
        raw.busy_timeout(Duration::from_secs(30)).unwrap();
        raw
    }

    pub(crate) fn name(&self, place: usize) -> &MachineId {
        &self.machines[place].0.identity.machine
    }

    pub(crate) fn rollout(&self, id: u64) -> Rollout {
        self.store.rollout(id).unwrap().unwrap()
    }

    pub(crate) fn issued(&self, place: usize) -> Option<SignedValue> {
        self.store.issued(self.name(place)).unwrap()
    }

    pub(crate) fn is_open(&self, kind: AlarmKind) -> bool {
        let open = self.store.open_alarms().unwrap();
        open.iter().any(|alarm| alarm.kind == kind)
    }

    pub(crate) async fn until_done(&self, id: u64) {
        until("the roll-out is done", || self.rollout(id).phase == Phase::Done).await;
    }

    pub(crate) async fn until_stopped(&self, id: u64, words: &str) {
        until(
            "the roll-out stops",
            || matches!(self.rollout(id).phase, Phase::Stopped { why } if why.contains(words)),
        )
        .await;
    }

    /// Starts a roll-out of the model `number` to all machines. Each number is a different model.
    pub(crate) fn roll_out(&self, number: u32, rules: Rules) -> u64 {
        let all: Vec<usize> = (0..self.machines.len()).collect();
        self.roll_out_to(number, &all, rules)
    }

    pub(crate) fn roll_out_to(&self, number: u32, places: &[usize], rules: Rules) -> u64 {
        let new = model(number);
        self.store.add_model(&new.model, &new.text).unwrap();
        let machines: Vec<_> = (places.iter())
            .map(|place| &self.machines[*place].0)
            .map(|machine| (machine.identity.machine.clone(), machine.canary))
            .collect();
        let begun = self.store.begin_rollout(&new.model.sha256, &machines, rules, "anna");
        begun.unwrap().id
    }
}

pub(crate) fn soak(soak_s: f64) -> Rules {
    Rules { soak_s, ..Rules::default() }
}

pub(crate) fn manifest(value: &[u8]) -> Manifest {
    let desired = Desired::parse(value).unwrap();
    serde_json::from_str(&desired.manifest).unwrap()
}

pub(crate) fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap()
}

pub(crate) async fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let end = Instant::now() + LONG;
    while !is_so() {
        assert!(Instant::now() < end, "{what}: not within {LONG:?}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// A connection between client and server that can be cut: packets are then lost without an error.
pub(crate) struct Wire {
    pub(crate) url: String,
    cut: Arc<AtomicBool>,
}

impl Wire {
    pub(crate) async fn to(server: &str) -> Self {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("nats://{}", listener.local_addr().unwrap());
        let cut = Arc::new(AtomicBool::new(false));
        let task_cut = Arc::clone(&cut);
        let server = server.to_owned();
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let far = tokio::net::TcpStream::connect(&server).await.unwrap();
                let (near_read, near_write) = near.into_split();
                let (far_read, far_write) = far.into_split();
                tokio::spawn(pass(near_read, far_write, Arc::clone(&task_cut)));
                tokio::spawn(pass(far_read, near_write, Arc::clone(&task_cut)));
            }
        });
        Self { url, cut }
    }

    pub(crate) fn cut(&self, cut: bool) {
        self.cut.store(cut, Ordering::Relaxed);
    }
}

/// Forwards bytes. A cut connection holds the bytes back, as TCP retransmits them after a network has lost every
/// packet.
async fn pass(
    from: tokio::net::tcp::OwnedReadHalf,
    mut to: tokio::net::tcp::OwnedWriteHalf,
    cut: Arc<AtomicBool>,
) {
    let mut bytes = vec![0; 65_536];
    loop {
        while cut.load(Ordering::Relaxed) {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        if from.readable().await.is_err() {
            return;
        }
        if cut.load(Ordering::Relaxed) {
            continue;
        }
        match from.try_read(&mut bytes) {
            Ok(0) => return,
            Ok(count) => {
                if to.write_all(&bytes[..count]).await.is_err() {
                    return;
                }
            }
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => {}
            Err(_) => return,
        }
    }
}

/// Number of stored conditions of a machine over all instances, with duplicates.
pub(crate) fn stored(folder: &Path, machine: &str) -> u64 {
    let connection = rusqlite::Connection::open(folder.join("centre.db")).unwrap();
    let recent: i64 = connection
        .query_row("SELECT count(*) FROM recent WHERE machine = ?1", [machine], |row| row.get(0))
        .unwrap();
    let closed: i64 = connection
        .query_row(
            "SELECT coalesce(sum(json_array_length(document)), 0) FROM raw WHERE machine = ?1",
            [machine],
            |row| row.get(0),
        )
        .unwrap();
    u64::try_from(recent + closed).unwrap()
}
