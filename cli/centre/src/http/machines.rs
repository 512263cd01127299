//! What is known of machines: all at a glance, one in depth, its history.

use axum::{
    extract::{Path, Query, State},
    http::StatusCode,
};
use serde::{Deserialize, Serialize};
use volcomp_fleet::MachineId;

use super::{
    answer::{Answer, Refused, document, json_bytes},
    state::Shared,
};
use crate::{
    clock::now_s,
    drift::in_force,
    point::mean,
    records::{Alarm, Live, Machine, Point, Resolution, Version},
};

/// So many points of a history are told at most: where there are more, one for several that follow one another, their mean.
const POINTS: usize = 2000;
/// So many points of a history are read at most, the newest: two hours of conditions and a week of minutes, with some to spare.
const READ: u32 = 20_000;
/// So many alarms and records of one machine are told.
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

/// A name in a path: one that cannot be a machine's is that of no machine.
pub(super) fn named(name: &str) -> Result<MachineId, Refused> {
    name.parse()
        .map_err(|_| Refused::missing("there is no such machine"))
}

/// One machine in depth.
#[derive(Serialize)]
struct Deep {
    machine: Machine,
    /// What it told last; `None`: it was never heard.
    live: Option<Live>,
    /// The age of its last condition, s.
    age_s: Option<f64>,
    silent: bool,
    /// The newest first.
    versions: Vec<Version>,
    /// The model in force; where none is known to be, the one that was sent last.
    model: Option<String>,
    telemetry: Option<Told>,
    alarms: Vec<Alarm>,
    records: Vec<Record>,
}

/// A whole state, as the gateway told it.
#[derive(Serialize)]
struct Told {
    at_s: f64,
    age_s: f64,
    state: serde_json::Value,
}

/// A record of the gateway's audit log.
#[derive(Serialize)]
struct Record {
    at_s: f64,
    record: serde_json::Value,
}

pub(super) async fn machine(State(page): Shared, Path(name): Path<String>) -> Answer {
    let id = named(&name)?;
    let age_s = page.overview().age_s(&id);
    let found = page
        .ask(move |store| {
            let Some(machine) = store.machine(&id)? else {
                return Ok(None);
            };
            let live = store.live()?.into_iter().find(|live| live.machine == id);
            let versions = store.versions(&id)?;
            let telemetry = store.telemetry(&id)?;
            let alarms = store.alarms(Some(&id), RECORDS)?;
            let records = store.machine_records(&id, RECORDS)?;
            let model = in_force(&versions, live.as_ref())
                .or(versions.first())
                .map(|version| version.model.clone());
            // Where the age is not known yet the machine is taken for silent.
            let silent = age_s.is_none_or(|age_s| machine.is_silent(age_s));
            let telemetry = telemetry.map(|(at_s, state)| Told {
                at_s,
                age_s: now_s() - at_s,
                state,
            });
            let records = records.into_iter();
            Ok(Some(Deep {
                machine,
                live,
                age_s,
                silent,
                versions,
                model,
                telemetry,
                alarms,
                records: records
                    .map(|(at_s, record)| Record { at_s, record })
                    .collect(),
            }))
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
    /// The last so many hours.
    hours: f64,
}

#[derive(Serialize)]
struct History {
    now_s: f64,
    /// So many points stand together for one, as their mean.
    together: usize,
    points: Vec<Point>,
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
        .filter_map(|some| mean(some, some.first()?.at_s));
    let told: Vec<Point> = means.collect();
    document(&History {
        now_s: now_s(),
        together,
        points: told,
    })
}
