//! The demonstration: a server, three simulated machines and the web interface, in a folder that is removed at the end.
//!
//! `SimulatedMachine` is a machine with its gateway, as visible to the centre. It accepts signed models, asks for
//! confirmation of models with large moves, corrects, and reports its condition. The simulated true machine differs
//! slightly from its model, and it warms up.
//!
//! The reported residual is the error that the model predicts to remain, which is all that a real gateway can know.
//! Like every gateway with a simulated machine, it also reports the true error.

use std::{
    collections::{BTreeMap, HashMap},
    fmt::Display,
    net::{SocketAddr, TcpListener as StdListener},
    path::Path,
    sync::Arc,
    time::Duration,
};

use serde_json::json;
use tempfile::TempDir;
use tokio::{
    task::JoinHandle,
    time::{Instant, MissedTickBehavior},
};
use volcomp_fleet::{
    Acknowledgement, Condition, Desired, Envelope, Identity, Kind, LinkSettings, MachineId,
    MachineLink, MachineUser, Manifest, ModelRef, Outcome, ServerSettings, StreamRetention, Trust,
    VerifyingKey, server::Server,
};
use volcomp_model::{
    Axis, Machine as Model, MapGrid, Temperatures, corrected,
    kinematics::{Form, State},
    quantised,
};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, PerAxis};

