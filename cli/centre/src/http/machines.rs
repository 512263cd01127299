//! Routes for machines: overview, history, registration and removal, alarms, audit log and network search.
//!
//! Only one network search runs at a time.

use std::sync::Arc;

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, Query, State},
    http::StatusCode,
};
use serde::Deserialize;
use serde_json::json;
use volcomp_fleet::MachineId;

use crate::{
    clock::now_s,
    discover::{MAX_PER_SECOND, PER_SECOND, Search, Subnet, SubnetError},
    http::state::{
        ApiError, ApiResult, NetworkSearch, Shared, document, done, json_bytes, read, store_alarm,
    },
    records::{Machine, Point, Resolution},
    users::User,
    versions::active_version,
};

/// Maximum number of history points in a response. Beyond it, consecutive points are averaged.
const MAX_POINTS: usize = 2000;
/// Maximum number of history points read, the newest: more than two hours of conditions and a week of minutes.
const MAX_POINTS_READ: u32 = 20_000;
const MAX_RECORDS: u32 = 50;

pub(super) async fn overview(State(page): Shared) -> ApiResult {
    let overview = page.overview();
    if let Some(age) = overview.too_old() {
        let why = format!(
            "the overview is {} s old: the current states are unknown; see the log of the centre",
            age.as_secs()
        );
        return Err(ApiError::new(StatusCode::SERVICE_UNAVAILABLE, why));
    }
    let document = overview.document.clone();
    if document.is_empty() {
        let why = "the overview is not ready: repeat the request in a second";
        return Err(ApiError::new(StatusCode::SERVICE_UNAVAILABLE, why));
    }
    Ok(json_bytes(document))
}

/// Machine name in a path; an invalid name is reported as an unknown machine.
pub(super) fn named(name: &str) -> Result<MachineId, ApiError> {
    name.parse().map_err(|_| ApiError::missing("there is no such machine"))
}

pub(super) async fn machine(State(page): Shared, Path(name): Path<String>) -> ApiResult {
    let id = named(&name)?;
    let age_s = page.overview().age_s(&id);
    let found = page
        .query(move |store| {
            let Some(machine) = store.machine(&id)? else {
                return Ok(None);
            };
            let live = store.live_of(&id)?;
            let versions = store.versions(&id)?;
            let telemetry = store.telemetry(&id)?;
            let alarms = store.alarms(Some(&id), MAX_RECORDS)?;
            let records = store.machine_records(&id, MAX_RECORDS)?;
            let model = active_version(&versions, live.as_ref())
                .or(versions.first())
                .map(|version| version.model.clone());
            // A machine of unknown age is treated as silent.
            let silent = age_s.is_none_or(|age_s| machine.is_silent(age_s));
            let telemetry = telemetry.map(
                |(at_s, state)| json!({ "at_s": at_s, "age_s": now_s() - at_s, "state": state }),
            );
            let records: Vec<_> = (records.into_iter())
                .map(|(at_s, record)| json!({ "at_s": at_s, "record": record }))
                .collect();
            Ok(Some(json!({
                "machine": machine,
                // `null` if no message was ever received.
                "live": live,
                // Age of the machine's last condition, s.
                "age_s": age_s,
                "silent": silent,
                "versions": versions,
                // The active model; if unknown, the model that was sent last.
                "model": model,
                "telemetry": telemetry,
                "alarms": alarms,
                "records": records,
            })))
        })
        .await?;
    match found {
        Some(found) => document(&found),
        None => Err(ApiError::missing("there is no such machine")),
    }
}

#[derive(Deserialize)]
pub(super) struct HistoryQuery {
    resolution: Resolution,
    hours: f64,
}

pub(super) async fn history(
    State(page): Shared,
    Path(name): Path<String>,
    Query(range): Query<HistoryQuery>,
) -> ApiResult {
    let id = named(&name)?;
    if !(0.001..=1e6).contains(&range.hours) {
        return Err(ApiError::wrong("hours: expected a number above 0"));
    }
    let points = page
        .query(move |store| {
            let to_s = now_s();
            let from_s = to_s - range.hours * 3600.0;
            store.history(&id, range.resolution, from_s, to_s + 60.0, MAX_POINTS_READ)
        })
        .await?;
    let together = points.len().div_ceil(MAX_POINTS).max(1);
    let means = points.chunks(together).filter_map(|some| Point::mean(some, some.first()?.at_s));
    let means: Vec<Point> = means.collect();
    // `together`: number of points averaged into one.
    document(&json!({ "now_s": now_s(), "together": together, "points": means }))
}

