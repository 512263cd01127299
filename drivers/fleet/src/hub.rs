//! The centre's side of the connection: publishes the desired states of machines, and detects values that other clients
//! put.

use std::sync::Arc;

use async_nats::{
    Client, HeaderMap,
    jetstream::{self, Context},
};
use bytes::Bytes;
use futures_util::StreamExt;
use tokio::{sync::Notify, time::timeout};

use crate::{
    Collection, LinkError, LinkSettings, MachineId, SiteId, StreamRetention,
    link::{RESPONSE_TIMEOUT, is_connected, nats_error, stored},
    prepare, put_model,
    streams::streams_of,
    subjects::{desired_subject, latest_desired_subject},
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
