//! What machines have said, taken from a stream in batches. A message stays at the server until its batch is acknowledged.

use std::time::{Duration, SystemTime};

use async_nats::jetstream::{
    AckKind, Context, Message,
    consumer::{AckPolicy, DeliverPolicy, pull},
};
use bytes::Bytes;
use futures_util::stream::BoxStream;
use tokio_stream::StreamExt;

use crate::{Identity, Kind, LinkError, link::failed};

/// The name of the centre's place in each stream.
const CONSUMER: &str = "centre";
/// What is not acknowledged after so long is sent again.
const AGAIN_AFTER: Duration = Duration::from_secs(30);
/// So many messages are under way at the most, from the server to the disk of the centre.
const UNDER_WAY: i64 = 20_000;
/// So many messages make a batch at the most.
const BATCH: usize = 2_000;
/// So long a batch waits for more messages after its first: what stores them writes to a disk once for each batch.
const GATHERED_FOR: Duration = Duration::from_millis(20);
/// After a failure the next try comes so much later.
const PAUSE: Duration = Duration::from_millis(500);

/// A message of a machine as the stream has it.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// Who sent it: the server has checked that the subject is its own.
    pub identity: Identity,
    pub kind: Kind,
    pub sequence: u64,
    /// When the stream stored it, seconds since 1970 by the clock of the server.
    pub stored_s: f64,
    pub bytes: Bytes,
}

/// Messages that came together.
pub struct Batch {
    /// The messages in the order in which they came.
    pub messages: Vec<Received>,
    taken: Vec<Message>,
}

impl Batch {
    /// Tells the server that the messages are stored for good. Where that is lost they come again.
    ///
    /// # Errors
    /// The connection is closed.
    pub async fn acknowledge(self) -> Result<(), LinkError> {
        for message in self.taken {
            message.ack().await.map_err(failed("acknowledging"))?;
        }
        Ok(())
    }
}

type Messages = BoxStream<'static, Vec<Result<Message, LinkError>>>;

/// Takes the messages of one stream, from where the last one that was acknowledged stands.
pub struct Collection {
    context: Context,
    stream: String,
    again_after: Duration,
    messages: Option<Messages>,
}

impl Collection {
    pub(crate) fn new(context: Context, stream: String) -> Self {
        Self {
            context,
            stream,
            again_after: AGAIN_AFTER,
            messages: None,
        }
    }

    /// The same, where what is not acknowledged comes again after this time; without it after 30 s.
    #[must_use]
    pub fn again_after(mut self, time: Duration) -> Self {
        self.again_after = time;
        self
    }

    pub fn stream(&self) -> &str {
        &self.stream
    }

    /// The next messages: waits for the first, and gathers what comes within 20 ms of it, 2000 at the most. Where the server is not reached it goes on trying.
    ///
    /// # Errors
    /// Why it had to begin anew just now: to be logged, and to be called again.
    pub async fn next(&mut self) -> Result<Batch, LinkError> {
        let next = match self.messages.take() {
            Some(messages) => Ok(messages),
            None => begin(&self.context, &self.stream, self.again_after).await,
        };
        let mut messages = match next {
            Ok(messages) => messages,
            Err(error) => {
                tokio::time::sleep(PAUSE).await;
                return Err(error);
            }
        };
        let mut batch = Batch {
            messages: Vec::new(),
            taken: Vec::new(),
        };
        let mut failure = None;
        for message in messages.next().await.unwrap_or_default() {
            match message {
                Ok(message) => match received(&message) {
                    Some(received) => {
                        batch.messages.push(received);
                        batch.taken.push(message);
                    }
                    // On a subject that no machine may publish on: nobody's, and never to come again.
                    None => {
                        let _ = message.ack_with(AckKind::Term).await;
                    }
                },
                Err(error) => failure = Some(error),
            }
        }
        match failure {
            // What came before the failure is whole. Whatever was under way comes again.
            Some(error) if batch.messages.is_empty() => {
                tokio::time::sleep(PAUSE).await;
                Err(error)
            }
            Some(_) => Ok(batch),
            None => {
                // A stream of messages that has ended begins anew.
                if !batch.messages.is_empty() {
                    self.messages = Some(messages);
                }
                Ok(batch)
            }
        }
    }
}

async fn begin(
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
                max_ack_pending: UNDER_WAY,
                max_deliver: -1,
                ..Default::default()
            },
            stream,
        )
        .await
        .map_err(failed("making a consumer"))?;
    let messages = consumer
        .stream()
        .max_messages_per_batch(BATCH)
        .heartbeat(Duration::from_secs(5))
        .expires(Duration::from_secs(30))
        .messages()
        .await
        .map_err(failed("collecting"))?;
    let messages = messages.map(|message| message.map_err(failed("collecting")));
    Ok(Box::pin(messages.chunks_timeout(BATCH, GATHERED_FOR)))
}

fn received(message: &Message) -> Option<Received> {
    let mut parts = message.subject.as_str().split('.').skip(1);
    let (site, machine, kind) = (parts.next()?, parts.next()?, parts.next()?);
    let info = message.info().ok()?;
    Some(Received {
        identity: Identity {
            site: site.parse().ok()?,
            machine: machine.parse().ok()?,
        },
        kind: Kind::with_name(kind)?,
        sequence: info.stream_sequence,
        stored_s: since_1970_s(info.published.into()),
        bytes: message.payload.clone(),
    })
}

/// Seconds since 1970.
fn since_1970_s(at: SystemTime) -> f64 {
    at.duration_since(SystemTime::UNIX_EPOCH)
        .map_or(0.0, |since| since.as_secs_f64())
}
