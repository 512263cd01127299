//! The page beside the running centre.

use std::sync::Arc;

use tokio::{net::TcpListener, task::JoinHandle};
use volcomp_web::tls;

use super::CommandError;
use crate::{
    config_page::PageConfig,
    http::{Face, FaceSettings, router},
    rollout::Rules,
    store::Store,
};

/// Serves the page on the runtime of the caller.
pub(super) async fn serve(
    config: &PageConfig,
    rules: Rules,
    store: &Arc<Store>,
) -> Result<[JoinHandle<()>; 2], CommandError> {
    let acceptor = match &config.tls {
        Some((certificate, key)) => Some(tls::acceptor(certificate, key)?),
        None => None,
    };
    let bound = TcpListener::bind(config.listen).await;
    let listener = bound.map_err(|error| {
        let why = if error.kind() == std::io::ErrorKind::AddrInUse {
            "another program has it: expected a free address, or that the other centre is ended first".to_owned()
        } else {
            error.to_string()
        };
        CommandError::Found(format!("the page cannot be served on {}: {why}", config.listen))
    })?;
    let scheme = if acceptor.is_some() { "https" } else { "http" };
    tracing::info!("the page is on {scheme}://{}", listener.local_addr()?);
    let of_store = Arc::clone(store);
    // A question to a database that waits: never on a thread of the runtime.
    let users = tokio::task::spawn_blocking(move || of_store.users()).await;
    if users.map_err(std::io::Error::other)??.is_empty() {
        tracing::warn!("nobody can log in: volcomp-centre user add NAME --role admin");
    }
    let face = Face::new(
        Arc::clone(store),
        FaceSettings {
            hosts: config.hosts.clone(),
            secure: acceptor.is_some(),
            rules,
            ..FaceSettings::default()
        },
    );
    Ok([
        tokio::spawn(Arc::clone(&face).refresh()),
        tokio::spawn(volcomp_web::serve(listener, acceptor, router(&face))),
    ])
}
