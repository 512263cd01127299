//! Connections to the broker, one after the other: a connection that hangs is given up, and the next one begins with a birth.

use std::{
    io,
    time::{Duration, Instant, SystemTime},
};

use bytes::BytesMut;
use rumqttc::{Connect, ConnectReturnCode, LastWill, Login, Packet, Publish, QoS, Subscribe};
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::TcpStream,
    time::{MissedTickBehavior, interval, sleep, timeout},
};

use super::{
    credentials::Credentials,
    node::{Message, Node},
};
use crate::{config::SparkplugConfig, published::Published};

/// Connecting, the handshake of TLS, and the answer of the broker may take so long each.
const CONNECT_WITHIN: Duration = Duration::from_secs(10);
/// A broker that takes nothing for so long is given up.
const WRITE_WITHIN: Duration = Duration::from_secs(5);
/// The first and the longest pause before another try.
const PAUSES: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(30)];
/// The largest packet that is read, bytes: commands are small.
const MAX_PACKET: usize = 256 * 1024;

/// Why a connection ended.
#[derive(Debug, thiserror::Error)]
enum End {
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error("no answer in time")]
    Silent,
    #[error("the broker refuses: {0:?}")]
    Refused(ConnectReturnCode),
    #[error(transparent)]
    Packet(#[from] rumqttc::mqttbytes::Error),
    #[error("a packet that was not expected")]
    Unexpected,
}

/// Publishes until it is dropped.
pub(super) async fn run(
    config: SparkplugConfig,
    credentials: Credentials,
    mut node: Node,
    published: Published,
) {
    let mut pause = PAUSES[0];
    let mut last = String::new();
    loop {
        let mut was_born = false;
        let end = match connect(&config, &credentials, &mut node, &published, &mut was_born).await {
            Ok(never) => match never {},
            Err(end) => end.to_string(),
        };
        // The next will must be another one than that of this connection, which the broker may still publish.
        node.next_life();
        // The same trouble is told once.
        if was_born || end != last {
            tracing::warn!("sparkplug {}: {end}", config.url);
        }
        last = end;
        pause = if was_born {
            PAUSES[0]
        } else {
            (2 * pause).min(PAUSES[1])
        };
        sleep(pause).await;
    }
}

/// One connection until it ends.
async fn connect(
    config: &SparkplugConfig,
    credentials: &Credentials,
    node: &mut Node,
    published: &Published,
    was_born: &mut bool,
) -> Result<std::convert::Infallible, End> {
    let reach = TcpStream::connect((config.host.as_str(), config.port));
    let stream = in_time(CONNECT_WITHIN, reach).await?;
    stream.set_nodelay(true)?;
    match &credentials.tls {
        None => exchange(stream, config, credentials, node, published, was_born).await,
        Some((connector, name)) => {
            let stream = in_time(CONNECT_WITHIN, connector.connect(name.clone(), stream)).await?;
            exchange(stream, config, credentials, node, published, was_born).await
        }
    }
}

async fn in_time<T>(time: Duration, work: impl Future<Output = io::Result<T>>) -> Result<T, End> {
    Ok(timeout(time, work).await.map_err(|_| End::Silent)??)
}

