//! Connections: how many, how slow, with TLS where others can listen.

use std::{
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
        mpsc::SyncSender,
    },
    time::Duration,
};

use axum::Extension;
use hyper::server::conn::http1;
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpListener, TcpStream},
    sync::Semaphore,
};
use tokio_rustls::TlsAcceptor;

use super::{routes, tokens::Tokens};
use crate::service::{Asked, Published};

/// Connections at the most.
const MAX_CONNECTIONS: usize = 64;
/// Event streams at the most.
pub(super) const MAX_STREAMS: usize = 16;
/// A header must be whole after so long; between requests a connection may idle as long.
const HEADER_WITHIN: Duration = Duration::from_secs(5);
const HANDSHAKE_WITHIN: Duration = Duration::from_secs(5);

/// What the routes share.
pub struct Dashboard {
    /// What is shown.
    pub published: Published,
    /// Requests to the service.
    pub asks: SyncSender<Asked>,
    /// Who may do what.
    pub tokens: Tokens,
    /// Names besides addresses.
    pub hosts: Vec<String>,
    /// Others can reach it.
    pub reading_needs_token: bool,
    /// Event streams that are open.
    pub streams: AtomicUsize,
}

/// A place among the event streams, given back with it.
pub(super) struct StreamSlot(Arc<Dashboard>);

impl StreamSlot {
    pub(super) fn take(dashboard: &Arc<Dashboard>) -> Option<Self> {
        let more = |open| (open < MAX_STREAMS).then_some(open + 1);
        let taken = dashboard
            .streams
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, more);
        taken.ok().map(|_| Self(Arc::clone(dashboard)))
    }
}

impl Drop for StreamSlot {
    fn drop(&mut self) {
        self.0.streams.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Serves until the runtime ends.
pub async fn serve(listener: TcpListener, tls: Option<TlsAcceptor>, dashboard: Arc<Dashboard>) {
    let router = routes::router(dashboard);
    let slots = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let (stream, from) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(e) => {
                // Out of descriptors: some will be given back.
                tracing::warn!("dashboard: {e}");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        // The next one waits in the kernel's queue until a connection ends.
        let Ok(slot) = Arc::clone(&slots).acquire_owned().await else {
            return;
        };
        let (router, tls) = (router.clone().layer(Extension(from)), tls.clone());
        tokio::spawn(async move {
            connection(stream, from, tls, router).await;
            drop(slot);
        });
    }
}

async fn connection(
    stream: TcpStream,
    from: SocketAddr,
    tls: Option<TlsAcceptor>,
    router: axum::Router,
) {
    let _ = stream.set_nodelay(true);
    match tls {
        None => exchange(stream, router).await,
        Some(tls) => match tokio::time::timeout(HANDSHAKE_WITHIN, tls.accept(stream)).await {
            Ok(Ok(stream)) => exchange(stream, router).await,
            Ok(Err(e)) => tracing::debug!("dashboard: {from}: {e}"),
            Err(_) => tracing::debug!("dashboard: {from}: no TLS handshake"),
        },
    }
}

async fn exchange(stream: impl AsyncRead + AsyncWrite + Unpin, router: axum::Router) {
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_WITHIN)
        .max_headers(64)
        .max_buf_size(64 * 1024)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .await;
    if let Err(e) = served {
        tracing::debug!("dashboard: {e}");
    }
}
