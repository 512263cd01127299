//! The clients of the adapter. Each has a separate task with the state last sent to it, so that clients do not delay
//! each other. A client that does not read is disconnected.

use std::{
    collections::VecDeque,
    net::SocketAddr,
    sync::Arc,
    time::{Duration, SystemTime},
};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    task::AbortHandle,
    time::{MissedTickBehavior, interval, timeout},
};

use super::lines::{Items, Told};
use crate::published::Published;

/// Interval at which changes are sent.
const EVERY: Duration = Duration::from_millis(100);
/// Clients that do not read for this long are disconnected.
const WRITE_WITHIN: Duration = Duration::from_secs(5);
/// Maximum number of clients; a further one replaces the oldest.
const MAX_CLIENTS: usize = 16;
/// Requested interval between two `* PING`. After twice this time without one the connection is closed.
const HEARTBEAT: Duration = Duration::from_secs(10);
/// Maximum length of a line from a client, bytes.
const MAX_LINE: usize = 1024;

/// Serves until the runtime ends.
pub(super) async fn serve(listener: TcpListener, items: Arc<Items>, published: Published) {
    let mut open: VecDeque<AbortHandle> = VecDeque::new();
    loop {
        let (stream, from) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(e) => {
                // No file descriptors are left: retry later.
                tracing::warn!("SHDR: {e}");
                tokio::time::sleep(EVERY).await;
                continue;
            }
        };
        open.retain(|client| !client.is_finished());
        if open.len() >= MAX_CLIENTS
            && let Some(oldest) = open.pop_front()
        {
            oldest.abort();
        }
        let told = client(stream, from, Arc::clone(&items), published.clone());
        open.push_back(tokio::spawn(told).abort_handle());
    }
}

async fn client(stream: TcpStream, from: SocketAddr, items: Arc<Items>, published: Published) {
    let why = exchange(stream, &items, &published).await;
    tracing::debug!("SHDR: {from}: {why}");
}

/// Sends changes to a client until it disconnects. Returns why the connection ended.
async fn exchange(stream: TcpStream, items: &Items, published: &Published) -> String {
    let _ = stream.set_nodelay(true);
    let (mut reader, mut writer) = stream.into_split();
    let mut told = Told::nothing(items);
    let mut heard = Vec::with_capacity(MAX_LINE);
    let mut asked: Option<Duration> = None;
    let mut tick = interval(EVERY);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        let text = tokio::select! {
            read = reader.read_buf(&mut heard) => match read {
                Ok(0) => return "closed".to_owned(),
                Err(e) => return e.to_string(),
                Ok(_) => match answers(&mut heard) {
                    None => return "a line is too long".to_owned(),
                    Some(text) => {
                        if !text.is_empty() {
                            asked = Some(published.clock().elapsed());
                        }
                        text
                    }
                },
            },
            _ = tick.tick() => {
                let now = published.clock().elapsed();
                if asked.is_some_and(|asked| now.saturating_sub(asked) > 2 * HEARTBEAT) {
                    return "no PING".to_owned();
                }
                told.changes(items, &published.latest(), SystemTime::now())
            }
        };
        match timeout(WRITE_WITHIN, writer.write_all(text.as_bytes())).await {
            Ok(Ok(())) => {}
            Ok(Err(e)) => return e.to_string(),
            Err(_) => return "it does not read".to_owned(),
        }
    }
}

/// Removes complete lines from the received bytes and returns the responses; `None` if a line is too long. Only `*
/// PING` has a response: no input from a client changes anything.
fn answers(heard: &mut Vec<u8>) -> Option<String> {
    let mut text = String::new();
    let pong = format!("* PONG {}\n", HEARTBEAT.as_millis());
    while let Some(end) = heard.iter().position(|byte| *byte == b'\n') {
        let line: Vec<u8> = heard.drain(..=end).collect();
        if line.trim_ascii().starts_with(b"* PING") {
            text += &pong;
        }
    }
    (heard.len() < MAX_LINE).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_pings_are_answered() {
        for (heard, expected, rest) in [
            ("* PING\n", Some("* PONG 10000\n"), ""),
            ("* PING\r\n* PI", Some("* PONG 10000\n"), "* PI"),
            ("* PING\n* PING\n", Some("* PONG 10000\n* PONG 10000\n"), ""),
            ("* arm\n|x|1\n", Some(""), ""),
            ("PING\n", Some(""), ""),
        ] {
            let mut bytes = heard.as_bytes().to_vec();
            assert_eq!(answers(&mut bytes).as_deref(), expected, "{heard:?}");
            assert_eq!(bytes, rest.as_bytes(), "{heard:?}");
        }
        assert_eq!(answers(&mut vec![b'x'; MAX_LINE]), None);
    }
}
