//! One pass of the engine: advances roll-outs, raises and closes alarms, maintains the history. A pass may block on the
//! disk.
//!
//! Each pass gives every active roll-out its observations and outcomes, and executes the actions of the roll-out. It
//! writes issued values under the keys of the machines, and restores values that another client has overwritten.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures_util::StreamExt;
use rusqlite::Connection;
use volcomp_fleet::{
    Desired, DesiredEvent, DesiredValue, DesiredWatch, MachineId, Manifest, ModelRef, SiteId,
};

use crate::{
    Error,
    clock::now_s,
    engine::{Engine, alarms, blocking, lock},
    issue::{Order, differs, issue, settle, withdraw},
    records::{AlarmKind, Machine, Model, Version},
    rollout::{Action, Event, Observation, Phase, Rollout},
    store::{SignedValue, machines::machine_named, models as stored},
    versions::active_version,
};

/// Interval at which the one-minute means of the history are completed.
const MINUTE: Duration = Duration::from_secs(60);
/// Minimum time from the end of a minute until the minute is closed, s: most delayed messages have arrived by then.
const CLOSED_AFTER_S: f64 = 30.0;
/// Interval at which expired data are deleted.
const HOUR: Duration = Duration::from_secs(3600);

pub(super) struct State {
    last: Instant,
    minute: Instant,
    hour: Option<Instant>,
    /// Last known residual of each machine, µm. A pass may lie between two conditions.
    residual_um: BTreeMap<MachineId, f64>,
    /// Machines whose settings cannot be sent, with the reason.
    unsettled: BTreeMap<MachineId, String>,
    pub(super) alarms: alarms::State,
}

impl State {
    pub(super) fn new() -> Self {
        let now = Instant::now();
        Self {
            last: now,
            minute: now,
            hour: None,
            residual_um: BTreeMap::new(),
            unsettled: BTreeMap::new(),
            alarms: alarms::State::default(),
        }
    }
}

pub(super) async fn sites(engine: &Arc<Engine>) -> BTreeSet<SiteId> {
    let engine_clone = Arc::clone(engine);
    let machines = blocking(move || engine_clone.store.machines()).await;
    let machines = machines.unwrap_or_default();
    machines.into_iter().map(|machine| machine.identity.site).collect()
}

/// Runs one pass. Database errors are reported, and the next pass tries again.
pub(super) async fn run(engine: &Arc<Engine>, state: State) -> State {
    let engine = Arc::clone(engine);
    blocking(move || {
        let mut state = state;
        if let Err(error) = run_pass(&engine, &mut state) {
            engine.set_failure(AlarmKind::Store, Some(error.to_string()));
        }
        state
    })
    .await
}

fn run_pass(engine: &Engine, state: &mut State) -> Result<(), Error> {
    let now = Instant::now();
    let elapsed_s = now.duration_since(state.last).as_secs_f64();
    state.last = now;
    let machines = engine.store.machines()?;
    let (seen, since) = {
        let mut ingest = lock(&engine.ingest);
        ingest.store_live(&engine.store)?;
        let limits: BTreeMap<&MachineId, f64> = (machines.iter())
            .map(|machine| (&machine.identity.machine, machine.silent_after_s()))
            .collect();
        let taken =
            ingest.take_observations(|name| limits.get(name).copied().unwrap_or(Machine::SILENT_S));
        for (machine, seen) in &taken.0 {
            let condition = || ingest.machine(machine)?.live.as_ref()?.condition.as_ref();
            let known = seen.residual_um.or_else(|| condition()?.residual_um);
            if let Some(um) = known.filter(|um| um.is_finite()) {
                state.residual_um.insert(machine.clone(), um);
            }
        }
        taken
    };
    let blocked = match advance_all(engine, elapsed_s, &seen, &state.residual_um) {
        Ok(blocked) => blocked,
        Err(error) => {
            // The next pass processes these events before later ones.
            lock(&engine.ingest).restore_events(since);
            return Err(error);
        }
    };
    let unprocessed = since.into_iter().filter(|(name, _)| blocked.holds(name));
    lock(&engine.ingest).restore_events(unprocessed.collect());
    let why = (!blocked.why.is_empty()).then(|| blocked.why.join(" "));
    engine.set_failure(AlarmKind::Rollout, why);
    let versions = engine.store.newest_versions()?;
    settle_all(engine, &mut state.unsettled, &machines, &versions)?;
    alarms::update(engine, &mut state.alarms, &machines, &versions)?;
    if now.duration_since(state.minute) >= MINUTE {
        state.minute = now;
        lock(&engine.ingest).count_missing();
        engine.store.close_minutes(now_s() - CLOSED_AFTER_S)?;
    }
    if state.hour.is_none_or(|hour| now.duration_since(hour) >= HOUR) {
        state.hour = Some(now);
        engine.store.delete_expired(engine.settings.keep, now_s())?;
    }
    Ok(())
}

