//! State shared by the routes.
//!
//! It contains the overview, which is rebuilt every second, the wrong passwords and rejected requests of the last
//! minute, the last network search, and computed error maps.

use std::{
    collections::{BTreeMap, HashMap},
    net::IpAddr,
    sync::{Arc, Mutex, PoisonError, RwLock},
    time::{Duration, Instant},
};

use axum::{
    Json,
    body::Bytes,
    extract::State,
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;
use serde_json::json;
use tokio::{
    sync::{AcquireError, OwnedSemaphorePermit, Semaphore},
    task::JoinError,
};
use volcomp_fleet::MachineId;

use crate::{
    Error,
    clock::now_s,
    discover::{Device, Kind},
    records::{Alarm, AlarmKind, CreationTime, Live, Severity},
    rollout::Rules,
    store::Store,
    users::{REFUSAL_WINDOW, Refusal, Refusals, Throttle},
    versions::overdue_days,
};

const REFRESH_INTERVAL: Duration = Duration::from_secs(1);
const MAX_MAPS: usize = 64;

#[derive(Clone, Debug, Default)]
pub struct PageSettings {
    /// Host names accepted in requests, in addition to addresses.
    pub hosts: Vec<String>,
    /// True if connections use TLS: cookies are then sent over TLS only.
    pub secure: bool,
    pub rules: Rules,
    /// Notice above the web interface, for example that this is a demonstration.
    pub notice: String,
    /// Ports of the network search instead of the default ones; for tests.
    pub ports: Option<Vec<(Kind, u16)>>,
}

#[derive(Clone, Default, Serialize)]
pub(super) struct NetworkSearch {
    pub(super) running: bool,
    pub(super) by: String,
    pub(super) subnets: Vec<String>,
    /// Number of addresses searched so far, of `of` in total.
    pub(super) done: usize,
    pub(super) of: usize,
    pub(super) devices: Vec<Device>,
}

pub(super) type Shared = State<Arc<PageState>>;

pub struct PageState {
    pub(super) store: Arc<Store>,
    pub(super) settings: PageSettings,
    pub(super) throttle: Throttle,
    refusals: Refusals,
    /// At most two passwords are hashed at a time, because each costs memory and time.
    passwords: Arc<Semaphore>,
    /// At most one model or error map is computed at a time, because each occupies a processor.
    works: Arc<Semaphore>,
    pub(super) overview: RwLock<Arc<Overview>>,
    search: Mutex<NetworkSearch>,
    maps: Mutex<HashMap<String, Bytes>>,
}

impl PageState {
    pub fn new(store: Arc<Store>, settings: PageSettings) -> Arc<Self> {
        Arc::new(Self {
            store,
            settings,
            throttle: Throttle::default(),
            refusals: Refusals::default(),
            passwords: Arc::new(Semaphore::new(2)),
            works: Arc::new(Semaphore::new(1)),
            overview: RwLock::default(),
            search: Mutex::default(),
            maps: Mutex::default(),
        })
    }

    /// Rebuilds the overview periodically until the runtime ends.
    pub async fn refresh(self: Arc<Self>) {
        let mut ages = Ages::default();
        let mut ticks = tokio::time::interval(REFRESH_INTERVAL);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            let page = Arc::clone(&self);
            let made = tokio::task::spawn_blocking(move || {
                let overview = Overview::of(&page.store, &mut ages, &page.settings.notice);
                (overview, ages)
            });
            match made.await {
                Ok((overview, kept)) => {
                    ages = kept;
                    match overview {
                        Ok(overview) => {
                            let mut place =
                                self.overview.write().unwrap_or_else(PoisonError::into_inner);
                            *place = Arc::new(overview);
                        }
                        Err(error) => tracing::warn!("overview: {error}"),
                    }
                }
                Err(error) => {
                    tracing::error!("overview: {error}");
                    return;
                }
            }
        }
    }

    pub(super) fn with_search<T>(&self, work: impl FnOnce(&mut NetworkSearch) -> T) -> T {
        work(&mut self.search.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(super) fn overview(&self) -> Arc<Overview> {
        let place = self.overview.read().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(&place)
    }

    pub(super) async fn query<T: Send + 'static>(
        self: &Arc<Self>,
        work: impl FnOnce(&Store) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, ApiError> {
        let store = Arc::clone(&self.store);
        let done = tokio::task::spawn_blocking(move || work(&store)).await;
        done.map_err(|_| ApiError::inside("a computation was cancelled"))?.map_err(ApiError::from)
    }

    /// Writes a rejection to the audit log: immediately, or combined with similar ones of the same minute.
    pub(super) async fn refused(self: &Arc<Self>, refusal: Refusal, from: IpAddr, object: &str) {
        let Some(key) = self.refusals.count(refusal, from, object) else {
            return;
        };
        let details = json!({ "from": from });
        self.record("centre", refusal.action(), object.to_owned(), details).await;
        let page = Arc::clone(self);
        tokio::spawn(async move {
            tokio::time::sleep(REFUSAL_WINDOW).await;
            if let Some(further) = page.refusals.take(key) {
                let details =
                    json!({ "from": from, "count": further.count, "tried": further.tried });
                page.record("centre", refusal.action(), String::new(), details).await;
            }
        });
    }

    pub(super) async fn record(
        self: &Arc<Self>,
        by: &str,
        action: &'static str,
        object: String,
        details: serde_json::Value,
    ) {
        let by = by.to_owned();
        let written = self.query(move |store| store.audit(&by, action, &object, details)).await;
        if written.is_err() {
            tracing::error!("page: {action} could not be written into the audit log");
        }
    }

    /// Waits for one of the two permits to hash or compare a password.
    pub(super) async fn password_place(&self) -> Place {
        Arc::clone(&self.passwords).acquire_owned().await
    }

    /// Runs a computation on a blocking thread, one at a time.
    pub(super) async fn work<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ApiError> {
        let place = Arc::clone(&self.works).acquire_owned().await;
        let done = in_place(place, work).await;
        done.map_err(|_| ApiError::inside("a computation was cancelled"))
    }

    pub(super) fn kept_map(&self, sha256: &str) -> Option<Bytes> {
        let maps = self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        maps.get(sha256).cloned()
    }

    pub(super) fn keep_map(&self, sha256: &str, map: Bytes) {
        let mut maps = self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        if maps.len() >= MAX_MAPS {
            maps.clear();
        }
        maps.insert(sha256.to_owned(), map);
    }
}

/// Permit for work on a blocking thread.
type Place = Result<OwnedSemaphorePermit, AcquireError>;

/// Runs work on a blocking thread. The permit is held until the work ends, even if the client has disconnected by then.
pub(super) async fn in_place<T: Send + 'static>(
    place: Place,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, JoinError> {
    tokio::task::spawn_blocking(move || {
        let done = work();
        drop(place);
        done
    })
    .await
}

#[derive(Debug)]
pub(super) struct ApiError {
    status: StatusCode,
    why: String,
}

impl ApiError {
    pub(super) fn new(status: StatusCode, why: impl Into<String>) -> Self {
        let why = why.into();
        Self { status, why }
    }

    pub(super) fn wrong(why: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, why)
    }

    pub(super) fn missing(why: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, why)
    }

    pub(super) fn conflict(why: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, why)
    }

    /// An internal failure; the details go to the log, not to the response.
    pub(super) fn inside(why: impl std::fmt::Display) -> Self {
        tracing::error!("page: {why}");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal error: see the log of the centre")
    }
}

