//! Roll-outs, alarms and the audit log.

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, Query, State},
};
use serde::Deserialize;
use volcomp_fleet::MachineId;

use super::{
    answer::{Answer, Refused, document, done, read},
    face::Shared,
    machines::named,
};
use crate::{
    back::{self, NoWayBack},
    clock::now_s,
    models::fits,
    rollout::{Rollout, Rules, Wish},
    store::Store,
    users::User,
};

/// So many roll-outs, alarms and records are told.
const ROLLOUTS: u32 = 20;
const ALARMS: u32 = 500;
const RECORDS: u32 = 200;

pub(super) async fn rollouts(State(face): Shared) -> Answer {
    document(&face.ask(|store| store.rollouts(ROLLOUTS)).await?)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Start {
    /// The checksum of the model, or its beginning.
    model: String,
    /// The machines that get it.
    machines: Vec<MachineId>,
    /// Those that get it first; besides the ones that are registered as such.
    #[serde(default)]
    canaries: Vec<MachineId>,
    /// The rules; without them those of the configuration.
    #[serde(default)]
    rules: Option<Rules>,
}

/// The rules of roll-outs that state none.
pub(super) async fn rules(State(face): Shared) -> Answer {
    document(&face.settings.rules)
}

pub(super) async fn start_rollout(
    State(face): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> Answer {
    let start: Start = read(&body)?;
    let rules = start.rules.clone();
    let rules = rules.unwrap_or_else(|| face.settings.rules.clone());
    let checked = rules.check();
    checked.map_err(|error| Refused::wrong(format!("rules.{error}")))?;
    let started = face
        .ask(move |store| Ok(begin(store, &start, rules, &user)))
        .await??;
    document(&started)
}

fn begin(store: &Store, start: &Start, rules: Rules, user: &User) -> Result<Rollout, Refused> {
    let model = store
        .model(&start.model)?
        .ok_or_else(|| Refused::missing("there is no such model"))?;
    if start.machines.is_empty() {
        return Err(Refused::wrong("machines: expected at least one"));
    }
    let mut chosen: Vec<(MachineId, bool)> = Vec::new();
    for id in &start.machines {
        let machine = store
            .machine(id)?
            .ok_or_else(|| Refused::missing(format!("there is no machine {id}")))?;
        fits(&model, &machine).map_err(|error| Refused::conflict(error.to_string()))?;
        if !chosen.iter().any(|(known, _)| known == id) {
            chosen.push((id.clone(), machine.canary || start.canaries.contains(id)));
        }
    }
    let by = user.name.to_string();
    Ok(store.start_rollout(|number| {
        Rollout::new(number, model.sha256.clone(), &chosen, rules, by, now_s())
    })?)
}

pub(super) async fn wish(
    State(face): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
    body: Bytes,
) -> Answer {
    let wish: Wish = read(&body)?;
    face.ask(move |store| store.wish(id, &wish, user.name.as_str()))
        .await?;
    done()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Keep {
    /// The machine that keeps the model.
    machine: MachineId,
}

pub(super) async fn keep(
    State(face): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
    body: Bytes,
) -> Answer {
    let Keep { machine } = read(&body)?;
    face.ask(move |store| store.keep_model(id, &machine, user.name.as_str()))
        .await?;
    done()
}

pub(super) async fn back(
    State(face): Shared,
    Extension(user): Extension<User>,
    Path(name): Path<String>,
) -> Answer {
    let machine = named(&name)?;
    let rules = face.settings.rules.clone();
    let started = face
        .ask(move |store| Ok(back::start(store, &machine, rules, user.name.as_str())))
        .await?;
    let (rollout, _) = started.map_err(|error| match error {
        NoWayBack::Store(error) => error.into(),
        other => Refused::conflict(other.to_string()),
    })?;
    document(&rollout)
}

#[derive(Deserialize)]
pub(super) struct Which {
    /// Those that are over, too.
    #[serde(default)]
    all: bool,
}

pub(super) async fn alarms(State(face): Shared, Query(which): Query<Which>) -> Answer {
    let alarms = face.ask(move |store| {
        if which.all {
            store.alarms(None, ALARMS)
        } else {
            store.open_alarms()
        }
    });
    document(&alarms.await?)
}

pub(super) async fn see_alarm(
    State(face): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
) -> Answer {
    let seen = face
        .ask(move |store| store.see_alarm(id, user.name.as_str()))
        .await?;
    if seen {
        done()
    } else {
        Err(Refused::missing("there is no such alarm"))
    }
}

#[derive(Deserialize)]
pub(super) struct Before {
    /// Records with smaller numbers.
    before: Option<u64>,
}

pub(super) async fn audit(State(face): Shared, Query(range): Query<Before>) -> Answer {
    document(
        &face
            .ask(move |store| store.audit_records(range.before, RECORDS))
            .await?,
    )
}