use crate::{
    Error,
    clock::now_s,
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
            let truth = Model::parse(model, "built-in")?;
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

const RAMP_S: f64 = 5.0;
/// Change of the correction of a linear axis above which confirmation is required, µm: `confirm_um` of its gateway.
const CONFIRM_UM: f64 = 10.0;
/// Change of the correction of a rotary axis above which confirmation is required, µrad: `confirm_urad`.
const CONFIRM_URAD: f64 = 10.0;
/// Nodes along each axis of the grid on which a change is checked.
const CHECK_NODES: usize = 5;
/// Factor from the errors of the model to the errors of the simulated machine.
const ERROR_FACTOR: f64 = 1.08;

struct SimulatedMachine {
    machine: Machine,
    truth: Model,
    trust: Trust,
    instance: String,
    number: u64,
    begun: Instant,
    active: Option<(Model, u64)>,
    /// Model that the correction ramps from; `None`: no correction.
    from: Option<Model>,
    to: Option<Model>,
    since: Instant,
    disabled: bool,
    cycles: u64,
}

impl SimulatedMachine {
    fn new(machine: &Machine, truth: Model, instance: String, trusted: VerifyingKey) -> Self {
        Self {
            machine: machine.clone(),
            truth,
            trust: Trust {
                keys: vec![trusted],
                machine: machine.identity.machine.clone(),
                serial: machine.serial.clone(),
                axes: machine.axes.clone(),
                highest: 0,
            },
            instance,
            number: 0,
            begun: Instant::now(),
            active: None,
            from: None,
            to: None,
            since: Instant::now(),
            disabled: false,
            cycles: 0,
        }
    }

    async fn run(mut self, link: LinkSettings) {
        let Ok(mut link) = MachineLink::connect(&link, &self.machine.identity).await else {
            tracing::error!("demo: {} has no key", self.machine.identity.machine);
            return;
        };
        let mut conditions = tokio::time::interval(Duration::from_secs(1));
        let mut telemetry = tokio::time::interval(Duration::from_secs(5));
        conditions.set_missed_tick_behavior(MissedTickBehavior::Delay);
        telemetry.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let (kind, body) = tokio::select! {
                value = link.next_desired() => (Kind::Ack, self.desired(&value)),
                _ = conditions.tick() => (Kind::Condition, serde_json::to_value(self.condition())),
                _ = telemetry.tick() => (Kind::Telemetry, Ok(self.state())),
            };
            let Ok(body) = body else { continue };
            self.number += 1;
            let envelope = Envelope {
                instance: self.instance.clone(),
                number: self.number,
                uptime_s: self.begun.elapsed().as_secs_f64(),
                wall_s: now_s(),
                version: self.active.as_ref().map_or(0, |(_, version)| *version),
                model: self.active.as_ref().map_or_else(String::new, |(model, _)| model.checksum()),
                body,
            };
            let id = format!("{}-{}", self.instance, self.number);
            let Ok(bytes) = serde_json::to_vec(&envelope) else {
                continue;
            };
            if let Err(error) = link.publish(kind, &id, bytes.into()).await {
                tracing::debug!("demo: {error}");
            }
        }
    }

    fn desired(&mut self, value: &[u8]) -> serde_json::Result<serde_json::Value> {
        let parsed = Desired::parse(value).map_err(|e| e.to_string());
        let taken = parsed.and_then(|desired| {
            let accepted = self.trust.accept(&desired).map_err(|e| e.to_string())?;
            let text = accepted.model.ok_or("the model is not in the manifest")?;
            let model = Model::parse(&text, "the model").map_err(|e| e.to_string())?;
            Ok((accepted.manifest, model))
        });
        let (version, outcome) = match taken {
            Ok((manifest, model)) => {
                self.trust.highest = manifest.version;
                (manifest.version, self.largest_change(&manifest, model))
            }
            Err(why) => (0, Outcome::Refused { why }),
        };
        serde_json::to_value(Acknowledgement {
            version,
            value_sha256: ModelRef::of(value).sha256,
            outcome,
        })
    }

    /// Applies an authenticated manifest. Returns whether its model was activated or needs a confirmation (rule 13 of
    /// the guard).
    fn largest_change(&mut self, manifest: &Manifest, model: Model) -> Outcome {
        // Disabling takes effect immediately, whatever the outcome for the model.
        if !manifest.enable {
            self.disabled = true;
            self.ramp(None);
        }
        let hash = model.checksum();
        let [worst_um, worst_urad] = self.largest_move(&model);
        let is_far = worst_um > CONFIRM_UM || worst_urad > CONFIRM_URAD;
        if is_far && manifest.confirm.as_ref() != Some(&hash) {
            let has_rotary = (self.machine.axes.iter()).any(|axis| axis.kind() == AxisKind::Rotary);
            return Outcome::NeedsConfirmation {
                hash,
                worst_um: format!("{worst_um:.1}"),
                worst_urad: if has_rotary { format!("{worst_urad:.1}") } else { String::new() },
                differences: Vec::new(),
            };
        }
        self.disabled = !manifest.enable;
        self.ramp(manifest.enable.then(|| model.clone()));
        self.active = Some((model, manifest.version));
        Outcome::Activated
    }

    fn ramp(&mut self, to: Option<Model>) {
        self.from = std::mem::replace(&mut self.to, to);
        self.since = Instant::now();
    }

    /// Maximum change of the correction when a model replaces the active one: of linear axes in µm, of rotary axes in
    /// µrad. The change is sampled on a grid in the work space, with the rotary axes at both ends of their travels and
    /// at the position nearest to zero.
    fn largest_move(&self, new: &Model) -> [f64; 2] {
        let old = self.active.as_ref().map(|(model, _)| model);
        let mut worst = [0.0_f64; 2];
        for stand in
            [|axis: &Axis| axis.travel[0], Axis::nearest_zero, |axis: &Axis| axis.travel[1]]
        {
            let rotary = (new.axes().iter()).filter(|axis| axis.name.kind() == AxisKind::Rotary);
            let at: Vec<(AxisName, f64)> = rotary.map(|axis| (axis.name, stand(axis))).collect();
            let Ok(grid) = MapGrid::over_travels(new, [CHECK_NODES; 3], &at) else {
                return [f64::INFINITY; 2];
            };
            for index in 0..grid.len() {
                let (_, state) = grid.node(new, index);
                let [before, after] = [old, Some(new)].map(|model| correction(model, &state));
                let moves = before.iter().zip(after).map(|(before, after)| after - before);
                for (axis, moved) in self.machine.axes.iter().zip(moves) {
                    match axis.kind() {
                        AxisKind::Linear => worst[0] = worst[0].max(moved.abs() * 1e3),
                        AxisKind::Rotary => worst[1] = worst[1].max(moved.abs() * 1e6),
                    }
                }
            }
        }
        worst
    }

    fn place(&self) -> State {
        let at_s = self.begun.elapsed().as_secs_f64();
        let coordinates: Vec<(AxisName, f64)> = (self.truth.axes().iter().enumerate())
            .map(|(index, axis)| {
                let [low, high] = axis.travel;
                let share = 0.5 + 0.45 * (at_s / (9.0 + 4.0 * index as f64)).sin();
                (axis.name, low + (high - low) * share)
            })
            .collect();
        self.truth.state(&coordinates).unwrap_or_default()
    }

    fn degc(&self) -> BTreeMap<String, Option<f64>> {
        let at_s = self.begun.elapsed().as_secs_f64();
        let warm = |name: &str, rise_k: f64, lag_s: f64| {
            let degc = 20.3 + rise_k * (1.0 - (-at_s / lag_s).exp());
            (name.to_owned(), Some((degc * 100.0).round() / 100.0))
        };
        BTreeMap::from([
            warm("bed", 0.8, 3600.0),
            warm("column", 2.4, 1800.0),
            warm("spindle", 8.0, 600.0),
        ])
    }

    fn ramped(&self) -> f64 {
        (self.since.elapsed().as_secs_f64() / RAMP_S).min(1.0)
    }

    /// The applied correction: mm, rad, in machine order.
    fn applied(&self, state: &State) -> PerAxis<f64> {
        let share = self.ramped();
        let [from, to] = [&self.from, &self.to].map(|model| correction(model.as_ref(), state));
        let mut applied = PerAxis::ZERO;
        for (place, (from, to)) in applied.0.iter_mut().zip(from.into_iter().zip(to)) {
            *place = from + share * (to - from);
        }
        quantised(&self.truth, &applied, 1e-3, 1e-6)
    }

    /// Tool-tip error that the active model predicts with the applied correction, µm.
    fn residual_um(&self, state: &State, applied: &PerAxis<f64>) -> Option<f64> {
        let (model, _) = self.active.as_ref()?;
        Some(length(left_um(model, 1.0, state, applied)))
    }

    fn condition(&mut self) -> Condition {
        let state = self.place();
        let applied = self.applied(&state);
        let mut correction_um = BTreeMap::new();
        let mut correction_urad = BTreeMap::new();
        for (axis, value) in self.machine.axes.iter().zip(applied.0) {
            match axis.kind() {
                AxisKind::Linear => correction_um.insert(*axis, value * 1e3),
                AxisKind::Rotary => correction_urad.insert(*axis, value * 1e6),
            };
        }
        let is_ramping = self.ramped() < 1.0;
        let name = match (&self.from, &self.to) {
            (None, Some(_)) if is_ramping => "arming",
            (_, Some(_)) => "compensating",
            (Some(_), None) if is_ramping => "ramping-out",
            (_, None) => "disarmed",
        };
        let reasons = if self.disabled {
            vec!["disabled by the centre".to_owned()]
        } else if self.active.is_none() && self.trust.highest > 0 {
            vec!["the first model waits for confirmation".to_owned()]
        } else if self.active.is_none() {
            vec!["no model was sent yet".to_owned()]
        } else {
            Vec::new()
        };
        self.cycles += 500;
        Condition {
            state: name.to_owned(),
            reasons,
            armed: self.to.is_some(),
            correction_um,
            correction_urad,
            residual_um: self.residual_um(&state, &applied),
            temperatures_degc: self.degc(),
            cycle_p99_us: 2010.0 + (self.cycles % 7000) as f64 / 100.0,
            overruns: 0,
            faults: 0,
        }
    }

    /// The part of the full telemetry that the web interface shows.
    fn state(&self) -> serde_json::Value {
        let state = self.place();
        let mut positions_mm = BTreeMap::new();
        let mut positions_deg = BTreeMap::new();
        for (axis, q) in self.machine.axes.iter().zip(state.q.0) {
            let shown = Displacement::new(axis.kind(), q).mm_or_deg();
            match axis.kind() {
                AxisKind::Linear => positions_mm.insert(*axis, shown),
                AxisKind::Rotary => positions_deg.insert(*axis, shown),
            };
        }
        // Number of cycles that ended within each time, µs.
        let permille = [(1950, 2), (2000, 600), (2050, 370), (2100, 20), (2200, 7), (2500, 1)];
        let histogram: Vec<(u64, u64)> =
            (permille.iter()).map(|&(edge, share)| (edge, self.cycles * share / 1000)).collect();
        let none = PerAxis::ZERO;
        json!({
            "simulated": true,
            "true_error_um": left_um(&self.truth, ERROR_FACTOR, &state, &none),
            "true_residual_um": left_um(&self.truth, ERROR_FACTOR, &state, &self.applied(&state)),
            "positions_mm": positions_mm,
            "positions_deg": positions_deg,
            "cycle": { "period_us": 2000.0, "count": self.cycles, "overruns": 0, "p99_us": 2090.0, "histogram_us": histogram },
        })
    }
}

/// The correction of a model, mm and rad in machine order; zero without a model.
fn correction(model: Option<&Model>, state: &State) -> [f64; 9] {
    model.map_or([0.0; 9], |model| {
        let options = model.correction_options();
        let correction = model.correction_at(state, &Temperatures::new(), &options);
        correction.delta.0
    })
}

/// Tool-tip error with a correction, µm along X, Y, Z, of a machine whose errors are `factor` times those of the model.
fn left_um(model: &Model, factor: f64, state: &State, applied: &PerAxis<f64>) -> [f64; 3] {
    let error = model.error_at(state, Form::Exact, &Temperatures::new());
    let chain = model.chain();
    let moved = chain.ideal_tip_mm(&corrected(state, applied)) - chain.ideal_tip_mm(state);
    let left = error.position_mm * factor + moved;
    [left.x, left.y, left.z].map(|mm| mm * 1e3)
}

fn length(vector: [f64; 3]) -> f64 {
    vector.iter().map(|part| part * part).sum::<f64>().sqrt()
}