impl From<Error> for ApiError {
    fn from(error: Error) -> Self {
        match error {
            Error::Conflict(_)
            | Error::NotConfirmed(_)
            | Error::Misfit(_)
            | Error::NoWayBack { .. } => Self::conflict(error.to_string()),
            Error::Missing { .. } => Self::missing(error.to_string()),
            error => Self::inside(error),
        }
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        (self.status, Json(json!({ "error": self.why }))).into_response()
    }
}

pub(super) type ApiResult = Result<Response, ApiError>;

pub(super) fn document(document: &impl Serialize) -> ApiResult {
    let bytes = serde_json::to_vec(document).map_err(ApiError::inside)?;
    Ok(json_bytes(bytes))
}

pub(super) fn json_bytes(bytes: impl Into<axum::body::Body>) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], bytes.into()).into_response()
}

pub(super) fn done() -> ApiResult {
    document(&json!({ "done": true }))
}

pub(super) fn read<T: serde::de::DeserializeOwned>(body: &[u8]) -> Result<T, ApiError> {
    serde_json::from_slice(body).map_err(|error| ApiError::wrong(format!("request body: {error}")))
}

/// Maximum age of an overview that is presented as current. The limit grows by three times the build time of the
/// overview, but by at most [`MAX_BUILD_MARGIN`].
const MAX_AGE: Duration = Duration::from_secs(5);
const MAX_BUILD_MARGIN: Duration = Duration::from_secs(25);

