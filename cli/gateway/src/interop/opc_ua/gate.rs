//! The gate before the server: so many clients at one time, none faster than the server answers it, and nobody is waited for.

use std::{convert::Infallible, io, net::SocketAddr, sync::Arc, time::Duration};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    sync::Semaphore,
    time::{Instant, sleep, sleep_until, timeout},
};

/// The largest number of clients; another one is sent away, so that those who are there stay.
pub(super) const MAX_CLIENTS: usize = 16;
/// A client that takes nothing for so long is let go.
const WRITE_WITHIN: Duration = Duration::from_secs(5);
/// So much of a client is heard at once, bytes, and the time until it is heard again: 1.6 MB/s.
const CHUNK: usize = 8 * 1024;
const PACE: Duration = Duration::from_millis(5);
/// Out of descriptors: some will be given back.
const AGAIN: Duration = Duration::from_millis(100);

/// Lets clients through to the server at `inner`.
pub(super) async fn serve(listener: TcpListener, inner: SocketAddr) -> Infallible {
    let places = Arc::new(Semaphore::new(MAX_CLIENTS));
    loop {
        let Ok((client, _)) = listener.accept().await else {
            sleep(AGAIN).await;
            continue;
        };
        // Without a place the connection closes.
        if let Ok(place) = Arc::clone(&places).try_acquire_owned() {
            tokio::spawn(async move {
                // It ends because one of both has closed: there is nobody to be told why.
                let _ = pass(client, inner).await;
                drop(place);
            });
        }
    }
}

/// Passes on what both say until one of them ends. While a client does not read, it is not heard either: no answers pile up.
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
