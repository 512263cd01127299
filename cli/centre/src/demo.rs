//! The demonstration: a server, three simulated machines and the web interface, in a folder that is removed at the end.

mod machine;

use std::{
    collections::HashMap,
    fmt::Display,
    net::{SocketAddr, TcpListener as StdListener},
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

use tempfile::TempDir;
use tokio::task::JoinHandle;
use volcomp_fleet::{
    Identity, LinkSettings, MachineId, MachineUser, ServerSettings, StreamRetention, server::Server,
};
use volcomp_model::Machine as ModelMachine;

use self::machine::SimulatedMachine;
use crate::{
    Error,
    engine::{Engine, Running, Settings},
    http::{PageSettings, PageState, router},
    keys::Key,
    models::NewModel,
    records::{Machine, Origin},
    rollout::{Rules, Step, UserRequest},
    store::{Retention, Store},
    users::{Password, Role, Token, hash},
};

/// Machines: name, serial number, control, model.
const MACHINES: [(&str, &str, &str, &str); 3] = [
    ("mill-1", "4711", "FANUC, simulated", include_str!("../demo/mill-1.toml")),
    ("mill-2", "0815", "SINUMERIK, simulated", include_str!("../demo/mill-2.toml")),
    ("five-1", "2026", "FANUC, simulated", include_str!("../demo/five-1.toml")),
];
const SITE: &str = "demo";
const ADMIN: &str = "demo";

fn random_password() -> Result<Token, Error> {
    Token::generate().map_err(key)
}

fn io(what: impl Into<String>) -> impl FnOnce(std::io::Error) -> Error {
    let file = what.into();
    |source| Error::File { file, source }
}

/// Error for a key that cannot be generated.
fn key(error: impl Display) -> Error {
    Error::Failed(format!("a key: {error}"))
}

/// A running demonstration; end it with [`Demo::end`]. Dropping it stops the server and removes the folder.
pub struct Demo {
    pub address: SocketAddr,
    pub user: &'static str,
    pub password: String,
    engine: Option<Running>,
    tasks: Vec<JoinHandle<()>>,
    /// The server must end before its folder is removed.
    server: Option<Server>,
    folder: TempDir,
}

impl Demo {
    /// Starts the demonstration on the runtime of the caller; the web interface listens on `listen`.
    pub async fn start(listen: SocketAddr) -> Result<Self, Error> {
        let folder = tempfile::tempdir().map_err(io("a temporary folder"))?;
        let std = StdListener::bind(listen).map_err(io(format!("the page on {listen}")))?;
        std.set_nonblocking(true).map_err(io("the page"))?;
        let address = std.local_addr().map_err(io("the page"))?;
        let listener = tokio::net::TcpListener::from_std(std).map_err(io("the page"))?;

        let pair = || nkeys::KeyPair::new_user();
        let seed = |pair: &nkeys::KeyPair| pair.seed().map_err(key);
        let centre = pair();
        let machines: Vec<(Machine, nkeys::KeyPair, &str)> = MACHINES
            .iter()
            .map(|(name, serial, control, model)| {
                let user = pair();
                registered(name, serial, control, model, &user)
                    .map(|machine| (machine, user, *model))
            })
            .collect::<Result<_, _>>()?;
        let users = machines.iter().map(|(machine, user, _)| MachineUser {
            identity: machine.identity.clone(),
            nkey: user.public_key(),
        });
        let free = StdListener::bind("127.0.0.1:0").and_then(|free| free.local_addr());
        let settings = ServerSettings {
            name: "demo".to_owned(),
            listen: free.map_err(io("the server"))?.to_string(),
            store: folder.path().join("server"),
            tls: None,
            cluster: None,
            centres: vec![centre.public_key()],
            machines: users.collect(),
        };
        let at = folder.path().to_owned();
        let started = tokio::task::spawn_blocking(move || Server::start(&settings, &at)).await;
        let server = started.map_err(key)?;
        let server = server.map_err(|error| Error::Failed(error.to_string()))?;

        let (store, password) = prepared(folder.path(), &machines)?;
        let link = |seed: String| LinkSettings { url: server.url(), seed, roots: None };
        let key = Key::create(folder.path(), "demo").map_err(key)?;
        let trusted = key.key.verifying_key();
        let settings = Settings {
            link: link(seed(&centre)?),
            stream_retention: StreamRetention::default(),
            keep: Retention::default(),
            own: vec![key.clone()],
            key,
        };
        let engine = Engine::start(Arc::clone(&store), settings).await?;
        let mut tasks = Vec::new();
        for (machine, user, model) in &machines {
            let truth = ModelMachine::parse(model, "built-in")?;
            let instance: String = random_password()?.text().chars().take(16).collect();
            let simulated = SimulatedMachine::new(machine, truth, instance, trusted);
            tasks.push(tokio::spawn(simulated.run(link(seed(user)?))));
        }
        let page = PageState::new(
            Arc::clone(&store),
            PageSettings { notice: notice(), ..PageSettings::default() },
        );
        tasks.push(tokio::spawn(confirm(Arc::clone(&store))));
        tasks.push(tokio::spawn(Arc::clone(&page).refresh()));
        tasks.push(tokio::spawn(volcomp_web::serve(listener, None, router(&page))));
        Ok(Self {
            address,
            user: ADMIN,
            password,
            engine: Some(engine),
            tasks,
            server: Some(server),
            folder,
        })
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn server_id(&self) -> Option<u32> {
        self.server.as_ref().map(Server::id)
    }

    pub async fn end(mut self) {
        for task in &self.tasks {
            task.abort();
        }
        if let Some(engine) = self.engine.take() {
            engine.end().await;
        }
    }
}

fn notice() -> String {
    format!(
        "Demonstration: simulated machines, invented models, and nothing is kept. A model that moves the axes far waits for \
         Confirm under Roll-outs, as on a real machine; after {} s the demonstration confirms it automatically.",
        AUTO_CONFIRM_DELAY.as_secs()
    )
}

fn built_in(text: &str, machine: &str) -> Result<NewModel, Error> {
    let name = format!("{machine}.toml");
    NewModel::of_text(text.to_owned(), machine, Origin::File { name }, ADMIN)
}

fn registered(
    name: &str,
    serial: &str,
    control: &str,
    model: &str,
    user: &nkeys::KeyPair,
) -> Result<Machine, Error> {
    let NewModel { model, .. } = built_in(model, name)?;
    Ok(Machine {
        identity: Identity {
            site: SITE.parse().map_err(key)?,
            machine: name.parse().map_err(key)?,
        },
        serial: serial.to_owned(),
        structure: model.structure,
        axes: model.axes,
        nkey: Some(user.public_key()),
        address: "this computer".to_owned(),
        control: control.to_owned(),
        enable: true,
        canary: false,
        due_days: Some(365),
        condition_s: None,
        telemetry_s: Some(5),
        note: String::new(),
    })
}

/// A store with the machines, roll-outs of their models and an admin with a generated password.
fn prepared(
    folder: &Path,
    machines: &[(Machine, nkeys::KeyPair, &str)],
) -> Result<(Arc<Store>, String), Error> {
    let store = Store::open(&folder.join("centre.sqlite"))?;
    // 80 bits, in groups that are easy to type.
    let letters: Vec<char> = random_password()?.text().chars().take(20).collect();
    let groups: Vec<String> = letters.chunks(5).map(|group| group.iter().collect()).collect();
    let password = groups.join("-");
    let chosen = Password::chosen(password.clone()).map_err(key)?;
    let hashed = hash(&chosen).map_err(key)?;
    let admin = ADMIN.parse().map_err(key)?;
    store.add_user(&admin, Role::Admin, &hashed, "centre", "demo")?;
    for (machine, _, text) in machines {
        store.put_machine(machine, ADMIN)?;
        let name = machine.identity.machine.to_string();
        let mut new = built_in(text, &name)?;
        "2026-03-02".clone_into(&mut new.model.measured);
        let invented = "This model is part of the demonstration: nothing was measured, and the day of the measurement is invented";
        new.model.notes.push(invented.to_owned());
        store.add_model(&new.model, &new.text)?;
        let chosen = [(machine.identity.machine.clone(), true)];
        let rules = Rules { soak_s: 30.0, ..Rules::default() };
        store.begin_rollout(&new.model.sha256, &chosen, rules, ADMIN)?;
    }
    Ok((Arc::new(store), password))
}

/// Time after which the demonstration confirms a change if the operator has not.
pub const AUTO_CONFIRM_DELAY: Duration = Duration::from_secs(20);
/// User name of automatic confirmations in the audit log.
const CONFIRMED_BY: &str = "demonstration";

type PendingConfirmation = (u64, MachineId, String);

/// Confirms changes that have waited for [`AUTO_CONFIRM_DELAY`], until the runtime ends.
async fn confirm(store: Arc<Store>) {
    let mut since: HashMap<PendingConfirmation, Instant> = HashMap::new();
    let mut ticks = tokio::time::interval(Duration::from_secs(1));
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let store = Arc::clone(&store);
        let pass = tokio::task::spawn_blocking(move || {
            let result = confirm_due(&store, &mut since);
            (result, since)
        });
        match pass.await {
            Ok((result, kept)) => {
                since = kept;
                if let Err(error) = result {
                    tracing::warn!("demo: {error}");
                }
            }
            Err(error) => {
                tracing::error!("demo: {error}");
                return;
            }
        }
    }
}

fn confirm_due(
    store: &Store,
    since: &mut HashMap<PendingConfirmation, Instant>,
) -> Result<(), Error> {
    let mut waiting = Vec::new();
    for id in store.open_rollouts()? {
        let Some(rollout) = store.rollout(id)? else {
            continue;
        };
        for target in rollout.targets {
            if let Step::NeedsConfirmation { hash, .. } = target.step {
                waiting.push((id, target.machine, hash));
            }
        }
    }
    since.retain(|known, _| waiting.contains(known));
    for one in waiting {
        let begun = *since.entry(one.clone()).or_insert_with(Instant::now);
        if begun.elapsed() >= AUTO_CONFIRM_DELAY {
            let (id, machine, hash) = one.clone();
            match store.request_rollout_change(
                id,
                &UserRequest::Confirm { machine, hash },
                CONFIRMED_BY,
            ) {
                // The user has resumed or stopped the roll-out since it was read.
                Ok(()) | Err(Error::NotConfirmed(_)) => {}
                Err(error) => return Err(error),
            }
            // The engine applies the confirmation within a second. If it does not, the change is confirmed again after
            // [`AUTO_CONFIRM_DELAY`].
            since.insert(one, Instant::now());
        }
    }
    Ok(())
}
