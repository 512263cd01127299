//! Collects machine messages from a stream in batches. A message stays at the server until its batch is acknowledged.

use std::time::{Duration, SystemTime};

use async_nats::jetstream::{
    AckKind, Context, Message,
    consumer::{AckPolicy, DeliverPolicy, pull},
};
use bytes::Bytes;
use futures_util::stream::BoxStream;
use tokio_stream::StreamExt;

use crate::{Identity, Kind, LinkError, link::nats_error};

/// Name of the centre's durable consumer in each stream.
const CONSUMER: &str = "centre";
const REDELIVERY_INTERVAL: Duration = Duration::from_secs(30);
const MAX_UNACKNOWLEDGED: i64 = 20_000;
const MAX_BATCH: usize = 2_000;
/// Time for which a batch waits for more messages after its first message. Batches are collected because each costs one
/// disk write.
const GATHER_TIME: Duration = Duration::from_millis(20);
const RETRY_INTERVAL: Duration = Duration::from_millis(500);

/// A machine message as stored in the stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// Sender of the message. The server has checked that this machine may publish on the subject.
    pub identity: Identity,
    pub kind: Kind,
    pub sequence: u64,
    /// Time at which the stream stored the message, in seconds since 1970 by the server's clock.
    pub stored_s: f64,
    pub bytes: Bytes,
}

/// Messages that were received together.
pub struct Batch {
    pub messages: Vec<Received>,
    unacknowledged: Vec<Message>,
}

impl Batch {
    /// Acknowledges to the server that the messages are stored permanently. If the acknowledgement is lost, the server
    /// redelivers the messages.
    ///
    /// # Errors
    /// The connection is closed.
    pub async fn acknowledge(self) -> Result<(), LinkError> {
        for message in self.unacknowledged {
            message.ack().await.map_err(nats_error("acknowledging"))?;
        }
        Ok(())
    }
}

type Messages = BoxStream<'static, Vec<Result<Message, LinkError>>>;

/// Receives the messages of one stream, starting after the last acknowledged message.
pub struct Collection {
    context: Context,
    stream: String,
    again_after: Duration,
    messages: Option<Messages>,
}

impl Collection {
    pub(crate) fn new(context: Context, stream: String) -> Self {
        Self { context, stream, again_after: REDELIVERY_INTERVAL, messages: None }
    }

    /// Sets the redelivery interval for messages that are not acknowledged [default: 30 s].
    #[must_use]
    pub fn again_after(mut self, time: Duration) -> Self {
        self.again_after = time;
        self
    }

    pub fn stream(&self) -> &str {
        &self.stream
    }

    /// Receives the next batch. Waits for a first message and then collects further messages for 20 ms, at most 2000.
    /// Returns an error while the server cannot be reached; call again to retry.
    ///
    /// # Errors
    /// The reason why the subscription had to be restarted: log it, and call again.
    pub async fn next(&mut self) -> Result<Batch, LinkError> {
        let next = match self.messages.take() {
            Some(messages) => Ok(messages),
            None => subscribe(&self.context, &self.stream, self.again_after).await,
        };
        let mut messages = match next {
            Ok(messages) => messages,
            Err(error) => {
                tokio::time::sleep(RETRY_INTERVAL).await;
                return Err(error);
            }
        };
        let mut batch = Batch { messages: Vec::new(), unacknowledged: Vec::new() };
        let mut failure = None;
        for message in messages.next().await.unwrap_or_default() {
            match message {
                Ok(message) => match received(&message) {
                    Some(received) => {
                        batch.messages.push(received);
                        batch.unacknowledged.push(message);
                    }
                    // No machine may publish on this subject, so the server must not redeliver the message.
                    None => {
                        let _ = message.ack_with(AckKind::Term).await;
                    }
                },
                Err(error) => failure = Some(error),
            }
        }
        match failure {
            // Messages received before the failure are returned. The server will redeliver messages in flight.
            Some(error) if batch.messages.is_empty() => {
                tokio::time::sleep(RETRY_INTERVAL).await;
                Err(error)
            }
            Some(_) => Ok(batch),
            None => {
                // After a failed or ended message stream the next call subscribes again.
                if !batch.messages.is_empty() {
                    self.messages = Some(messages);
                }
                Ok(batch)
            }
        }
    }
}

async fn subscribe(
    context: &Context,
    stream: &str,
    again_after: Duration,
) -> Result<Messages, LinkError> {
    let consumer = context
        .create_consumer_on_stream(
            pull::Config {
                durable_name: Some(CONSUMER.to_owned()),
                ack_policy: AckPolicy::Explicit,
                ack_wait: again_after,
                deliver_policy: DeliverPolicy::All,
                max_ack_pending: MAX_UNACKNOWLEDGED,
                max_deliver: -1,
                ..Default::default()
            },
            stream,
        )
        .await
        .map_err(nats_error("making a consumer"))?;
    let messages = consumer
        .stream()
        .max_messages_per_batch(MAX_BATCH)
        .heartbeat(Duration::from_secs(5))
        .expires(Duration::from_secs(30))
        .messages()
        .await
        .map_err(nats_error("collecting"))?;
    let messages = messages.map(|message| message.map_err(nats_error("collecting")));
    Ok(Box::pin(messages.chunks_timeout(MAX_BATCH, GATHER_TIME)))
}

fn received(message: &Message) -> Option<Received> {
    let mut parts = message.subject.as_str().split('.').skip(1);
    let (site, machine, kind) = (parts.next()?, parts.next()?, parts.next()?);
    let info = message.info().ok()?;
    Some(Received {
        identity: Identity { site: site.parse().ok()?, machine: machine.parse().ok()? },
        kind: Kind::with_name(kind)?,
        sequence: info.stream_sequence,
        stored_s: since_1970_s(info.published.into()),
        bytes: message.payload.clone(),
    })
}

fn since_1970_s(at: SystemTime) -> f64 {
    at.duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}
