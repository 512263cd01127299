//! The machine's side of the connection.
//!
//! A machine requests the value of its key and subscribes to changes of that key. It uses no consumer and no watch, so
//! the server keeps no state for the machine.

use std::{fmt, sync::Arc, time::Duration};

use async_nats::{
    Client, ConnectOptions, HeaderMap, Subscriber,
    jetstream::{self, Context},
};
use bytes::Bytes;
use futures_util::StreamExt;
use serde::Deserialize;
use sha2::{Digest, Sha256};
use tokio::{sync::Notify, time::timeout};

use crate::{
    Identity, Kind, ModelRef, Subjects,
    subjects::{latest_desired_subject, models_bucket},
};

/// Interval at which the value is requested, because the notification of a change may be lost.
const REQUEST_INTERVAL: Duration = Duration::from_secs(60);
pub(crate) const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
const MAX_MODEL_BYTES: u64 = 4 << 20;
const MAX_RECONNECT_DELAY: Duration = Duration::from_secs(10);
/// Maximum number of queued values. Further values are dropped; the request every `REQUEST_INTERVAL` fetches the
/// latest.
const MAX_QUEUED_VALUES: usize = 8;

/// Errors of the connection. The operation may be retried after every error except `Seed`.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The seed of the user's nkey is invalid.
    #[error("the nkey: expected the seed of a user, SU and 56 letters and digits")]
    Seed,
    /// The server cannot be reached, rejects the request, or does not respond in time.
    #[error("{what}: {source}")]
    Nats { what: &'static str, source: Box<dyn std::error::Error + Send + Sync> },
    #[error("{what}: no answer within {within:?}")]
    Late { what: &'static str, within: Duration },
    /// The object store lacks the model, or contains another model under its name.
    #[error("the model {sha256} in the object store: {found}")]
    Model { sha256: String, found: String },
}

pub(crate) fn nats_error<E: Into<Box<dyn std::error::Error + Send + Sync>>>(
    what: &'static str,
) -> impl FnOnce(E) -> LinkError {
    move |source| LinkError::Nats { what, source: source.into() }
}

#[derive(Clone)]
pub struct LinkSettings {
    /// Server addresses, `nats://HOST:PORT` or `tls://HOST:PORT`, separated by commas.
    pub url: String,
    /// Seed of the user's nkey. It appears neither in messages nor in `Debug`.
    pub seed: String,
    /// PEM file with certificates that are trusted in addition to those of the system.
    pub roots: Option<std::path::PathBuf>,
}

impl fmt::Debug for LinkSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LinkSettings")
            .field("url", &self.url)
            .field("roots", &self.roots)
            .finish_non_exhaustive()
    }
}

impl LinkSettings {
    /// Validates the seed without connecting, and returns its public key, by which the server identifies the user.
    ///
    /// # Errors
    /// The seed is invalid.
    pub fn public_key(&self) -> Result<String, LinkError> {
        let user = nkeys::KeyPair::from_seed(&self.seed).map_err(|_| LinkError::Seed)?;
        let key = user.public_key();
        if key.starts_with('U') { Ok(key) } else { Err(LinkError::Seed) }
    }

    pub(crate) fn options(&self, reconnected: &Arc<Notify>) -> Result<ConnectOptions, LinkError> {
        self.public_key()?;
        let reconnected = Arc::clone(reconnected);
        let mut options = ConnectOptions::with_nkey(self.seed.clone())
            .retry_on_initial_connect()
            .max_reconnects(None)
            .reconnect_delay_callback(|tries| {
                let tries = u32::try_from(tries.min(8)).unwrap_or(8);
                (Duration::from_millis(50) * 2_u32.pow(tries)).min(MAX_RECONNECT_DELAY)
            })
            .ping_interval(Duration::from_secs(10))
            .event_callback(move |event| {
                if matches!(event, async_nats::Event::Connected) {
                    reconnected.notify_one();
                }
                async {}
            });
        if let Some(roots) = &self.roots {
            options = options.add_root_certificates(roots.clone());
        }
        Ok(options)
    }