/// The overview that the web interface polls every second, serialized.
#[derive(Default)]
pub(super) struct Overview {
    pub(super) document: Bytes,
    ages_s: HashMap<MachineId, f64>,
    /// When the overview was built, and how long that took.
    made: Option<(Instant, Duration)>,
}

/// Row of a machine. Unknown values are `null`.
#[derive(Serialize)]
struct Row<'a> {
    machine: &'a MachineId,
    site: &'a str,
    structure: &'a str,
    control: &'a str,
    /// State of the guard; `unknown` if the machine is silent, `never connected` if it has never sent a message.
    state: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    was: Option<&'a str>,
    reasons: &'a [String],
    age_s: Option<f64>,
    silent: bool,
    armed: Option<bool>,
    enable: bool,
    version: Option<u64>,
    wanted: Option<u64>,
    model: Option<&'a str>,
    correction_um: Option<f64>,
    residual_um: Option<f64>,
    /// Lowest sensor temperature, °C.
    coldest_degc: Option<f64>,
    /// Highest sensor temperature, °C.
    warmest_degc: Option<f64>,
    broken_sensors: usize,
    alarms: usize,
    worst: Option<Severity>,
    due_in_days: Option<f64>,
}

#[derive(Serialize)]
struct Document<'a> {
    /// Creation time, s since 1970.
    made_s: f64,
    notice: &'a str,
    machines: Vec<Row<'a>>,
    centre: Vec<&'a Alarm>,
}

impl Overview {
    pub(super) fn of(store: &Store, ages: &mut Ages, notice: &str) -> Result<Self, Error> {
        let began = Instant::now();
        let machines = store.machines()?;
        let live = store.live()?;
        let alarms = store.open_alarms()?;
        let mut alarms_by_machine: HashMap<&MachineId, Vec<&Alarm>> = HashMap::new();
        let mut centre = Vec::new();
        for alarm in &alarms {
            match &alarm.machine {
                Some(machine) => alarms_by_machine.entry(machine).or_default().push(alarm),
                None => centre.push(alarm),
            }
        }
        let trouble = store_alarm(store);
        centre.extend(&trouble);
        let issued = store.newest_versions()?;
        let (now_s, now) = (now_s(), Instant::now());
        let models = store.newest_models()?;
        let mut overdue = HashMap::new();
        for machine in &machines {
            let id = &machine.identity.machine;
            let (newest, live) = (issued.get(id), live.get(id));
            let days = overdue_days(store, machine, newest, live, &models, now_s)?;
            overdue.insert(id, days);
        }
        let mut ages_s = HashMap::new();
        let rows = machines
            .iter()
            .map(|machine| {
                let id = &machine.identity.machine;
                let heard = live.get(id);
                let made = heard.and_then(Live::made);
                let age_s = made.map(|made| ages.age_s(id, made, now_s, now));
                if let Some(age_s) = age_s {
                    ages_s.insert(id.clone(), age_s);
                }
                let silent = age_s.is_none_or(|age_s| machine.is_silent(age_s));
                let reported = heard.and_then(|live| live.condition.as_ref());
                let condition = reported.filter(|_| !silent);
                let state = match condition {
                    Some(condition) => condition.state.as_str(),
                    None if heard.is_some() => "unknown",
                    None => "never connected",
                };
                let alarms = alarms_by_machine.get(id).map_or(&[][..], Vec::as_slice);
                let degc: Vec<Option<f64>> = condition
                    .map(|it| it.temperatures_degc.values().copied().collect())
                    .unwrap_or_default();
                let known = || degc.iter().flatten().copied();
                let wanted = issued.get(id);
                Row {
                    machine: id,
                    site: machine.identity.site.as_str(),
                    structure: &machine.structure,
                    control: &machine.control,
                    state,
                    was: reported.filter(|_| silent).map(|it| it.state.as_str()),
                    reasons: condition.map_or(&[][..], |it| it.reasons.as_slice()),
                    age_s: age_s.map(|age_s| (age_s * 10.0).round() / 10.0),
                    silent,
                    armed: condition.map(|it| it.armed),
                    enable: machine.enable,
                    version: heard.filter(|_| !silent).map(|live| live.version),
                    wanted: wanted.map(|wanted| wanted.version),
                    model: wanted.map(|wanted| wanted.model.as_str()),
                    correction_um: condition.and_then(|it| largest(&it.correction_um)),
                    residual_um: condition.and_then(|it| it.residual_um),
                    coldest_degc: known().reduce(f64::min),
                    warmest_degc: known().reduce(f64::max),
                    broken_sensors: degc.iter().filter(|degc| degc.is_none()).count(),
                    alarms: alarms.len(),
                    worst: alarms.iter().map(|alarm| alarm.severity).max(),
                    due_in_days: overdue.get(id).copied().flatten().map(|days| -days),
                }
            })
            .collect();
        let document = Document { made_s: now_s, notice, machines: rows, centre };
        Ok(Self {
            document: serde_json::to_vec(&document)?.into(),
            ages_s,
            made: Some((began, began.elapsed())),
        })
    }

