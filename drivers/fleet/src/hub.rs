//! The centre's side of the connection to the server.
//!
//! It creates the buckets and streams, publishes the desired states of machines, detects values that other clients put,
//! and collects the messages of machines in batches. A message stays at the server until its batch is acknowledged.
//!
//! A key-value bucket is a stream whose name starts with `KV_`. Buckets are created as streams, because the client's
//! function for buckets requires information that servers of version 2.9 do not return.

use std::{
    sync::Arc,
    time::{Duration, SystemTime},
};

use async_nats::{
    Client, HeaderMap,
    jetstream::{
        self, AckKind, Context, Message,
        consumer::{AckPolicy, DeliverPolicy, pull},
        object_store, stream,
    },
};
use bytes::Bytes;
use futures_util::stream::BoxStream;
use tokio::{sync::Notify, time::timeout};
use tokio_stream::StreamExt;

use crate::{
    Identity, LinkError, LinkSettings, MachineId, SiteId,
    link::{RESPONSE_TIMEOUT, is_connected, nats_error, stored},
    subjects::{DESIRED_BUCKET, Kind, desired_subject, latest_desired_subject, models_bucket},
};

/// Connection of a centre. Clones share the connection.
#[derive(Clone)]
pub struct Hub {
    client: Client,
    context: Context,
    reconnected: Arc<Notify>,
}

/// Desired state of a machine, as stored under the name of the machine in the NATS key-value bucket `desired`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DesiredValue {
    pub machine: MachineId,
    /// Value of the key; empty if the key was deleted.
    pub value: Bytes,
}

pub enum DesiredEvent {
    /// A value was put, by this centre or by another client.
    Put(DesiredValue),
    /// The connection was established or restored. Values that were put during an interruption are not reported.
    Connected,
}

/// Subscription to the desired states of all machines.
pub struct DesiredWatch {
    puts: async_nats::Subscriber,
    reconnected: Arc<Notify>,
}

impl Hub {
    /// Connects with the nkey of a centre. If the server cannot be reached, retries in the background.
    ///
    /// # Errors
    /// An invalid seed or address.
    pub async fn connect(settings: &LinkSettings) -> Result<Self, LinkError> {
        let reconnected = Arc::new(Notify::new());
        let client = settings
            .options(&reconnected)?
            .name("volcomp-centre")
            .connect(settings.servers())
            .await
            .map_err(nats_error("connecting"))?;
        let mut context = jetstream::new(client.clone());
        context.set_timeout(RESPONSE_TIMEOUT);
        Ok(Self { client, context, reconnected })
    }

    /// JetStream context, for operations that this type does not provide.
    pub fn context(&self) -> &Context {
        &self.context
    }

    pub fn is_connected(&self) -> bool {
        is_connected(&self.client)
    }

    /// Creates the bucket and the streams of these sites; see [`prepare`].
    ///
    /// # Errors
    /// The server does not respond or denies permission.
    pub async fn prepare(
        &self,
        sites: &[SiteId],
        retention: StreamRetention,
    ) -> Result<(), LinkError> {
        prepare(&self.context, sites, retention).await
    }

    /// Puts the desired state of a machine, and waits until it is stored.
    ///
    /// # Errors
    /// The value may or may not have been stored. Put it again.
    pub async fn put_desired(&self, machine: &MachineId, value: Bytes) -> Result<(), LinkError> {
        let subject = desired_subject(machine.as_str());
        let what = "putting a manifest";
        stored(what, &self.context, subject, HeaderMap::new(), value).await
    }

    /// Stored desired state of a machine; `None` if the machine has none.
    ///
    /// # Errors
    /// The server does not respond.
    pub async fn desired(&self, machine: &MachineId) -> Result<Option<Bytes>, LinkError> {
        let subject = latest_desired_subject(machine);
        let answer = timeout(RESPONSE_TIMEOUT, self.client.request(subject, Bytes::new()));
        let message = answer
            .await
            .map_err(|_| LinkError::Late {
                what: "requesting a manifest",
                within: RESPONSE_TIMEOUT,
            })?
            .map_err(nats_error("requesting a manifest"))?;
        // A response with a status contains no message. A deleted value has no bytes.
        Ok((message.status.is_none() && !message.payload.is_empty()).then_some(message.payload))
    }

    /// Puts a model that is too large for its manifest; see [`put_model`].
    ///
    /// # Errors
    /// The server does not respond or denies permission.
    pub async fn put_model(
        &self,
        machine: &MachineId,
        sha256: &str,
        model: &[u8],
        replicas: usize,
    ) -> Result<(), LinkError> {
        put_model(&self.context, machine, sha256, model, replicas).await
    }

    /// Watches the keys of all machines. Use a single watch, because each [`DesiredEvent::Connected`] is received by
    /// one watch only.
    ///
    /// # Errors
    /// The connection is closed.
    pub async fn watch_desired(&self) -> Result<DesiredWatch, LinkError> {
        let puts = self
            .client
            .subscribe(desired_subject("*"))
            .await
            .map_err(nats_error("listening to manifests"))?;
        Ok(DesiredWatch { puts, reconnected: Arc::clone(&self.reconnected) })
    }

    /// Two collections of messages from the machines of a site: the first of conditions and telemetry, the second of
    /// audit records and acknowledgements.
    pub fn collections(&self, site: &SiteId) -> [Collection; 2] {
        streams_of(site).map(|(stream, _)| Collection::new(self.context.clone(), stream))
    }
}