/// What goes over a connection: the broker learns the will first, then the birth, then what changes.
async fn exchange(
    stream: impl AsyncRead + AsyncWrite + Unpin,
    config: &SparkplugConfig,
    credentials: &Credentials,
    node: &mut Node,
    published: &Published,
    was_born: &mut bool,
) -> Result<std::convert::Infallible, End> {
    let (reader, mut writer) = tokio::io::split(stream);
    let mut packets = Packets {
        reader,
        heard: BytesMut::new(),
    };
    write(&mut writer, &[hello(config, credentials, node)]).await?;
    match timeout(CONNECT_WITHIN, packets.next()).await {
        Err(_) => return Err(End::Silent),
        Ok(packet) => match packet? {
            Packet::ConnAck(answer) if answer.code == ConnectReturnCode::Success => {}
            Packet::ConnAck(answer) => return Err(End::Refused(answer.code)),
            _ => return Err(End::Unexpected),
        },
    }
    let mut commands = Subscribe::new(node.commands(), QoS::AtLeastOnce);
    commands.pkid = 1;
    write(&mut writer, &[Packet::Subscribe(commands)]).await?;
    let mut wants_birth = true;
    let (mut heard_at, mut said_at) = (Instant::now(), Instant::now());
    let mut tick = interval(config.interval);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut ping = interval(config.keep_alive / 4);
    ping.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            packet = packets.next() => {
                heard_at = Instant::now();
                match packet? {
                    Packet::Publish(publish) => {
                        // However many ask, there is one birth at the next tick.
                        wants_birth |= node.asks_for_birth(&publish.topic, &publish.payload);
                        if publish.qos == QoS::AtLeastOnce {
                            let taken = rumqttc::PubAck::new(publish.pkid);
                            write(&mut writer, &[Packet::PubAck(taken)]).await?;
                        }
                    }
                    Packet::PingResp | Packet::SubAck(_) => {}
                    _ => return Err(End::Unexpected),
                }
            }
            _ = tick.tick() => {
                let (status, now) = (published.latest(), SystemTime::now());
                let messages = if std::mem::take(&mut wants_birth) {
                    *was_born = true;
                    node.birth(&status, now).to_vec()
                } else {
                    node.data(&status, now)
                };
                if !messages.is_empty() {
                    let packets: Vec<Packet> = messages.into_iter().map(publish).collect();
                    write(&mut writer, &packets).await?;
                    said_at = Instant::now();
                }
            }
            _ = ping.tick() => {
                // A ping is answered, so a broker that lives is heard at least every half.
                if heard_at.elapsed() > config.keep_alive {
                    return Err(End::Silent);
                }
                if heard_at.elapsed() > config.keep_alive / 2 || said_at.elapsed() > config.keep_alive / 2 {
                    write(&mut writer, &[Packet::PingReq]).await?;
                    said_at = Instant::now();
                }
            }
        }
    }
}

/// The first packet, with the death of this life as the will.
fn hello(config: &SparkplugConfig, credentials: &Credentials, node: &Node) -> Packet {
    let death = node.death(SystemTime::now());
    let mut connect = Connect::new(config.client());
    connect.keep_alive = u16::try_from(config.keep_alive.as_secs()).unwrap_or(u16::MAX);
    connect.clean_session = true;
    connect.last_will = Some(LastWill::new(
        death.topic,
        death.payload,
        QoS::AtLeastOnce,
        false,
    ));
    connect.login = credentials
        .login
        .as_ref()
        .map(|(user, password)| Login::new(user, password));
    Packet::Connect(connect)
}

fn publish(message: Message) -> Packet {
    Packet::Publish(Publish::new(
        message.topic,
        QoS::AtMostOnce,
        message.payload,
    ))
}

async fn write(writer: &mut (impl AsyncWrite + Unpin), packets: &[Packet]) -> Result<(), End> {
    let mut bytes = BytesMut::new();
    for packet in packets {
        packet.write(&mut bytes, usize::MAX)?;
    }
    in_time(WRITE_WITHIN, async {
        writer.write_all(&bytes).await?;
        writer.flush().await
    })
    .await
}

/// Packets as they come in.
struct Packets<R> {
    reader: R,
    heard: BytesMut,
}

impl<R: AsyncRead + Unpin> Packets<R> {
    /// The next packet. May be given up and begun again: what was heard is kept.
    async fn next(&mut self) -> Result<Packet, End> {
        loop {
            match Packet::read(&mut self.heard, MAX_PACKET) {
                Ok(packet) => return Ok(packet),
                Err(rumqttc::mqttbytes::Error::InsufficientBytes(_)) => {}
                Err(e) => return Err(e.into()),
            }
            if self.reader.read_buf(&mut self.heard).await? == 0 {
                return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn whatever_a_broker_sends_is_packets_and_then_an_error(
            kind in 0_u8..=255,
            bytes in prop::collection::vec(any::<u8>(), 0..100),
        ) {
            let runtime = tokio::runtime::Builder::new_current_thread().build().expect("a runtime");
            // A first byte and a length that fit, so that more than the head is read.
            let mut sent = vec![kind, u8::try_from(bytes.len()).expect("below 100")];
            sent.extend(&bytes);
            sent.extend(&bytes);
            let mut packets = Packets { reader: &sent[..], heard: BytesMut::new() };
            let mut count = 0;
            while runtime.block_on(packets.next()).is_ok() {
                count += 1;
                prop_assert!(count <= sent.len());
            }
        }
    }
}
