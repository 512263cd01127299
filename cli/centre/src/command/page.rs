//! The web interface served by the running centre.

use std::sync::Arc;

use tokio::{net::TcpListener, task::JoinHandle};
use volcomp_web::tls;

use crate::{
    Error,
    config::PageConfig,
    http::{PageSettings, PageState, router},
    rollout::Rules,
    store::Store,
};

/// Waits until a task of the web interface ends, which is always a failure. Never returns without a web interface.
pub(super) async fn ended(page: Option<&mut [JoinHandle<()>; 2]>) {
    match page {
        Some([refreshed, served]) => {
            tokio::select! {
                _ = refreshed => {}
                _ = served => {}
            }
        }
        None => std::future::pending().await,
    }
}

/// Serves the web interface on the runtime of the caller.
pub(super) async fn serve(
    config: &PageConfig,
    rules: Rules,
    store: &Arc<Store>,
) -> Result<[JoinHandle<()>; 2], Error> {
    let acceptor = match config.tls() {
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
        Error::Failed(format!("the page cannot be served on {}: {why}", config.listen))
    })?;
    let scheme = if acceptor.is_some() { "https" } else { "http" };
    tracing::info!("the page is on {scheme}://{}", listener.local_addr()?);
    let of_store = Arc::clone(store);
    // A database query may block, so it must not run on a runtime thread.
    let users = tokio::task::spawn_blocking(move || of_store.users()).await;
    if users.map_err(std::io::Error::other)??.is_empty() {
        tracing::warn!("nobody can log in: volcomp-centre user add NAME --role admin");
    }
    let page = PageState::new(
        Arc::clone(store),
        PageSettings {
            hosts: config.hosts.clone(),
            secure: acceptor.is_some(),
            rules,
            ..PageSettings::default()
        },
    );
    Ok([
        tokio::spawn(Arc::clone(&page).refresh()),
        tokio::spawn(volcomp_web::serve(listener, acceptor, router(&page))),
    ])
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Either part that ends by itself, in good order or by a fault of the program, is noticed; nothing is noticed of a page
    /// that works, or of none.
    #[tokio::test]
    async fn a_part_that_ends_is_noticed() {
        let for_ever = || tokio::spawn(std::future::pending::<()>());
        let at_once = || tokio::spawn(std::future::ready(()));
        let faulty = || tokio::spawn(async { panic!("injected") });
        let soon = Duration::from_millis(50);
        for (mut page, ends) in [
            ([for_ever(), for_ever()], false),
            ([at_once(), for_ever()], true),
            ([for_ever(), at_once()], true),
            ([faulty(), for_ever()], true),
            ([for_ever(), faulty()], true),
        ] {
            let within = if ends { Duration::from_secs(60) } else { soon };
            let noticed = tokio::time::timeout(within, ended(Some(&mut page))).await;
            assert_eq!(noticed.is_ok(), ends);
        }
        assert!(tokio::time::timeout(soon, ended(None)).await.is_err());
    }
}