/// Maximum number of machines that are sent changed settings in one pass.
const MAX_SETTLED_PER_PASS: usize = 200;

fn settle_all(
    engine: &Engine,
    unsettled: &mut BTreeMap<MachineId, String>,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
) -> Result<(), Error> {
    let before = std::mem::take(unsettled);
    let mut issued = 0;
    for machine in machines {
        let name = &machine.identity.machine;
        if issued == MAX_SETTLED_PER_PASS {
            break;
        }
        let has_changed = if let Some(newest) = versions.get(name) {
            differs(machine, newest)
        } else {
            // A machine whose key holds no value continues with its active version.
            let live =
                lock(&engine.ingest).machine(name).and_then(|reception| reception.live.clone());
            match live.filter(|live| live.version > 0) {
                Some(live) => {
                    let versions = engine.store.versions(name)?;
                    active_version(&versions, Some(&live)).is_some_and(|one| differs(machine, one))
                }
                None => false,
            }
        };
        if !has_changed {
            continue;
        }
        match settle(&engine.store, &engine.settings.key, name, "centre") {
            Ok(_) => issued += 1,
            Err(error) if error.is_of_database() => return Err(error),
            Err(other) => {
                let why = other.to_string();
                if before.get(name) != Some(&why) {
                    tracing::error!("the settings of {name} are not sent: {why}");
                }
                unsettled.insert(name.clone(), why);
            }
        }
    }
    Ok(())
}

/// Roll-outs that could not be advanced.
#[derive(Default)]
struct Blocked {
    /// The reasons, one sentence each.
    pub(super) why: Vec<String>,
    /// Machines of the roll-outs that were advanced, if a blocked roll-out could not be read, so that its machines are
    /// unknown; otherwise `None`.
    moved: Option<BTreeSet<MachineId>>,
    /// Machines of the blocked roll-outs; each machine is in at most one open roll-out.
    machines: BTreeSet<MachineId>,
}

impl Blocked {
    /// True if the roll-out of a machine may not have processed the machine's reports.
    pub(super) fn holds(&self, machine: &MachineId) -> bool {
        self.machines.contains(machine)
            || (self.moved.as_ref()).is_some_and(|moved| !moved.contains(machine))
    }
}

/// Advances every roll-out in its own transaction together with the manifests it issues. A roll-out that fails does not block the others.
fn advance_all(
    engine: &Engine,
    elapsed_s: f64,
    seen: &BTreeMap<MachineId, Observation>,
    residual_um: &BTreeMap<MachineId, f64>,
) -> Result<Blocked, Error> {
    let open = engine.store.open_rollouts()?;
    if open.is_empty() {
        return Ok(Blocked::default());
    }
    // Each pass reads the outcomes from the store, so a centre that was killed before evaluating them does so after its
    // restart.
    let versions = engine.store.newest_versions()?;
    // A version that was never issued here belongs to no roll-out, even if a machine reports it.
    let mut seen = seen.clone();
    for (machine, seen) in &mut seen {
        let newest = versions.get(machine).map_or(0, |version| version.version);
        if seen.version > newest {
            seen.version = 0;
        }
    }
    let input = PassInput { elapsed_s, seen, residual_um, versions };
    let mut blocked = Blocked::default();
    let (mut moved, mut all_known) = (BTreeSet::new(), true);
    for id in open {
        match advance(engine, id, &input) {
            Ok(machines) => moved.extend(machines),
            Err(error) => {
                blocked.why.push(format!("Roll-out {id} cannot proceed: {error}."));
                match engine.store.rollout(id) {
                    Ok(rollout) => {
                        blocked.machines.extend(rollout.into_iter().flat_map(machines_of));
                    }
                    Err(_) => all_known = false,
                }
            }
        }
    }
    blocked.moved = (!all_known).then_some(moved);
    Ok(blocked)
}