    pub(crate) fn servers(&self) -> Vec<String> {
        crate::addresses(&self.url).filter(|one| !one.is_empty()).map(str::to_owned).collect()
    }
}

/// Publishes and fetches over the connection of a machine. Clones share the connection.
#[derive(Clone)]
pub struct MachineSender {
    client: Client,
    context: Context,
    subjects: Subjects,
    /// Subject on which the latest value of the machine's key is requested.
    latest_desired: String,
    models: String,
}

pub struct MachineLink {
    sender: MachineSender,
    desired: Subscriber,
    /// Notified after every connection and reconnection, because values published while disconnected were not received.
    reconnected: Arc<Notify>,
    request_timer: tokio::time::Interval,
    /// Whether the value must be requested, because no request was sent yet or the last request was not answered.
    due: bool,
    /// SHA-256 of the value that was returned last; `None` before the first value.
    last: Option<[u8; 32]>,
}

impl MachineLink {
    /// Connects to the server. If the server cannot be reached, retries in the background.
    ///
    /// # Errors
    /// An invalid seed or address.
    pub async fn connect(settings: &LinkSettings, identity: &Identity) -> Result<Self, LinkError> {
        let reconnected = Arc::new(Notify::new());
        let subjects = Subjects::of(identity);
        let options = settings
            .options(&reconnected)?
            .name(identity.machine.as_str())
            .custom_inbox_prefix(&subjects.inbox)
            .subscription_capacity(MAX_QUEUED_VALUES);
        let client = options.connect(settings.servers()).await.map_err(nats_error("connecting"))?;
        let desired =
            client.subscribe(subjects.desired.clone()).await.map_err(nats_error("subscribing"))?;
        let mut request_timer = tokio::time::interval_at(
            tokio::time::Instant::now() + REQUEST_INTERVAL,
            REQUEST_INTERVAL,
        );
        request_timer.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        Ok(Self {
            request_timer,
            due: true,
            sender: MachineSender {
                context: jetstream::new(client.clone()),
                client,
                subjects,
                latest_desired: latest_desired_subject(&identity.machine),
                models: models_bucket(&identity.machine),
            },
            desired,
            reconnected,
            last: None,
        })
    }

    /// Returns a handle that publishes and fetches over this connection while another task waits for values.
    pub fn sender(&self) -> MachineSender {
        self.sender.clone()
    }

    /// Returns the value of this machine's key once after the start and once after each change. Cancel safe: a
    /// cancelled call sends nothing to the server.
    pub async fn next_desired(&mut self) -> Bytes {
        loop {
            // A change received while a response is pending is returned by the next call. If an older value arrives
            // after a newer value, the versions of their manifests show it.
            let value = if self.due {
                let answer = self.sender.request_value().await;
                self.due = false;
                answer
            } else {
                tokio::select! {
                    received = self.desired.next() => match received {
                        Some(message) => Some(message.payload),
                        None => std::future::pending().await,
                    },
                    () = self.reconnected.notified() => { self.due = true; None }
                    _ = self.request_timer.tick() => { self.due = true; None }
                }
            };
            if let Some(value) = value.filter(|value| !value.is_empty()) {
                let checksum: [u8; 32] = Sha256::digest(&value).into();
                if self.last.replace(checksum) != Some(checksum) {
                    return value;
                }
            }
        }
    }

    /// Same as [`MachineSender::fetch_model`].
    ///
    /// # Errors
    /// The server does not answer, or has no such model.
    pub async fn fetch_model(&self, model: &ModelRef) -> Result<String, LinkError> {
        self.sender.fetch_model(model).await
    }

    /// Same as [`MachineSender::publish`].
    ///
    /// # Errors
    /// The message may or may not have been stored. Send it again later with the same `id`.
    pub async fn publish(&self, kind: Kind, id: &str, bytes: Bytes) -> Result<(), LinkError> {
        self.sender.publish(kind, id, bytes).await
    }

    pub fn is_connected(&self) -> bool {
        self.sender.is_connected()
    }
}

