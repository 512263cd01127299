//! One look: roll-outs go on, alarms are raised and closed, the history is put in order. Everything here waits for the disk.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_fleet::{Acknowledgement, MachineId, SiteId};

use super::{Engine, alarms, blocking, writer::lock};
use crate::{
    clock::now_s,
    ingest::Since,
    issue::{NotIssued, Order, issue},
    records::{AlarmKind, Machine, Model},
    rollout::{Action, Event, Rollout, Seen},
    store::{Database, Issued, StoreError, rollouts},
};

/// A machine that was heard so long ago is heard, s.
const FRESH_S: f64 = 15.0;
/// Minutes are closed so often, …
const MINUTE: Duration = Duration::from_secs(60);
/// … and when they ended so long ago, s: most of what was under way has come.
const CLOSED_AFTER_S: f64 = 30.0;
/// What is no longer kept is forgotten so often.
const HOUR: Duration = Duration::from_secs(3600);

/// What is held from look to look.
pub(super) struct State {
    last: Instant,
    minute: Instant,
    hour: Option<Instant>,
    pub(super) alarms: alarms::Open,
}

impl State {
    pub(super) fn new() -> Self {
        let now = Instant::now();
        Self {
            last: now,
            minute: now,
            hour: None,
            alarms: alarms::Open::default(),
        }
    }
}

/// The sites of the machines that are registered.
pub(super) async fn sites(engine: &Arc<Engine>) -> BTreeSet<SiteId> {
    let of_store = Arc::clone(engine);
    let machines = blocking(move || of_store.store.machines()).await;
    let machines = machines.unwrap_or_default();
    machines
        .into_iter()
        .map(|machine| machine.identity.site)
        .collect()
}

/// Looks once. Trouble with the database is told, and the next look tries again.
pub(super) async fn look(engine: &Arc<Engine>, state: State) -> State {
    let engine = Arc::clone(engine);
    blocking(move || {
        let mut state = state;
        if let Err(error) = look_now(&engine, &mut state) {
            engine.trouble(AlarmKind::Store, Some(error.to_string()));
        }
        state
    })
    .await
}

fn look_now(engine: &Engine, state: &mut State) -> Result<(), StoreError> {
    let now = Instant::now();
    let elapsed_s = now.duration_since(state.last).as_secs_f64();
    state.last = now;
    let machines = engine.store.machines()?;
    let looked = {
        let mut ingest = lock(&engine.ingest);
        ingest.store_live(&engine.store)?;
        ingest.look(FRESH_S)
    };
    let seen: BTreeMap<MachineId, Seen> = (looked.iter())
        .map(|(machine, (seen, _))| (machine.clone(), seen.clone()))
        .collect();
    let since: BTreeMap<MachineId, Since> = (looked.into_iter())
        .map(|(machine, (_, since))| (machine, since))
        .collect();
    let mut answers = std::mem::take(&mut *lock(&engine.answers));
    if let Err(error) = roll_out(engine, &machines, elapsed_s, &seen, &answers) {
        // What was answered and heard counts at the next look, before what came meanwhile.
        let mut waiting = lock(&engine.answers);
        answers.append(&mut waiting);
        *waiting = answers;
        drop(waiting);
        lock(&engine.ingest).put_back(since);
        return Err(error);
    }
    alarms::look(engine, &mut state.alarms, &machines, &since)?;
    if now.duration_since(state.minute) >= MINUTE {
        state.minute = now;
        lock(&engine.ingest).count_missing();
        engine.store.close_minutes(now_s() - CLOSED_AFTER_S)?;
    }
    if state
        .hour
        .is_none_or(|hour| now.duration_since(hour) >= HOUR)
    {
        state.hour = Some(now);
        engine.store.forget(engine.settings.keep, now_s())?;
    }
    Ok(())
}

/// Moves every roll-out on, each in one transaction with what it issues.
fn roll_out(
    engine: &Engine,
    machines: &[Machine],
    elapsed_s: f64,
    seen: &BTreeMap<MachineId, Seen>,
    answers: &[(MachineId, Acknowledgement)],
) -> Result<(), StoreError> {
    for id in engine.store.open_rollouts()? {
        let Some(rollout) = engine.store.rollout(id)? else {
            continue;
        };
        let model = engine.store.model(&rollout.model)?;
        let text = engine.store.model_text(&rollout.model)?;
        let material = Material {
            engine,
            machines,
            model: model.as_ref().zip(text.as_deref()),
            seen,
        };
        engine.store.write(|database| {
            let Some((mut rollout, wish)) = rollouts::take(database, id)? else {
                return Ok(());
            };
            let before = rollout.clone();
            let wished = wish.map(|(wish, by)| Event::Wished { wish, by });
            let answered = answers.iter().map(|(machine, answer)| Event::Answered {
                machine: machine.clone(),
                version: answer.version,
                outcome: answer.outcome.clone(),
            });
            let looked = Event::Looked {
                elapsed_s,
                seen: seen.clone(),
            };
            for event in wished.into_iter().chain(answered).chain([looked]) {
                let actions = rollout.step(event);
                material.act(database, &mut rollout, actions)?;
            }
            if rollout == before {
                return Ok(());
            }
            rollouts::save(database, &rollout, &before.phase)
        })?;
    }
    Ok(())
}

/// What a manifest of a roll-out is made of.
struct Material<'a> {
    engine: &'a Engine,
    machines: &'a [Machine],
    model: Option<(&'a Model, &'a str)>,
    seen: &'a BTreeMap<MachineId, Seen>,
}

impl Material<'_> {
    fn act(
        &self,
        database: &mut dyn Database,
        rollout: &mut Rollout,
        mut actions: Vec<Action>,
    ) -> Result<(), StoreError> {
        // Each issue is told to the roll-out at once; what that brings up is done, too.
        while !actions.is_empty() {
            let mut more = Vec::new();
            for Action::Issue { machine, confirm } in actions {
                let event = match self.issue(database, rollout, &machine, confirm) {
                    Ok(issued) => Event::Issued {
                        before_um: self.seen.get(&machine).and_then(|seen| seen.residual_um),
                        version: issued.version,
                        machine,
                    },
                    Err(NotIssued::Store(error)) => return Err(error),
                    Err(other) => Event::NotIssued {
                        machine,
                        why: other.to_string(),
                    },
                };
                more.extend(rollout.step(event));
            }
            // A step after one of many that were issued names the others again.
            more.retain(|Action::Issue { machine, .. }| rollout.is_waiting(machine));
            more.dedup();
            actions = more;
        }
        Ok(())
    }

    fn issue(
        &self,
        database: &mut dyn Database,
        rollout: &Rollout,
        name: &MachineId,
        confirm: Option<String>,
    ) -> Result<Issued, NotIssued> {
        let missing = |what, name: &str| NotIssued::Missing {
            what,
            name: name.to_owned(),
        };
        let mut machines = self.machines.iter();
        let machine = machines
            .find(|machine| machine.identity.machine == *name)
            .ok_or_else(|| missing("machine", name.as_str()))?;
        let (model, text) = self.model.ok_or_else(|| missing("model", &rollout.model))?;
        let order = Order {
            machine,
            model,
            text,
            confirm,
            rollout: Some(rollout.id),
            by: &rollout.by,
        };
        issue(database, &self.engine.settings.key, &order)
    }
}