struct PassInput<'a> {
    elapsed_s: f64,
    seen: BTreeMap<MachineId, Observation>,
    residual_um: &'a BTreeMap<MachineId, f64>,
    versions: BTreeMap<MachineId, Version>,
}

fn machines_of(rollout: Rollout) -> impl Iterator<Item = MachineId> {
    rollout.targets.into_iter().map(|target| target.machine)
}

fn advance(
    engine: &Engine,
    id: u64,
    input: &PassInput<'_>,
) -> Result<impl Iterator<Item = MachineId> + use<>, Error> {
    let Some(rollout) = engine.store.rollout(id)? else {
        return Ok(None.into_iter().flat_map(machines_of));
    };
    let model = engine.store.model(&rollout.model)?;
    let text = engine.store.model_text(&rollout.model)?;
    // If the database is an older copy, a machine may have another model under the same version.
    let mut seen = input.seen.clone();
    if let Some(model) = &model {
        for other in seen.values_mut().filter(|seen| seen.model != model.checksum) {
            other.version = 0;
        }
    }
    let source = ManifestSource {
        engine,
        model: model.as_ref().zip(text.as_deref()),
        residual_um: input.residual_um,
    };
    engine.store.write(|database| {
        let Some((mut rollout, requests)) = stored::take(database, id)? else {
            return Ok(());
        };
        let before = rollout.clone();
        let wished = (requests.into_iter()).map(|(request, by)| Event::Requested { request, by });
        let answered = answers(&rollout, &input.versions);
        let heard = Event::Pass { elapsed_s: input.elapsed_s, seen };
        for event in wished.chain(answered).chain([heard]) {
            let actions = rollout.step(event);
            source.execute(database, &mut rollout, actions)?;
        }
        if rollout == before {
            return Ok(());
        }
        stored::save(database, &rollout, &before.phase)
    })?;
    Ok(Some(rollout).into_iter().flat_map(machines_of))
}

/// Outcomes that the roll-out has not processed yet.
fn answers(rollout: &Rollout, versions: &BTreeMap<MachineId, Version>) -> Vec<Event> {
    let answered = rollout.targets.iter().filter_map(|target| {
        let version = versions.get(&target.machine)?;
        // The outcome of a later manifest with the previous model does not apply to this roll-out's model.
        let is_of_rollout = version.rollout.is_none_or(|id| id == rollout.id);
        let outcome = version.outcome.clone()?;
        (is_of_rollout && target.step.is_new_outcome(version.version, &outcome)).then(|| {
            Event::Answered { machine: target.machine.clone(), version: version.version, outcome }
        })
    });
    answered.collect()
}

struct ManifestSource<'a> {
    engine: &'a Engine,
    model: Option<(&'a Model, &'a str)>,
    residual_um: &'a BTreeMap<MachineId, f64>,
}

impl ManifestSource<'_> {
    fn execute(
        &self,
        database: &Connection,
        rollout: &mut Rollout,
        mut actions: Vec<Action>,
    ) -> Result<(), Error> {
        // The roll-out receives the result of each issue immediately, and the resulting actions are executed in the
        // next iteration.
        while !actions.is_empty() {
            let mut more = Vec::new();
            for action in actions {
                let (machine, confirm) = match action {
                    Action::Issue { machine, confirm } => (machine, confirm),
                    Action::Withdraw { machine } => {
                        withdraw(database, &self.engine.settings.key, &machine, rollout.id)?;
                        continue;
                    }
                };
                // An earlier action may have stopped the roll-out.
                if confirm.is_none() && rollout.phase != Phase::Running {
                    continue;
                }
                let event = match self.issue(database, rollout, &machine, confirm) {
                    Ok(issued) => Event::Issued {
                        before_um: self.residual_um.get(&machine).copied(),
                        version: issued.version,
                        machine,
                    },
                    Err(error) if error.is_of_database() => return Err(error),
                    Err(other) => Event::NotIssued { machine, why: other.to_string() },
                };
                more.extend(rollout.step(event));
            }
            // The roll-out repeats the pending actions of other machines at each step.
            more.retain(|action| match action {
                Action::Issue { machine, .. } => rollout.is_waiting(machine),
                Action::Withdraw { .. } => true,
            });
            more.dedup();
            actions = more;
        }
        Ok(())
    }

    fn issue(
        &self,
        database: &Connection,
        rollout: &Rollout,
        name: &MachineId,
        confirm: Option<String>,
    ) -> Result<SignedValue, Error> {
        // Read in this transaction: the machine may have been disabled since the pass began.
        let machine = machine_named(database, name)?;
        let machine = machine.ok_or_else(|| Error::missing("machine", name))?;
        let (model, text) = self.model.ok_or_else(|| Error::missing("model", &rollout.model))?;
        let order = Order {
            machine: &machine,
            model,
            text,
            confirm,
            rollout: Some(rollout.id),
            by: &rollout.by,
        };
        issue(database, &self.engine.settings.key, &order)
    }
}

