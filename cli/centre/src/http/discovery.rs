//! The network search in the web interface: one at a time.

use std::sync::Arc;

use axum::{Extension, body::Bytes, extract::State};
use serde::Deserialize;
use serde_json::json;

use super::{
    response::{ApiError, ApiResult, document, done, read},
    state::{NetworkSearch, Shared},
};
use crate::{
    discover::{MAX_PER_SECOND, PER_SECOND, Search, Subnet, SubnetError},
    users::User,
};

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