impl DesiredWatch {
    /// Waits for the next event; `None` if the connection is closed permanently. Cancel safe.
    pub async fn next(&mut self) -> Option<DesiredEvent> {
        loop {
            tokio::select! {
                message = self.puts.next() => {
                    let message = message?;
                    let machine = message.subject.as_str().rsplit('.').next().map(str::parse);
                    // Keys that are not machine names are ignored.
                    if let Some(Ok(machine)) = machine {
                        return Some(DesiredEvent::Put(DesiredValue { machine, value: message.payload }));
                    }
                }
                () = self.reconnected.notified() => return Some(DesiredEvent::Connected),
            }
        }
    }
}

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
    fn new(context: Context, stream: String) -> Self {
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
                // The stream is kept only after a batch with messages. After an empty batch, which means a failed or
                // ended stream, the next call subscribes again.
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

/// Prefix of the name of a site's stream of conditions and telemetry.
const TELEMETRY_PREFIX: &str = "telemetry-";
/// Prefix of the name of a site's stream of audit records and acknowledgements.
const AUDIT_PREFIX: &str = "audit-";
const HISTORY: i64 = 8;
/// Deduplication window: of messages with the same id within this time, the server stores one.
const DUPLICATE_WINDOW: Duration = Duration::from_secs(120);

/// Retention limits of the streams, by age and size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamRetention {
    /// Number of servers of the cluster that store each stream: 1, 3 or 5.
    pub replicas: usize,
    pub telemetry: Duration,
    /// Maximum size of a site's two streams together, bytes. The stream of conditions and telemetry gets three quarters
    /// and removes its oldest messages. The stream of audit records and acknowledgements gets a quarter and refuses new
    /// messages, because the centre may not have collected the old ones. Refused messages wait at their gateways.
    pub site_bytes: i64,
    pub audit: Duration,
}

impl Default for StreamRetention {
    /// One server; telemetry for 7 days, audit records for 366 days, at most 4 GiB per site.
    fn default() -> Self {
        const DAY: Duration = Duration::from_secs(86_400);
        Self { replicas: 1, telemetry: 7 * DAY, site_bytes: 4 << 30, audit: 366 * DAY }
    }
}

/// Names and subjects of the two streams of a site: telemetry, then audit.
fn streams_of(site: &SiteId) -> [(String, Vec<String>); 2] {
    let of =
        |kinds: [Kind; 2]| kinds.map(|kind| format!("volcomp.{site}.*.{}", kind.name())).to_vec();
    [
        (format!("{TELEMETRY_PREFIX}{site}"), of([Kind::Condition, Kind::Telemetry])),
        (format!("{AUDIT_PREFIX}{site}"), of([Kind::Audit, Kind::Ack])),
    ]
}

/// Creates the bucket of desired states and the streams of these sites. Existing streams are updated to these settings.
///
/// # Errors
/// The server does not respond or denies permission.
pub async fn prepare(
    context: &Context,
    sites: &[SiteId],
    retention: StreamRetention,
) -> Result<(), LinkError> {
    let desired = stream::Config {
        name: format!("KV_{DESIRED_BUCKET}"),
        subjects: vec![desired_subject(">")],
        max_messages_per_subject: HISTORY,
        max_messages: -1,
        max_bytes: -1,
        max_consumers: -1,
        discard: stream::DiscardPolicy::New,
        allow_rollup: true,
        deny_delete: true,
        allow_direct: true,
        num_replicas: retention.replicas,
        ..Default::default()
    };
    create(context, desired).await?;
    for site in sites {
        let audit_bytes = retention.site_bytes / 4;
        for (name, subjects) in streams_of(site) {
            let is_audit = name.starts_with(AUDIT_PREFIX);
            let config = stream::Config {
                name,
                subjects,
                max_messages: -1,
                max_consumers: -1,
                max_bytes: if is_audit { audit_bytes } else { retention.site_bytes - audit_bytes },
                discard: if is_audit {
                    stream::DiscardPolicy::New
                } else {
                    stream::DiscardPolicy::Old
                },
                max_age: if is_audit { retention.audit } else { retention.telemetry },
                duplicate_window: DUPLICATE_WINDOW,
                num_replicas: retention.replicas,
                deny_delete: is_audit,
                deny_purge: is_audit,
                ..Default::default()
            };
            create(context, config).await?;
        }
    }
    Ok(())
}

async fn create(context: &Context, config: stream::Config) -> Result<(), LinkError> {
    let made = context.create_or_update_stream(config).await;
    made.map(|_| ()).map_err(nats_error("making a stream"))
}

/// Puts a model that is too large for its manifest into a machine's object store under its checksum.
///
/// # Errors
/// The server does not respond or denies permission.
pub async fn put_model(
    context: &Context,
    machine: &MachineId,
    sha256: &str,
    model: &[u8],
    replicas: usize,
) -> Result<(), LinkError> {
    let bucket = models_bucket(machine);
    let store = match context.get_object_store(&bucket).await {
        Ok(store) => store,
        Err(_) => context
            .create_object_store(object_store::Config {
                bucket,
                num_replicas: replicas,
                ..Default::default()
            })
            .await
            .map_err(nats_error("making an object store"))?,
    };
    let mut bytes = model;
    store.put(sha256, &mut bytes).await.map(|_| ()).map_err(nats_error("storing a model"))
}
