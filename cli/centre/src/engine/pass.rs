//! One pass of the engine: advances roll-outs, raises and closes alarms, maintains the history. Everything here may block on the disk.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_fleet::{MachineId, SiteId};

use super::{Engine, alarms, blocking, lock, rollouts};
use crate::{
    Error,
    clock::now_s,
    issue::{differs, settle},
    records::{AlarmKind, Machine, Version},
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
    let blocked = match rollouts::advance_all(engine, elapsed_s, &seen, &state.residual_um) {
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
