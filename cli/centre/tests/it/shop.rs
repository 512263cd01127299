//! A server, a centre and gateways, for the tests of the whole.

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
    records::Machine,
    rollout::Rules,
    store::{Keep, Store},
};
use volcomp_fleet::{
    Keeping, LinkSettings, MachineUser, ServerSettings, SigningKey,
    server::{Server, program},
};

use crate::{
    gateway::{self, Plan, Told},
    support::{machine, model},
};

/// Everything that is waited for comes within this time, on the slowest machine.
pub(crate) const LONG: Duration = Duration::from_secs(120);

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
    /// So many servers in a cluster, and so many machines; `None` where the server is not installed, which fails under CI.
    pub(crate) fn new(servers: usize, machines: usize) -> Option<Self> {
        let in_a_file = |folder: &Path| Store::open(&folder.join("centre.db")).unwrap();
        Self::with_store(servers, machines, in_a_file)
    }

    /// The same with another store; it is told a folder of its own.
    pub(crate) fn with_store(
        servers: usize,
        machines: usize,
        open: impl FnOnce(&Path) -> Store,
    ) -> Option<Self> {
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
        let routes: Vec<String> = (0..servers)
            .map(|_| volcomp_test_support::free_address())
            .collect();
        let settings: Vec<ServerSettings> = (0..servers)
            .map(|place| ServerSettings {
                name: format!("server-{place}"),
                listen: volcomp_test_support::free_address(),
                store: folder.path().join(format!("streams-{place}")),
                tls: None,
                cluster: (servers > 1).then(|| volcomp_fleet::Cluster {
                    name: "shop".to_owned(),
                    listen: routes[place].clone(),
                    routes: routes
                        .iter()
                        .map(|route| format!("nats://{route}"))
                        .collect(),
                    password: volcomp_fleet::RoutePassword::of_seed(&centre.seed().unwrap()),
                    roots: None,
                }),
                centres: vec![centre.public_key()],
                machines: users.clone(),
            })
            .collect();
        let store = Arc::new(open(folder.path()));
        for (machine, _) in &machines {
            store.put_machine(machine, "anna").unwrap();
        }
        let mut shop = Self {
            servers: (0..servers).map(|_| None).collect(),
            settings,
            centre,
            machines,
            key: Key {
                name: "main".to_owned(),
                key: SigningKey::from_bytes(&[7; 32]),
            },
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

    /// Starts the centre with this address of the server.
    pub(crate) async fn centre(&self, url: &str) -> Running {
        let settings = Settings {
            link: LinkSettings {
                url: url.to_owned(),
                seed: self.centre.seed().unwrap(),
                roots: None,
            },
            keeping: Keeping {
                replicas: self.settings.len(),
                ..Keeping::default()
            },
            keep: Keep::default(),
            key: self.key.clone(),
            own: vec![self.key.clone()],
        };
        Engine::start(Arc::clone(&self.store), settings)
            .await
            .unwrap()
    }

    pub(crate) fn plan(&self, place: usize, instance: &str) -> Plan {
        let (machine, key) = &self.machines[place];
        Plan {
            link: LinkSettings {
                url: self.url(),
                seed: key.seed().unwrap(),
                roots: None,
            },
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

    /// Starts the gateway of a machine.
    pub(crate) fn gateway(&self, place: usize) -> (Told, tokio::task::JoinHandle<()>) {
        let told = Told::default();
        let plan = self.plan(place, &format!("run-{place}"));
        (told.clone(), tokio::spawn(gateway::run(plan, told)))
    }

    /// Waits until this version stands under the key of a machine; 0: nothing.
    pub(crate) async fn until_under_key(&self, place: usize, version: u64) {
        let settings = LinkSettings {
            url: self.url(),
            seed: self.centre.seed().unwrap(),
            roots: None,
        };
        let hub = volcomp_fleet::Hub::connect(&settings).await.unwrap();
        let machine = &self.machines[place].0.identity.machine;
        let end = Instant::now() + LONG;
        loop {
            let found = hub.desired(machine).await.map(|value| {
                value.map_or(0, |value| {
                    let desired = volcomp_fleet::Desired::parse(&value).unwrap();
                    let manifest: volcomp_fleet::Manifest =
                        serde_json::from_str(&desired.manifest).unwrap();
                    manifest.version
                })
            });
            if found.as_ref().is_ok_and(|found| *found == version) {
                return;
            }
            assert!(Instant::now() < end, "version {version}: found {found:?}");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Starts a roll-out to all machines; another number is another model.
    pub(crate) fn roll_out(&self, number: u32, rules: Rules) -> u64 {
        let all: Vec<usize> = (0..self.machines.len()).collect();
        self.roll_out_to(number, &all, rules)
    }

    /// The same to some of the machines.
    pub(crate) fn roll_out_to(&self, number: u32, places: &[usize], rules: Rules) -> u64 {
        let new = model(number);
        self.store.add_model(&new.model, &new.text).unwrap();
        let machines: Vec<_> = (places.iter())
            .map(|place| &self.machines[*place].0)
            .map(|machine| (machine.identity.machine.clone(), machine.canary))
            .collect();
        let begun = self
            .store
            .begin_rollout(&new.model.sha256, &machines, rules, "anna");
        begun.unwrap().id
    }
}

pub(crate) fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap()
}

/// Waits until it is so.
pub(crate) async fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let end = Instant::now() + LONG;
    while !is_so() {
        assert!(Instant::now() < end, "{what}: not within {LONG:?}");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// A wire between a client and a server that can be cut: nothing passes any more, and nobody is told.
pub(crate) struct Wire {
    pub(crate) url: String,
    cut: Arc<AtomicBool>,
}

impl Wire {
    pub(crate) async fn to(server: &str) -> Self {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("nats://{}", listener.local_addr().unwrap());
        let cut = Arc::new(AtomicBool::new(false));
        let of_task = Arc::clone(&cut);
        let server = server.to_owned();
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let far = tokio::net::TcpStream::connect(&server).await.unwrap();
                let (near_read, near_write) = near.into_split();
                let (far_read, far_write) = far.into_split();
                tokio::spawn(pass(near_read, far_write, Arc::clone(&of_task)));
                tokio::spawn(pass(far_read, near_write, Arc::clone(&of_task)));
            }
        });
        Self { url, cut }
    }

    pub(crate) fn cut(&self, cut: bool) {
        self.cut.store(cut, Ordering::Relaxed);
    }
}

/// Passes bytes on. While the wire is cut they are held, as by a network that loses every packet: what is sent again arrives
/// when it heals.
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

/// The numbers of the conditions of a machine that are stored, over all its runs: how many, and how many twice.
pub(crate) fn stored(folder: &Path, machine: &str) -> u64 {
    let connection = rusqlite::Connection::open(folder.join("centre.db")).unwrap();
    let recent: i64 = connection
        .query_row(
            "SELECT count(*) FROM recent WHERE machine = ?1",
            [machine],
            |row| row.get(0),
        )
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
