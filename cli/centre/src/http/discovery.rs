//! The network search in the web interface: one at a time.

use std::sync::Arc;

use axum::{Extension, body::Bytes, extract::State};
use serde::Deserialize;
use serde_json::json;

use super::{
    answer::{Answer, Refused, document, done, read},
    state::{NetworkSearch, Shared},
};
use crate::{
    discover::{FASTEST_PER_SECOND, NotSearched, PER_SECOND, Search, Subnet},
    users::User,
};

/// Maximum number of subnets of one search.
const MAX_SUBNETS: usize = 32;

pub(super) async fn latest(State(page): Shared) -> Answer {
    document(&page.with_search(|latest| latest.clone()))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Ask {
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
) -> Answer {
    let ask: Ask = read(&body)?;
    if ask.subnets.is_empty() || ask.subnets.len() > MAX_SUBNETS {
        return Err(Refused::wrong(format!(
            "subnets: expected 1 to {MAX_SUBNETS}"
        )));
    }
    let mut subnets = Vec::new();
    for text in &ask.subnets {
        let subnet: Subnet = text.parse().map_err(|e| Refused::wrong(format!("{e}")))?;
        subnet.check(ask.mine).map_err(|error| {
            Refused::wrong(match error {
                // In the web interface the remedy is a check box, not a command-line option.
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
    let begun = page.with_search(|latest| {
        if latest.running {
            return false;
        }
        *latest = NetworkSearch {
            running: true,
            by: user.name.to_string(),
            subnets: ask.subnets.clone(),
            of,
            ..NetworkSearch::default()
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
            .run(move |done| telling.with_search(|latest| latest.done = done))
            .await;
        shared.with_search(|latest| {
            latest.devices = devices;
            latest.running = false;
        });
    });
    page.ask(move |store| store.audit(user.name.as_str(), "discover", "network", details))
        .await?;
    done()
}
