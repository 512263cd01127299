//! A proxy in front of the OPC UA server. It limits the number of clients and their input rate, and disconnects clients
//! that do not read.

use std::{convert::Infallible, io, net::SocketAddr, sync::Arc, time::Duration};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    sync::Semaphore,
    time::{Instant, sleep, sleep_until, timeout},
};

/// Maximum number of clients; further ones are disconnected, so that existing connections remain.
pub(super) const MAX_CLIENTS: usize = 16;
/// Clients that do not read for this long are disconnected.
const WRITE_WITHIN: Duration = Duration::from_secs(5);
/// Maximum size of one read from a client, bytes; with one read per [`PACE`] the input rate is at most 1.6 MB/s.
const CHUNK: usize = 8 * 1024;
const PACE: Duration = Duration::from_millis(5);
/// Retry interval when `accept` fails because no file descriptors are left.
const AGAIN: Duration = Duration::from_millis(100);

/// Forwards clients to the server at `inner`.
pub(super) async fn serve(listener: TcpListener, inner: SocketAddr) -> Infallible {
    let places = Arc::new(Semaphore::new(MAX_CLIENTS));
    loop {
        let Ok((client, _)) = listener.accept().await else {
            sleep(AGAIN).await;
            continue;
        };
        // Without a free slot the connection is closed.
        if let Ok(place) = Arc::clone(&places).try_acquire_owned() {
            tokio::spawn(async move {
                // The error only says that one side has closed the connection.
                let _ = pass(client, inner).await;
                drop(place);
            });
        }
    }
}

/// Forwards both directions until one side closes. Nothing is read from a client that does not read, so that responses
/// do not pile up.
async fn pass(mut client: TcpStream, inner: SocketAddr) -> io::Result<()> {
    let mut server = TcpStream::connect(inner).await?;
    client.set_nodelay(true)?;
    server.set_nodelay(true)?;
    let [mut asked, mut told] = [(); 2].map(|()| vec![0; CHUNK]);
    let mut next = Instant::now();
    loop {
        let heard = async {
            sleep_until(next).await;
            client.read(&mut asked).await
        };
        let (to, bytes) = tokio::select! {
            read = heard => {
                next = Instant::now() + PACE;
                (&mut server, &asked[..read?])
            }
            read = server.read(&mut told) => (&mut client, &told[..read?]),
        };
        if bytes.is_empty() {
            return Ok(());
        }
        timeout(WRITE_WITHIN, to.write_all(bytes)).await??;
    }
}
