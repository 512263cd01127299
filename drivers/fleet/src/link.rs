//! The machine's side of the connection.
//!
//! A machine asks for one value of one key and hears it when it changes: no consumer, no watch, nothing at the server that
//! has to be kept for it.

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

/// The value is asked for so often, even where nothing was heard of a change.
const ASK_EVERY: Duration = Duration::from_secs(60);
/// A question is answered after so long, or not at all.
pub(crate) const ANSWER_WITHIN: Duration = Duration::from_secs(5);
/// The largest model that is fetched, bytes.
const LARGEST_MODEL: u64 = 4 << 20;
/// The longest pause between two tries to connect.
const LONGEST_PAUSE: Duration = Duration::from_secs(10);
/// So many values wait to be looked at; where more come the latest is asked for later.
const VALUES_WAITING: usize = 8;

/// Why something did not get through. Trying again later is right in each case but for `Seed`.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The seed of the user's nkey is none.
    #[error("the nkey: expected the seed of a user, SU and 56 letters and digits")]
    Seed,
    /// The server is not reached, refuses, or does not answer in time.
    #[error("{what}: {source}")]
    Nats {
        what: &'static str,
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    #[error("{what}: no answer within {within:?}")]
    Late {
        what: &'static str,
        within: Duration,
    },
    /// The object store holds no such model, or another one under its name.
    #[error("the model {sha256} in the object store: {found}")]
    Model { sha256: String, found: String },
}

pub(crate) fn failed<E: Into<Box<dyn std::error::Error + Send + Sync>>>(
    what: &'static str,
) -> impl FnOnce(E) -> LinkError {
    move |source| LinkError::Nats {
        what,
        source: source.into(),
    }
}

/// How to reach the server.
#[derive(Clone)]
pub struct LinkSettings {
    /// The addresses of the servers, `nats://HOST:PORT` or `tls://HOST:PORT`, separated by commas.
    pub url: String,
    /// The seed of the nkey of the user, which no message and no `Debug` shows.
    pub seed: String,
    /// A file with certificates that are trusted besides those of the system, PEM.
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
    /// Whether the seed is one, without connecting; and the public key that belongs to it, by which the server knows the user.
    ///
    /// # Errors
    /// It is none.
    pub fn public_key(&self) -> Result<String, LinkError> {
        let user = nkeys::KeyPair::from_seed(&self.seed).map_err(|_| LinkError::Seed)?;
        let key = user.public_key();
        if key.starts_with('U') {
            Ok(key)
        } else {
            Err(LinkError::Seed)
        }
    }

    /// Options of a connection that is tried again for ever.
    pub(crate) fn options(&self, again: &Arc<Notify>) -> Result<ConnectOptions, LinkError> {
        self.public_key()?;
        let again = Arc::clone(again);
        let mut options = ConnectOptions::with_nkey(self.seed.clone())
            .retry_on_initial_connect()
            .max_reconnects(None)
            .reconnect_delay_callback(|tries| {
                let tries = u32::try_from(tries.min(8)).unwrap_or(8);
                (Duration::from_millis(50) * 2_u32.pow(tries)).min(LONGEST_PAUSE)
            })
            .ping_interval(Duration::from_secs(10))
            .event_callback(move |event| {
                if matches!(event, async_nats::Event::Connected) {
                    again.notify_one();
                }
                async {}
            });
        if let Some(roots) = &self.roots {
            options = options.add_root_certificates(roots.clone());
        }
        Ok(options)
    }

    pub(crate) fn servers(&self) -> Vec<String> {
        crate::addresses(&self.url)
            .filter(|one| !one.is_empty())
            .map(str::to_owned)
            .collect()
    }
}

/// What a machine sends and fetches over its connection. Copies share the connection.
#[derive(Clone)]
pub struct MachineSender {
    client: Client,
    context: Context,
    subjects: Subjects,
    /// The subject of the question for the latest value of the machine's key.
    latest_desired: String,
    /// The object store of the machine.
    models: String,
}

/// The connection of one machine.
pub struct MachineLink {
    sender: MachineSender,
    desired: Subscriber,
    /// Tells that the connection is there (again): what was said meanwhile has not been heard.
    again: Arc<Notify>,
    /// Tells that the value is to be asked for without any other cause.
    ask_every: tokio::time::Interval,
    /// The value is to be asked for, and no answer has come yet.
    due: bool,
    /// The checksum of the value that was given last.
    last: Option<[u8; 32]>,
}

impl MachineLink {
    /// Connects. Where the server is not there it goes on trying in the background.
    ///
    /// # Errors
    /// A seed or an address that is none.
    pub async fn connect(settings: &LinkSettings, identity: &Identity) -> Result<Self, LinkError> {
        let again = Arc::new(Notify::new());
        let subjects = Subjects::of(identity);
        let options = settings
            .options(&again)?
            .name(identity.machine.as_str())
            .custom_inbox_prefix(&subjects.inbox)
            .subscription_capacity(VALUES_WAITING);
        let client = options
            .connect(settings.servers())
            .await
            .map_err(failed("connecting"))?;
        let desired = client
            .subscribe(subjects.desired.clone())
            .await
            .map_err(failed("subscribing"))?;
        let mut ask_every =
            tokio::time::interval_at(tokio::time::Instant::now() + ASK_EVERY, ASK_EVERY);
        ask_every.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        Ok(Self {
            ask_every,
            due: true,
            sender: MachineSender {
                context: jetstream::new(client.clone()),
                client,
                subjects,
                latest_desired: latest_desired_subject(&identity.machine),
                models: models_bucket(&identity.machine),
            },
            desired,
            again,
            last: None,
        })
    }

