//! Roll-outs, alarms and the audit log.

use std::sync::Arc;

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, Query, State},
};
use serde::Deserialize;
use volcomp_fleet::MachineId;

use super::{
    answer::{Answer, Refused, document, done, read},
    face::Face,
};
use crate::{
    clock::now_s,
    models::fits,
    rollout::{Rollout, Rules, Wish},
    store::Store,
    users::User,
};

type Shared = State<Arc<Face>>;

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
    #[serde(default)]
    rules: Rules,
}

pub(super) async fn start_rollout(
    State(face): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> Answer {
    let start: Start = read(&body)?;
    check(&start.rules)?;
    let started = face
        .ask(move |store| Ok(begin(store, &start, &user)))
        .await??;
    document(&started)
}

fn check(rules: &Rules) -> Result<(), Refused> {
    let times = [rules.soak_s, rules.answer_s];
    let fits = times.iter().all(|s| (0.0..=1e7).contains(s))
        && (1.0..=1e6).contains(&rules.residual_ratio)
        && (0.0..=1e6).contains(&rules.residual_um)
        && rules.waves.len() <= 100
        && rules.waves.windows(2).all(|two| two[0] < two[1])
        && rules.waves.last() == Some(&100);
    if fits {
        Ok(())
    } else {
        Err(Refused::wrong(
            "the rules: expected times of 0 s or more, a ratio of 1 or more, and waves that rise to 100",
        ))
    }
}

fn begin(store: &Store, start: &Start, user: &User) -> Result<Rollout, Refused> {
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
    let (by, rules) = (user.name.to_string(), start.rules.clone());
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
