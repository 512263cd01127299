//! Roll-outs: status, user requests, and return to an earlier model.

use std::collections::{BTreeMap, BTreeSet};

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, State},
};
use serde::{Deserialize, Serialize};
use volcomp_fleet::MachineId;

use super::{
    machines::named,
    response::{ApiError, ApiResult, document, done, read},
    state::Shared,
};
use crate::{
    Error,
    models::fits,
    rollout::{Rollout, Rules, UserRequest},
    store::Store,
    users::User,
    versions::{load_active_version, start_way_back},
};

const MAX_ROLLOUTS: u32 = 20;

#[derive(Serialize)]
struct RolloutView {
    #[serde(flatten)]
    rollout: Rollout,
    /// Machines on which the model of a stopped or aborted roll-out is active now. The user must decide whether they
    /// keep it.
    in_force_on: Vec<MachineId>,
}

pub(super) async fn rollouts(State(page): Shared) -> ApiResult {
    document(&page.query(views).await?)
}

fn views(store: &Store) -> Result<Vec<RolloutView>, Error> {
    let rollouts = store.rollouts(MAX_ROLLOUTS)?;
    let has_broken_off = (rollouts.iter()).any(|rollout| rollout.phase.is_broken_off());
    let in_force =
        if has_broken_off { rollouts_in_force(store, &rollouts)? } else { BTreeMap::new() };
    let views = rollouts.into_iter().map(|rollout| {
        let targets = rollout.targets.iter().map(|target| &target.machine);
        let in_force_on = targets.filter(|name| in_force.get(name) == Some(&rollout.id));
        RolloutView { in_force_on: in_force_on.cloned().collect(), rollout }
    });
    Ok(views.collect())
}

/// For each machine of a stopped or aborted roll-out, the roll-out whose model is active.
fn rollouts_in_force(
    store: &Store,
    rollouts: &[Rollout],
) -> Result<BTreeMap<MachineId, u64>, Error> {
    let (newest, lives) = (store.newest_versions()?, store.live()?);
    let broken_off = (rollouts.iter()).filter(|rollout| rollout.phase.is_broken_off());
    let machines: BTreeSet<&MachineId> = broken_off
        .flat_map(|rollout| rollout.targets.iter().map(|target| &target.machine))
        .collect();
    let mut found = BTreeMap::new();
    for name in machines {
        let version = load_active_version(store, name, newest.get(name), lives.get(name))?;
        if let Some(rollout) = version.and_then(|version| version.rollout) {
            found.insert(name.clone(), rollout);
        }
    }
    Ok(found)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StartRequest {
    /// Checksum of the model, or its first digits.
    model: String,
    machines: Vec<MachineId>,
    /// Canary machines, in addition to those registered as canaries.
    #[serde(default)]
    canaries: Vec<MachineId>,
    /// Roll-out rules [default: those of the configuration].
    #[serde(default)]
    rules: Option<Rules>,
}

pub(super) async fn rules(State(page): Shared) -> ApiResult {
    document(&page.settings.rules)
}

pub(super) async fn start_rollout(
    State(page): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> ApiResult {
    let start: StartRequest = read(&body)?;
    let rules = start.rules.clone();
    let rules = rules.unwrap_or_else(|| page.settings.rules.clone());
    let checked = rules.check();
    checked.map_err(|(key, why)| ApiError::wrong(format!("rules.{key}: {why}")))?;
    let started = page.query(move |store| Ok(begin(store, &start, rules, &user))).await??;
    document(&started)
}

fn begin(
    store: &Store,
    start: &StartRequest,
    rules: Rules,
    user: &User,
) -> Result<Rollout, ApiError> {
    let model =
        store.model(&start.model)?.ok_or_else(|| ApiError::missing("there is no such model"))?;
    if start.machines.is_empty() {
        return Err(ApiError::wrong("machines: expected at least one"));
    }
    let mut chosen: Vec<(MachineId, bool)> = Vec::new();
    for id in &start.machines {
        let machine = store
            .machine(id)?
            .ok_or_else(|| ApiError::missing(format!("there is no machine {id}")))?;
        fits(&model, &machine).map_err(|error| ApiError::conflict(error.to_string()))?;
        if !chosen.iter().any(|(known, _)| known == id) {
            chosen.push((id.clone(), machine.canary || start.canaries.contains(id)));
        }
    }
    Ok(store.begin_rollout(&model.sha256, &chosen, rules, user.name.as_str())?)
}

pub(super) async fn request(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
    body: Bytes,
) -> ApiResult {
    let request: UserRequest = read(&body)?;
    page.query(move |store| store.request_rollout_change(id, &request, user.name.as_str())).await?;
    done()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KeepRequest {
    machine: MachineId,
}

pub(super) async fn keep(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
    body: Bytes,
) -> ApiResult {
    let KeepRequest { machine } = read(&body)?;
    page.query(move |store| store.keep_model(id, &machine, user.name.as_str())).await?;
    done()
}

pub(super) async fn back(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(name): Path<String>,
) -> ApiResult {
    let machine = named(&name)?;
    let rules = page.settings.rules.clone();
    let (rollout, _) =
        page.query(move |store| start_way_back(store, &machine, rules, user.name.as_str())).await?;
    document(&rollout)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        issue::Fixture,
        records::Live,
        rollout::{Phase, Step},
    };

    /// A machine activated the model of a roll-out, but its acknowledgement was lost, so the roll-out still waits for
    /// it. The view shows the version that the machine reports, so that the user can decide.
    #[test]
    fn a_machine_that_reports_the_model_is_listed_as_having_it() {
        let fixture = Fixture::new();
        let machines = [(fixture.name().clone(), true)];
        let started = fixture.store.start_rollout(|id| {
            let mut rollout = Rollout::new(id, "ab", &machines, Rules::default(), "anna", 0.0);
            rollout.phase = Phase::Aborted { by: "anna".into() };
            rollout
        });
        let id = started.expect("stored").id;
        fixture.issue(1, id, None);
        let in_force_on = || views(&fixture.store).expect("a store").remove(0).in_force_on;
        assert!(in_force_on().is_empty(), "no message yet");
        let live = Live::new(fixture.name().clone(), 1.0, 1);
        fixture.store.put_live(&[live]).expect("stored");
        assert_eq!(in_force_on(), [fixture.name().clone()]);
        let rollout = fixture.store.rollout(id).expect("a store").expect("there");
        assert_eq!(rollout.targets[0].step, Step::Waiting);
    }
}