    /// What sends and fetches over this connection, beside whoever waits for values.
    pub fn sender(&self) -> MachineSender {
        self.sender.clone()
    }

    /// The next value of the key of this machine, once for each change and once after the start. Waits for it; giving up
    /// waiting loses nothing and asks the server nothing.
    pub async fn next_desired(&mut self) -> Bytes {
        loop {
            // A change that is heard while the answer is under way is given next time. Should an older value come after a
            // newer one, its version tells.
            let value = if self.due {
                let answer = self.sender.ask().await;
                self.due = false;
                answer
            } else {
                tokio::select! {
                    heard = self.desired.next() => match heard {
                        Some(message) => Some(message.payload),
                        None => std::future::pending().await,
                    },
                    () = self.again.notified() => { self.due = true; None }
                    _ = self.ask_every.tick() => { self.due = true; None }
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

    /// As [`MachineSender::fetch_model`].
    ///
    /// # Errors
    /// The server does not answer, or has no such model.
    pub async fn fetch_model(&self, model: &ModelRef) -> Result<String, LinkError> {
        self.sender.fetch_model(model).await
    }

    /// As [`MachineSender::publish`].
    ///
    /// # Errors
    /// It is not known whether it was stored: send it again later with the same `id`.
    pub async fn publish(&self, kind: Kind, id: &str, bytes: Bytes) -> Result<(), LinkError> {
        self.sender.publish(kind, id, bytes).await
    }

    /// Whether the server is connected now.
    pub fn is_connected(&self) -> bool {
        self.sender.is_connected()
    }
}

impl MachineSender {
    /// The value now; `None` where there is none or nobody answers, which is asked again later.
    async fn ask(&self) -> Option<Bytes> {
        let asked = self
            .client
            .request(self.latest_desired.clone(), Bytes::new());
        let answer = timeout(ANSWER_WITHIN, asked).await;
        let message = answer.ok()?.ok()?;
        message.status.is_none().then_some(message.payload)
    }

    /// Fetches a model that is too large for its manifest. Its checksum is compared here.
    ///
    /// # Errors
    /// The server does not answer, or has no such model.
    pub async fn fetch_model(&self, model: &ModelRef) -> Result<String, LinkError> {
        let wrong = |found: &str| LinkError::Model {
            sha256: model.sha256.clone(),
            found: found.to_owned(),
        };
        if model.bytes > LARGEST_MODEL {
            return Err(wrong("larger than 4 MiB"));
        }
        // By direct questions: consumers of its own would let a machine have messages sent to any subject.
        let stream = self
            .context
            .get_stream_no_info(format!("OBJ_{}", self.models))
            .await
            .map_err(failed("the object store"))?;
        let name = encoded(&model.sha256);
        let meta = stream
            .direct_get_last_for_subject(format!("$O.{}.M.{name}", self.models))
            .await
            .map_err(failed("the object store"))?;
        let meta: ObjectMeta =
            serde_json::from_slice(&meta.payload).map_err(|_| wrong("not described"))?;
        let chunks = format!("$O.{}.C.{}", self.models, meta.nuid);
        let mut bytes = Vec::new();
        let mut after = None;
        for _ in 0..meta.chunks {
            let chunk = stream
                .direct_get_next_for_subject(chunks.clone(), after)
                .await
                .map_err(failed("the object store"))?;
            after = Some(chunk.sequence + 1);
            bytes.extend_from_slice(&chunk.payload);
            if bytes.len() as u64 > model.bytes {
                return Err(wrong("longer than its manifest says"));
            }
        }
        if !model.is(&bytes) {
            return Err(wrong("its checksum is another one"));
        }
        String::from_utf8(bytes).map_err(|_| wrong("it is no text"))
    }

    /// Sends a message and waits until the stream has stored it. The same `id` twice is stored once.
    ///
    /// # Errors
    /// It is not known whether it was stored: send it again later with the same `id`.
    pub async fn publish(&self, kind: Kind, id: &str, bytes: Bytes) -> Result<(), LinkError> {
        let mut headers = HeaderMap::new();
        headers.insert("Nats-Msg-Id", id);
        let subject = self.subjects.of_kind(kind).to_owned();
        stored("publishing", &self.context, subject, headers, bytes).await
    }

    /// Whether the server is connected now.
    pub fn is_connected(&self) -> bool {
        is_connected(&self.client)
    }
}

/// Whether a client is connected now.
pub(crate) fn is_connected(client: &Client) -> bool {
    client.connection_state() == async_nats::connection::State::Connected
}

/// Publishes, and waits until the stream has stored it, but no longer than [`ANSWER_WITHIN`]. `what` is tried, for messages.
pub(crate) async fn stored(
    what: &'static str,
    context: &Context,
    subject: String,
    headers: HeaderMap,
    bytes: Bytes,
) -> Result<(), LinkError> {
    let stored = async {
        let published = context.publish_with_headers(subject, headers, bytes).await;
        let answered = published.map_err(failed(what))?;
        answered.await.map_err(failed(what)).map(|_| ())
    };
    let late = LinkError::Late {
        what,
        within: ANSWER_WITHIN,
    };
    timeout(ANSWER_WITHIN, stored).await.unwrap_or(Err(late))
}

/// What the object store tells of an object, as far as it is needed here.
#[derive(Deserialize)]
struct ObjectMeta {
    nuid: String,
    chunks: u32,
}

/// The name of an object as it stands in a subject.
fn encoded(name: &str) -> String {
    use base64::Engine;
    base64::engine::general_purpose::URL_SAFE.encode(name)
}