pub(super) async fn put_machine(
    State(page): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> ApiResult {
    let machine: Machine = read(&body)?;
    machine.check().map_err(|error| ApiError::wrong(error.to_string()))?;
    page.query(move |store| store.put_machine(&machine, user.name.as_str())).await?;
    done()
}

pub(super) async fn remove_machine(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(name): Path<String>,
) -> ApiResult {
    let id = named(&name)?;
    let removed = page.query(move |store| store.remove_machine(&id, user.name.as_str())).await?;
    if removed { done() } else { Err(ApiError::missing("there is no such machine")) }
}

const MAX_ALARMS: u32 = 500;
const MAX_AUDIT: u32 = 200;

#[derive(Deserialize)]
pub(super) struct AlarmQuery {
    #[serde(default)]
    all: bool,
}

pub(super) async fn alarms(State(page): Shared, Query(which): Query<AlarmQuery>) -> ApiResult {
    let alarms = page.query(move |store| {
        let mut alarms =
            if which.all { store.alarms(None, MAX_ALARMS) } else { store.open_alarms() }?;
        alarms.extend(store_alarm(store));
        Ok(alarms)
    });
    document(&alarms.await?)
}

pub(super) async fn acknowledge_alarm(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
) -> ApiResult {
    let seen = page.query(move |store| store.acknowledge_alarm(id, user.name.as_str())).await?;
    if seen { done() } else { Err(ApiError::missing("there is no such alarm")) }
}

#[derive(Deserialize)]
pub(super) struct AuditQuery {
    /// Return records with numbers below this one.
    before: Option<u64>,
}

pub(super) async fn audit(State(page): Shared, Query(range): Query<AuditQuery>) -> ApiResult {
    document(&page.query(move |store| store.audit_records(range.before, MAX_AUDIT)).await?)
}

const MAX_SUBNETS: usize = 32;

pub(super) async fn latest(State(page): Shared) -> ApiResult {
    document(&page.with_search(|latest| latest.clone()))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SearchRequest {
    subnets: Vec<String>,
    /// The user confirms that public ranges are theirs.
    #[serde(default)]
    mine: bool,
    #[serde(default)]
    per_second: Option<f64>,
}

pub(super) async fn search(
    State(page): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> ApiResult {
    let request: SearchRequest = read(&body)?;
    if request.subnets.is_empty() || request.subnets.len() > MAX_SUBNETS {
        return Err(ApiError::wrong(format!("subnets: expected 1 to {MAX_SUBNETS}")));
    }
    let mut subnets = Vec::new();
    for text in &request.subnets {
        let subnet: Subnet = text.parse().map_err(|e| ApiError::wrong(format!("{e}")))?;
        subnet.check(request.mine).map_err(|error| {
            ApiError::wrong(match error {
                // In the web interface the remedy is a check box, not a command-line option.
                SubnetError::Public { found } => format!(
                    "{found} is not a private range: it may contain computers of others. If it is yours, tick the box below the subnets"
                ),
                error => error.to_string(),
            })
        })?;
        subnets.push(subnet);
    }
    let per_second = request.per_second.unwrap_or(PER_SECOND);
    if !(1.0..=MAX_PER_SECOND).contains(&per_second) {
        return Err(ApiError::wrong(format!(
            "per_second: found {per_second}, expected 1 to {MAX_PER_SECOND}"
        )));
    }
    let mut search = Search::new(subnets);
    search.per_second = per_second;
    if let Some(ports) = &page.settings.ports {
        search.ports.clone_from(ports);
    }
    let of = search.addresses();
    let details =
        json!({ "subnets": request.subnets, "per_second": per_second, "mine": request.mine });
    let begun = page.with_search(|latest| {
        if latest.running {
            return false;
        }
        *latest = NetworkSearch {
            running: true,
            by: user.name.to_string(),
            subnets: request.subnets.clone(),
            of,
            ..NetworkSearch::default()
        };
        true
    });
    if !begun {
        return Err(ApiError::conflict("a search is running already"));
    }
    let shared = Arc::clone(&page);
    tokio::spawn(async move {
        let progress = Arc::clone(&shared);
        let devices =
            search.run(move |done| progress.with_search(|latest| latest.done = done)).await;
        shared.with_search(|latest| {
            latest.devices = devices;
            latest.running = false;
        });
    });
    page.query(move |store| store.audit(user.name.as_str(), "discover", "network", details))
        .await?;
    done()
}