impl MachineSender {
    /// Requests the present value of the machine's key. Returns `None` if there is no value, or if the request timed
    /// out and must be repeated.
    async fn request_value(&self) -> Option<Bytes> {
        let request = self.client.request(self.latest_desired.clone(), Bytes::new());
        let answer = timeout(RESPONSE_TIMEOUT, request).await;
        let message = answer.ok()?.ok()?;
        message.status.is_none().then_some(message.payload)
    }

    /// Fetches a model that is too large for its manifest, and verifies its checksum.
    ///
    /// # Errors
    /// The server does not respond, or has no such model.
    pub async fn fetch_model(&self, model: &ModelRef) -> Result<String, LinkError> {
        let wrong = |found: &str| LinkError::Model {
            sha256: model.sha256.clone(),
            found: found.to_owned(),
        };
        if model.bytes > MAX_MODEL_BYTES {
            return Err(wrong("larger than 4 MiB"));
        }
        // Direct requests are used, because a machine that may create consumers could send messages to any subject.
        let stream = self
            .context
            .get_stream_no_info(format!("OBJ_{}", self.models))
            .await
            .map_err(nats_error("the object store"))?;
        let name = encoded(&model.sha256);
        let meta = stream
            .direct_get_last_for_subject(format!("$O.{}.M.{name}", self.models))
            .await
            .map_err(nats_error("the object store"))?;
        let meta: ObjectMeta =
            serde_json::from_slice(&meta.payload).map_err(|_| wrong("not described"))?;
        let chunks = format!("$O.{}.C.{}", self.models, meta.nuid);
        let mut bytes = Vec::new();
        let mut after = None;
        for _ in 0..meta.chunks {
            let chunk = stream
                .direct_get_next_for_subject(chunks.clone(), after)
                .await
                .map_err(nats_error("the object store"))?;
            after = Some(chunk.sequence + 1);
            bytes.extend_from_slice(&chunk.payload);
            if bytes.len() as u64 > model.bytes {
                return Err(wrong("longer than stated in its manifest"));
            }
        }
        if !model.is(&bytes) {
            return Err(wrong("its checksum differs"));
        }
        String::from_utf8(bytes).map_err(|_| wrong("it is no text"))
    }

    /// Publishes a message and waits until the stream has stored it. The stream stores messages with the same `id`
    /// once.
    ///
    /// # Errors
    /// The message may or may not have been stored. Send it again later with the same `id`.
    pub async fn publish(&self, kind: Kind, id: &str, bytes: Bytes) -> Result<(), LinkError> {
        let mut headers = HeaderMap::new();
        headers.insert("Nats-Msg-Id", id);
        let subject = self.subjects.of_kind(kind).to_owned();
        stored("publishing", &self.context, subject, headers, bytes).await
    }

    pub fn is_connected(&self) -> bool {
        is_connected(&self.client)
    }
}

pub(crate) fn is_connected(client: &Client) -> bool {
    client.connection_state() == async_nats::connection::State::Connected
}

/// Publishes a message and waits at most `RESPONSE_TIMEOUT` until the stream has stored it. `what` names the operation
/// in error messages.
pub(crate) async fn stored(
    what: &'static str,
    context: &Context,
    subject: String,
    headers: HeaderMap,
    bytes: Bytes,
) -> Result<(), LinkError> {
    let stored = async {
        let published = context.publish_with_headers(subject, headers, bytes).await;
        let answered = published.map_err(nats_error(what))?;
        answered.await.map_err(nats_error(what)).map(|_| ())
    };
    let late = LinkError::Late { what, within: RESPONSE_TIMEOUT };
    timeout(RESPONSE_TIMEOUT, stored).await.unwrap_or(Err(late))
}

#[derive(Deserialize)]
struct ObjectMeta {
    nuid: String,
    chunks: u32,
}

/// Encodes the name of an object for use in a subject.
fn encoded(name: &str) -> String {
    use base64::Engine;
    base64::engine::general_purpose::URL_SAFE.encode(name)
}
