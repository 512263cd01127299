//! Machines: overview, details and history; registration and removal; alarms and audit log.

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, Query, State},
    http::StatusCode,
};
use serde::Deserialize;
use serde_json::json;
use volcomp_fleet::MachineId;

use super::{
    answer::{Answer, Refused, document, done, json_bytes, read},
    state::Shared,
};
use crate::{
    clock::now_s,
    records::{Machine, Point, Resolution},
    users::User,
    versions::in_force,
};

/// Maximum number of history points in a response. Beyond it, consecutive points are averaged.
const POINTS: usize = 2000;
/// Maximum number of history points read, the newest: more than two hours of conditions and a week of minutes.
const READ: u32 = 20_000;
/// Maximum number of alarms and of audit records in the details of a machine.
const RECORDS: u32 = 50;

pub(super) async fn overview(State(page): Shared) -> Answer {
    let overview = page.overview();
    if let Some(age) = overview.too_old() {
        let why = format!(
            "the centre could not look at its machines for {} s: what they do now is not known, and its log says why",
            age.as_secs()
        );
        return Err(Refused::new(StatusCode::SERVICE_UNAVAILABLE, why));
    }
    let document = overview.document.clone();
    if document.is_empty() {
        let why = "the overview is not made yet: ask again in a second";
        return Err(Refused::new(StatusCode::SERVICE_UNAVAILABLE, why));
    }
    Ok(json_bytes(document))
}

/// Machine name in a path; an invalid name is reported as an unknown machine.
pub(super) fn named(name: &str) -> Result<MachineId, Refused> {
    name.parse()
        .map_err(|_| Refused::missing("there is no such machine"))
}

pub(super) async fn machine(State(page): Shared, Path(name): Path<String>) -> Answer {
    let id = named(&name)?;
    let age_s = page.overview().age_s(&id);
    let found = page
        .ask(move |store| {
            let Some(machine) = store.machine(&id)? else {
                return Ok(None);
            };
            let live = store.live_of(&id)?;
            let versions = store.versions(&id)?;
            let telemetry = store.telemetry(&id)?;
            let alarms = store.alarms(Some(&id), RECORDS)?;
            let records = store.machine_records(&id, RECORDS)?;
            let model = in_force(&versions, live.as_ref())
                .or(versions.first())
                .map(|version| version.model.clone());
            // A machine of unknown age counts as silent.
            let silent = age_s.is_none_or(|age_s| machine.is_silent(age_s));
            let telemetry = telemetry.map(
                |(at_s, state)| json!({ "at_s": at_s, "age_s": now_s() - at_s, "state": state }),
            );
            let records: Vec<_> = (records.into_iter())
                .map(|(at_s, record)| json!({ "at_s": at_s, "record": record }))
                .collect();
            Ok(Some(json!({
                "machine": machine,
                // `null`: no message was ever received.
                "live": live,
                // Age of its last condition.
                "age_s": age_s,
                "silent": silent,
                "versions": versions,
                // The active model; if none is known, the one sent last.
                "model": model,
                "telemetry": telemetry,
                "alarms": alarms,
                "records": records,
            })))
        })
        .await?;
    match found {
        Some(found) => document(&found),
        None => Err(Refused::missing("there is no such machine")),
    }
}

#[derive(Deserialize)]
pub(super) struct Range {
    resolution: Resolution,
    /// Length of the history, hours back from now.
    hours: f64,
}

pub(super) async fn history(
    State(page): Shared,
    Path(name): Path<String>,
    Query(range): Query<Range>,
) -> Answer {
    let id = named(&name)?;
    if !(0.001..=1e6).contains(&range.hours) {
        return Err(Refused::wrong("hours: expected a number above 0"));
    }
    let points = page
        .ask(move |store| {
            let to_s = now_s();
            let from_s = to_s - range.hours * 3600.0;
            store.history(&id, range.resolution, from_s, to_s + 60.0, READ)
        })
        .await?;
    let together = points.len().div_ceil(POINTS).max(1);
    let means = points
        .chunks(together)
        .filter_map(|some| Point::mean(some, some.first()?.at_s));
    let told: Vec<Point> = means.collect();
    // `together`: number of points averaged into one.
    document(&json!({ "now_s": now_s(), "together": together, "points": told }))
}

pub(super) async fn put_machine(
    State(page): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> Answer {
    let machine: Machine = read(&body)?;
    machine
        .check()
        .map_err(|error| Refused::wrong(error.to_string()))?;
    page.ask(move |store| store.put_machine(&machine, user.name.as_str()))
        .await?;
    done()
}

pub(super) async fn remove_machine(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(name): Path<String>,
) -> Answer {
    let id = named(&name)?;
    let removed = page
        .ask(move |store| store.remove_machine(&id, user.name.as_str()))
        .await?;
    if removed {
        done()
    } else {
        Err(Refused::missing("there is no such machine"))
    }
}

/// Maximum number of alarms in an answer.
const MAX_ALARMS: u32 = 500;
/// Maximum number of records of the audit log in an answer.
const MAX_AUDIT: u32 = 200;

#[derive(Deserialize)]
pub(super) struct Which {
    /// Include closed alarms.
    #[serde(default)]
    all: bool,
}

pub(super) async fn alarms(State(page): Shared, Query(which): Query<Which>) -> Answer {
    let alarms = page.ask(move |store| {
        if which.all {
            store.alarms(None, MAX_ALARMS)
        } else {
            store.open_alarms()
        }
    });
    document(&alarms.await?)
}

pub(super) async fn see_alarm(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
) -> Answer {
    let seen = page
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
    /// Return records with smaller numbers.
    before: Option<u64>,
}

pub(super) async fn audit(State(page): Shared, Query(range): Query<Before>) -> Answer {
    document(
        &page
            .ask(move |store| store.audit_records(range.before, MAX_AUDIT))
            .await?,
    )
}
