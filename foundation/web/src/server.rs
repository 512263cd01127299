//! HTTP connections: limits on their number and speed, and TLS for use over a network.

use std::{
    collections::VecDeque,
    net::SocketAddr,
    sync::{Mutex, PoisonError},
    time::Duration,
};

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::{
    rt::{TokioIo, TokioTimer},
    service::TowerToHyperService,
};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpListener, TcpStream},
    task::AbortHandle,
};
use tracing::Instrument;

use crate::Tls;

/// Maximum number of simultaneous connections of one server. A further connection closes the oldest, so that idle
/// clients cannot block other clients.
const MAX_CONNECTIONS: usize = 64;
/// Maximum number of simultaneous connections of all servers of the program together. The limit leaves file descriptors
/// for the program's other tasks.
const MAX_TOTAL_CONNECTIONS: usize = 256;
/// Connections of all servers of the program, the oldest first.
static ALL_CONNECTIONS: Mutex<VecDeque<AbortHandle>> = Mutex::new(VecDeque::new());
/// Timeout for receiving the complete header of a request, and idle timeout between requests.
const HEADER_TIMEOUT: Duration = Duration::from_secs(5);
const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// Accepts connections and serves them until the runtime ends. Every request has the client's address as an
/// `Extension<SocketAddr>`.
pub async fn serve(listener: TcpListener, tls: Option<Tls>, router: Router) {
    let mut open: VecDeque<AbortHandle> = VecDeque::new();
    loop {
        let (stream, from) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(e) => {
                // Out of file descriptors: wait until connections release some.
                tracing::warn!("page: {e}");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        make_place(&mut open, MAX_CONNECTIONS);
        let (router, tls) = (router.clone().layer(Extension(from)), tls.clone());
        let served = tokio::spawn(connection(stream, from, tls, router).in_current_span());
        open.push_back(served.abort_handle());
        let mut all = ALL_CONNECTIONS.lock().unwrap_or_else(PoisonError::into_inner);
        make_place(&mut all, MAX_TOTAL_CONNECTIONS);
        all.push_back(served.abort_handle());
    }
}

/// Closes the oldest connection if `most` connections are open.
fn make_place(open: &mut VecDeque<AbortHandle>, most: usize) {
    open.retain(|connection| !connection.is_finished());
    if open.len() >= most
        && let Some(oldest) = open.pop_front()
    {
        oldest.abort();
    }
}

async fn connection(stream: TcpStream, from: SocketAddr, tls: Option<Tls>, router: Router) {
    let _ = stream.set_nodelay(true);
    match tls {
        None => exchange(stream, router).await,
        Some(tls) => match tokio::time::timeout(HANDSHAKE_TIMEOUT, tls.accept(stream)).await {
            Ok(Ok(stream)) => exchange(stream, router).await,
            Ok(Err(e)) => tracing::debug!("page: {from}: {e}"),
            Err(_) => tracing::debug!("page: {from}: no TLS handshake"),
        },
    }
}

async fn exchange(stream: impl AsyncRead + AsyncWrite + Unpin, router: Router) {
    let served = http1::Builder::new()
        // To write the header `Date`, hyper reads the clock and panics if its year is not within 1970 to 9999.
        .auto_date_header(false)
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIMEOUT)
        .max_headers(64)
        .max_buf_size(64 * 1024)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .await;
    if let Err(e) = served {
        tracing::debug!("page: {e}");
    }
}