    /// Age of the overview if it is too old to be presented as current. The overview is rebuilt every second, or less
    /// often with many machines.
    pub(super) fn too_old(&self) -> Option<Duration> {
        let (at, took) = self.made?;
        let age = at.elapsed();
        (age > MAX_AGE + (3 * took).min(MAX_BUILD_MARGIN)).then_some(age)
    }

    pub(super) fn age_s(&self, machine: &MachineId) -> Option<f64> {
        let (at, _) = self.made?;
        Some(self.ages_s.get(machine)? + at.elapsed().as_secs_f64())
    }
}

/// Alarm for a database that rejects writes; the database therefore cannot store this alarm.
pub(super) fn store_alarm(store: &Store) -> Option<Alarm> {
    let (for_long, what) = store.trouble()?;
    Some(Alarm {
        id: 0,
        machine: None,
        kind: AlarmKind::Store,
        severity: AlarmKind::Store.severity(),
        text: format!(
            "the database {what}; the machines keep working, their messages wait at the NATS server, and changes made here are not stored"
        ),
        since_s: now_s() - for_long.as_secs_f64(),
        until_s: None,
        seen_by: None,
    })
}

fn largest<K>(values: &BTreeMap<K, f64>) -> Option<f64> {
    values.values().map(|value| value.abs()).reduce(f64::max)
}

/// Age of each machine's last condition by this program's monotonic clock. Comparing two wall clocks could make a
/// machine appear silent, or hide its silence, so only the first condition after a start is dated by them. The time for
/// which a condition waited at the gateway is included.
///
/// State: when the last condition of each machine was first seen.
#[derive(Default)]
pub(super) struct Ages(HashMap<MachineId, LastCondition>);

struct LastCondition {
    made: CreationTime,
    at: Instant,
    then_s: f64,
}

impl Ages {
    /// Age of a machine's last condition, s; `now_s` is the time of this computer.
    pub(super) fn age_s(
        &mut self,
        machine: &MachineId,
        made: CreationTime,
        now_s: f64,
        now: Instant,
    ) -> f64 {
        match self.0.get_mut(machine) {
            Some(seen) if seen.made == made => {
                seen.then_s + now.saturating_duration_since(seen.at).as_secs_f64()
            }
            Some(seen) => {
                *seen = LastCondition { made, at: now, then_s: made.late_s };
                made.late_s
            }
            None => {
                // First observation: only the wall clocks are available.
                let then_s = (now_s - made.at_s).max(made.late_s);
                let seen = LastCondition { made, at: now, then_s };
                self.0.insert(machine.clone(), seen);
                then_s
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::Ages;
    use crate::records::CreationTime;

    #[test]
    fn a_server_clock_offset_does_not_change_ages() {
        let machine = "mill-1".parse().unwrap();
        let made = |at_s| CreationTime { at_s, late_s: 0.0 };
        for ahead_s in [-3600.0, 0.0, 3600.0] {
            let mut ages = Ages::default();
            let start = Instant::now();
            let at = |s: u64| start + Duration::from_secs(s);
            ages.age_s(&machine, made(1000.0 + ahead_s), 1000.0, at(0));
            assert_eq!(ages.age_s(&machine, made(1001.0 + ahead_s), 1001.0, at(1)), 0.0);
            // The machine falls silent.
            assert_eq!(ages.age_s(&machine, made(1001.0 + ahead_s), 1010.0, at(10)), 9.0);
            // The clock of this computer is set back.
            assert_eq!(ages.age_s(&machine, made(1001.0 + ahead_s), 5.0, at(20)), 19.0);
        }
    }
}
