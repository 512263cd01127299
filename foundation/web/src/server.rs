//! Connections: how many at one time, how slow, and with TLS where others can listen.

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

/// The largest number of connections at one time. With another one the oldest ends: clients that do not read, or send
/// nothing, so keep nobody else out.
const MAX_CONNECTIONS: usize = 64;
/// The largest number of connections of all servers of the program together: the descriptors above belong to what the program
/// does besides.
const MAX_OF_ALL: usize = 256;
/// The connections of all servers of the program, the oldest first.
static OF_ALL: Mutex<VecDeque<AbortHandle>> = Mutex::new(VecDeque::new());
/// The header of a request must be whole after so long; between requests a connection may idle as long.
const HEADER_WITHIN: Duration = Duration::from_secs(5);
/// The handshake of TLS must be done after so long.
const HANDSHAKE_WITHIN: Duration = Duration::from_secs(5);

/// Serves until the runtime ends. Every request has the address from which it comes as an `Extension<SocketAddr>`.
pub async fn serve(listener: TcpListener, tls: Option<Tls>, router: Router) {
    let mut open: VecDeque<AbortHandle> = VecDeque::new();
    loop {
        let (stream, from) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(e) => {
                // Out of descriptors: some will be given back.
                tracing::warn!("page: {e}");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        make_place(&mut open, MAX_CONNECTIONS);
        let (router, tls) = (router.clone().layer(Extension(from)), tls.clone());
        let served = tokio::spawn(connection(stream, from, tls, router).in_current_span());
        open.push_back(served.abort_handle());
        let mut all = OF_ALL.lock().unwrap_or_else(PoisonError::into_inner);
        make_place(&mut all, MAX_OF_ALL);
        all.push_back(served.abort_handle());
    }
}

/// Ends the oldest connection where there are as many as there may be.
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
        Some(tls) => match tokio::time::timeout(HANDSHAKE_WITHIN, tls.accept(stream)).await {
            Ok(Ok(stream)) => exchange(stream, router).await,
            Ok(Err(e)) => tracing::debug!("page: {from}: {e}"),
            Err(_) => tracing::debug!("page: {from}: no TLS handshake"),
        },
    }
}

async fn exchange(stream: impl AsyncRead + AsyncWrite + Unpin, router: Router) {
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_WITHIN)
        .max_headers(64)
        .max_buf_size(64 * 1024)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .await;
    if let Err(e) = served {
        tracing::debug!("page: {e}");
    }
}
