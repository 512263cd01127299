//! The search of the network from the page: one at a time.

use std::sync::{Arc, Mutex, PoisonError};

use axum::{Extension, body::Bytes, extract::State};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{
    answer::{Answer, Refused, document, done, read},
    state::Shared,
};
use crate::{
    discover::{Device, FASTEST_PER_SECOND, NotSearched, PER_SECOND, Search, Subnet},
    users::User,
};

/// The most subnets of one search.
const MOST_SUBNETS: usize = 32;

/// State: the last search.
#[derive(Default)]
pub(super) struct Searches(Mutex<Latest>);

#[derive(Clone, Default, Serialize)]
struct Latest {
    running: bool,
    by: String,
    subnets: Vec<String>,
    /// Addresses that are done, and how many there are.
    done: usize,
    of: usize,
    devices: Vec<Device>,
}

impl Searches {
    fn with<T>(&self, work: impl FnOnce(&mut Latest) -> T) -> T {
        work(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

pub(super) async fn latest(State(page): Shared) -> Answer {
    document(&page.searches.with(|latest| latest.clone()))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Ask {
    subnets: Vec<String>,
    /// Whether public ranges belong to whoever asks.
    #[serde(default)]
    mine: bool,
    #[serde(default)]
    per_second: Option<f64>,
}

pub(super) async fn search(
    State(page): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> Answer {
    let ask: Ask = read(&body)?;
    if ask.subnets.is_empty() || ask.subnets.len() > MOST_SUBNETS {
        return Err(Refused::wrong(format!(
            "subnets: expected 1 to {MOST_SUBNETS}"
        )));
    }
    let mut subnets = Vec::new();
    for text in &ask.subnets {
        let subnet: Subnet = text.parse().map_err(|e| Refused::wrong(format!("{e}")))?;
        subnet.check(ask.mine).map_err(|error| {
            Refused::wrong(match error {
                // The way on is a box of the page, and no option of the command line.
                NotSearched::Public { found } => format!(
                    "{found} is not a private range: others' computers may be there. If it is yours tick the box below the subnets"
                ),
                error => error.to_string(),
            })
        })?;
        subnets.push(subnet);
    }
    let per_second = ask.per_second.unwrap_or(PER_SECOND);
    if !(1.0..=FASTEST_PER_SECOND).contains(&per_second) {
        return Err(Refused::wrong(format!(
            "per_second: found {per_second}, expected 1 to {FASTEST_PER_SECOND}"
        )));
    }
    let mut search = Search::new(subnets);
    search.per_second = per_second;
    if let Some(ports) = &page.settings.ports {
        search.ports.clone_from(ports);
    }
    let of = search.addresses();
    let details = json!({ "subnets": ask.subnets, "per_second": per_second, "mine": ask.mine });
    let begun = page.searches.with(|latest| {
        if latest.running {
            return false;
        }
        *latest = Latest {
            running: true,
            by: user.name.to_string(),
            subnets: ask.subnets.clone(),
            of,
            ..Latest::default()
        };
        true
    });
    if !begun {
        return Err(Refused::conflict("a search is running already"));
    }
    let shared = Arc::clone(&page);
    tokio::spawn(async move {
        let telling = Arc::clone(&shared);
        let devices = search
            .run(move |done| telling.searches.with(|latest| latest.done = done))
            .await;
        shared.searches.with(|latest| {
            latest.devices = devices;
            latest.running = false;
        });
    });
    page.ask(move |store| store.audit(user.name.as_str(), "discover", "network", details))
        .await?;
    done()
}
