//! What the routes share.
//!
//! State: the overview, which is made anew every second; wrong passwords of the last minute; the last search of the network; maps
//! that were computed.

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::{Arc, Mutex, PoisonError, RwLock},
    time::Duration,
};

use axum::{body::Bytes, extract::State};
use tokio::sync::Semaphore;

use serde::Serialize;
use serde_json::json;

use super::{
    answer::Refused,
    overview::{Ages, Overview},
};
use crate::{
    Error,
    discover::{Device, Kind},
    rollout::Rules,
    store::Store,
    users::{REFUSAL_WINDOW, Refusal, Refusals, Throttle},
};

/// The overview is made so often.
const REFRESHED: Duration = Duration::from_secs(1);
/// So many maps are kept.
const MAPS: usize = 64;

/// How the page is served.
#[derive(Clone, Debug, Default)]
pub struct PageSettings {
    /// Host names, besides addresses, under which browsers may ask.
    pub hosts: Vec<String>,
    /// Whether connections have TLS: then cookies are sent over TLS alone.
    pub secure: bool,
    /// The rules of roll-outs that state none.
    pub rules: Rules,
    /// What is said above the page, such as that this is a demonstration.
    pub notice: String,
    /// Ports for the search of the network in place of the usual ones; for tests.
    pub ports: Option<Vec<(Kind, u16)>>,
}

/// The last search of the network.
#[derive(Clone, Default, Serialize)]
pub(super) struct NetworkSearch {
    pub(super) running: bool,
    pub(super) by: String,
    pub(super) subnets: Vec<String>,
    /// Addresses that are done, of how many.
    pub(super) done: usize,
    pub(super) of: usize,
    pub(super) devices: Vec<Device>,
}

/// What a route takes to reach the state.
pub(super) type Shared = State<Arc<PageState>>;

/// The state that the routes share.
pub struct PageState {
    pub(super) store: Arc<Store>,
    pub(super) settings: PageSettings,
    pub(super) throttle: Throttle,
    refusals: Refusals,
    /// Hashing a password takes memory and time: two at a time.
    pub(super) passwords: Semaphore,
    /// Models and maps take a processor for a while: one at a time.
    pub(super) works: Semaphore,
    pub(super) overview: RwLock<Arc<Overview>>,
    search: Mutex<NetworkSearch>,
    maps: Mutex<HashMap<String, Bytes>>,
}

impl PageState {
    /// The page of a store.
    pub fn new(store: Arc<Store>, settings: PageSettings) -> Arc<Self> {
        Arc::new(Self {
            store,
            settings,
            throttle: Throttle::default(),
            refusals: Refusals::default(),
            passwords: Semaphore::new(2),
            works: Semaphore::new(1),
            overview: RwLock::default(),
            search: Mutex::default(),
            maps: Mutex::default(),
        })
    }

    /// Makes the overview anew, again and again, until the runtime ends.
    pub async fn refresh(self: Arc<Self>) {
        let mut ages = Ages::default();
        let mut ticks = tokio::time::interval(REFRESHED);
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
                            let mut place = self
                                .overview
                                .write()
                                .unwrap_or_else(PoisonError::into_inner);
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

    /// Asks the store on a thread that may wait.
    pub(super) async fn ask<T: Send + 'static>(
        self: &Arc<Self>,
        work: impl FnOnce(&Store) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Refused> {
        let store = Arc::clone(&self.store);
        let done = tokio::task::spawn_blocking(move || work(&store)).await;
        done.map_err(|_| Refused::inside("the work ended before its time"))?
            .map_err(Refused::from)
    }

    /// Writes a refusal into the audit log: at once, or with others like it within a minute.
    pub(super) async fn refused(self: &Arc<Self>, refusal: Refusal, from: IpAddr, object: &str) {
        let Some(key) = self.refusals.count(refusal, from, object) else {
            return;
        };
        let details = json!({ "from": from });
        self.record("centre", refusal.action(), object.to_owned(), details)
            .await;
        let page = Arc::clone(self);
        tokio::spawn(async move {
            tokio::time::sleep(REFUSAL_WINDOW).await;
            if let Some(further) = page.refusals.take(key) {
                let details =
                    json!({ "from": from, "count": further.count, "tried": further.tried });
                page.record("centre", refusal.action(), String::new(), details)
                    .await;
            }
        });
    }

    /// Writes what was done, or refused, into the audit log.
    pub(super) async fn record(
        self: &Arc<Self>,
        by: &str,
        action: &'static str,
        object: String,
        details: serde_json::Value,
    ) {
        let by = by.to_owned();
        let written = self
            .ask(move |store| store.audit(&by, action, &object, details))
            .await;
        if written.is_err() {
            tracing::error!("page: {action} could not be written into the audit log");
        }
    }

    /// Works for a while on a thread that may wait, one work at a time.
    pub(super) async fn work<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Refused> {
        let place = self.works.acquire().await;
        let done = tokio::task::spawn_blocking(work).await;
        drop(place);
        done.map_err(|_| Refused::inside("the work ended before its time"))
    }

    pub(super) fn kept_map(&self, sha256: &str) -> Option<Bytes> {
        let maps = self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        maps.get(sha256).cloned()
    }

    pub(super) fn keep_map(&self, sha256: &str, map: Bytes) {
        let mut maps = self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        if maps.len() >= MAPS {
            maps.clear();
        }
        maps.insert(sha256.to_owned(), map);
    }
}