const MAX_CONCURRENT: usize = 64;
/// Delay before a foreign value is checked again: the centre may already be writing its next value.
const RECHECK_DELAY: Duration = Duration::from_millis(200);
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Sends every issued value that is not yet under its machine's key. The next pass retries failures. Of several failures
/// the alphabetically first is returned, so that the alarm does not alternate.
pub(super) async fn send(engine: &Arc<Engine>) -> Result<(), String> {
    if !engine.is_connected() {
        return Ok(());
    }
    let engine_clone = Arc::clone(engine);
    let due = match blocking(move || due(&engine_clone)).await {
        Ok(due) => due,
        Err(error) => {
            engine.set_failure(AlarmKind::Store, Some(error.to_string()));
            return Ok(());
        }
    };
    let puts = due.into_iter().map(|issued| put(engine, issued));
    let mut puts = futures_util::stream::iter(puts).buffer_unordered(MAX_CONCURRENT);
    let mut failures = Vec::new();
    while let Some(done) = puts.next().await {
        failures.extend(done.err().map(|error| error.to_string()));
    }
    failures.into_iter().min().map_or(Ok(()), Err)
}

/// Issued values that this program has not yet put under their machines' keys. Other programs, such as the command
/// line, also issue values.
fn due(engine: &Engine) -> Result<Vec<SignedValue>, Error> {
    let wanted = engine.store.desired_versions()?;
    let put = lock(&engine.put).clone();
    let is_put = |machine: &MachineId, version: u64, has_value: bool| {
        put.get(machine)
            .is_some_and(|(known, value)| *known >= version && (has_value || value.is_empty()))
    };
    let mut due = Vec::new();
    for (machine, (version, has_value)) in wanted {
        if is_put(&machine, version, has_value) {
            continue;
        }
        if has_value {
            due.extend(engine.store.issued(&machine)?);
        } else {
            due.push(SignedValue { machine, version, model: String::new(), value: String::new() });
        }
    }
    Ok(due)
}

/// The value under a key; an empty value is a deletion.
fn non_empty(value: Option<&Bytes>) -> Option<&Bytes> {
    value.filter(|value| !value.is_empty())
}

async fn put(engine: &Arc<Engine>, issued: SignedValue) -> Result<(), Error> {
    let value = Bytes::from(issued.value);
    // Put the model first: a machine requests it as soon as it reads the manifest.
    let inline =
        value.is_empty() || Desired::parse(&value).is_ok_and(|desired| desired.model.is_some());
    let text = if inline {
        None
    } else {
        let (engine_clone, model) = (Arc::clone(engine), issued.model.clone());
        match blocking(move || engine_clone.store.model_text(&model)).await {
            Ok(text) => text,
            Err(error) => {
                // The next pass retries the manifest and its model.
                engine.set_failure(AlarmKind::Store, Some(error.to_string()));
                return Ok(());
            }
        }
    };
    if let Some(text) = text {
        engine
            .hub
            .put_model(
                &issued.machine,
                &issued.model,
                text.as_bytes(),
                engine.settings.stream_retention.replicas,
            )
            .await?;
    }
    // After a restart the key may already hold the value; putting it again would notify the machine needlessly.
    let found = engine.hub.desired(&issued.machine).await?;
    if non_empty(found.as_ref()) != non_empty(Some(&value)) {
        if let Some(found) = found
            && !was_issued(engine, &issued.machine, &found).await
        {
            match own_manifest(engine, &found) {
                None => report_foreign_value(engine, &issued.machine),
                Some(newer)
                    if newer.machine == issued.machine && newer.version >= issued.version =>
                {
                    return Err(Error::Conflict(format!(
                        "{}: found version {} of this centre at the server, which the database does not know: the database is an older copy, and its version {} is not sent; start a new roll-out, whose version is above the one that the machine reports",
                        issued.machine, newer.version, issued.version
                    )));
                }
                Some(_) => {}
            }
        }
        engine.hub.put_desired(&issued.machine, value.clone()).await?;
    }
    lock(&engine.put).insert(issued.machine, (issued.version, value));
    Ok(())
}

