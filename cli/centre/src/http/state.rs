//! State shared by the routes: the overview, rebuilt every second; wrong passwords of the last
//! minute; the last network search; computed error maps.

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::{Arc, Mutex, PoisonError, RwLock},
    time::Duration,
};

use axum::{body::Bytes, extract::State};
use tokio::{
    sync::{AcquireError, OwnedSemaphorePermit, Semaphore},
    task::JoinError,
};

use serde::Serialize;
use serde_json::json;

use super::{
    overview::{Ages, Overview},
    response::ApiError,
};
use crate::{
    Error,
    discover::{Device, Kind},
    rollout::Rules,
    store::Store,
    users::{REFUSAL_WINDOW, Refusal, Refusals, Throttle},
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
pub(super) type Place = Result<OwnedSemaphorePermit, AcquireError>;

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