pub(super) async fn watch(engine: Arc<Engine>) {
    loop {
        match engine.hub.watch_desired().await {
            Ok(watch) => restore_on_change(&engine, watch).await,
            Err(error) => tracing::warn!("listening to the keys: {error}"),
        }
        tokio::time::sleep(RETRY_INTERVAL).await;
    }
}

async fn restore_on_change(engine: &Engine, mut watch: DesiredWatch) {
    while let Some(heard) = watch.next().await {
        match heard {
            DesiredEvent::Put(DesiredValue { machine, value }) => {
                if is_other(engine, &machine, Some(&value)) {
                    tokio::time::sleep(RECHECK_DELAY).await;
                    restore(engine, &machine).await;
                }
            }
            DesiredEvent::Connected => {
                let machines: Vec<MachineId> = lock(&engine.put).keys().cloned().collect();
                let mut checks = futures_util::stream::iter(machines)
                    .map(|machine| async move { restore(engine, &machine).await })
                    .buffer_unordered(MAX_CONCURRENT);
                while checks.next().await.is_some() {}
            }
        }
    }
}

/// True if a value differs from the value that this centre last wrote for the machine. False if this centre has written
/// no value, because there is nothing to restore.
fn is_other(engine: &Engine, machine: &MachineId, value: Option<&Bytes>) -> bool {
    let put = lock(&engine.put);
    let own: &BTreeMap<MachineId, (u64, Bytes)> = &put;
    own.get(machine).is_some_and(|(_, own)| non_empty(Some(own)) != non_empty(value))
}

/// Checks the value under a key, and restores the centre's value if the key holds another one.
async fn restore(engine: &Engine, machine: &MachineId) {
    let result = async {
        let value = engine.hub.desired(machine).await?;
        if !is_other(engine, machine, value.as_ref()) {
            return Ok(());
        }
        let own = lock(&engine.put).get(machine).map(|(_, own)| own.clone());
        let Some(own) = own else { return Ok(()) };
        if value.as_ref().is_none_or(|value| own_manifest(engine, value).is_none()) {
            report_foreign_value(engine, machine);
        }
        engine.hub.put_desired(machine, own).await
    };
    if let Err(error) = result.await {
        // Every key is checked again after a reconnect.
        tracing::warn!("{machine}: {error}");
    }
}

fn report_foreign_value(engine: &Engine, machine: &MachineId) {
    tracing::error!("{machine}: a foreign value under its key is replaced");
    lock(&engine.clobbered).insert(machine.clone(), Instant::now());
}

/// True if this centre issued this value, even with a key that was revoked since; also true (and logged) if the store
/// is unreadable.
async fn was_issued(engine: &Arc<Engine>, machine: &MachineId, value: &[u8]) -> bool {
    let sha256 = ModelRef::of(value).sha256;
    let (engine_clone, machine) = (Arc::clone(engine), machine.clone());
    let versions = blocking(move || engine_clone.store.versions(&machine)).await;
    match versions {
        Ok(versions) => versions.iter().any(|one| one.value_sha256 == sha256),
        Err(error) => {
            engine.set_failure(AlarmKind::Store, Some(error.to_string()));
            true
        }
    }
}

/// The manifest of a value that one of this centre's keys has signed.
fn own_manifest(engine: &Engine, value: &[u8]) -> Option<Manifest> {
    let desired = Desired::parse(value).ok()?;
    let signer = desired.signer().ok()??;
    let mut own = engine.settings.own.iter();
    own.find(|key| key.key.verifying_key() == signer)?;
    serde_json::from_str(&desired.manifest).ok()
}
