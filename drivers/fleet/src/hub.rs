//! The centre's side of the connection: what machines shall run goes out, and a value that somebody else put is seen.

use std::sync::Arc;

use async_nats::{
    Client, HeaderMap,
    jetstream::{self, Context},
};
use bytes::Bytes;
use futures_util::StreamExt;
use tokio::{sync::Notify, time::timeout};

use crate::{
    Collection, Keeping, LinkError, LinkSettings, MachineId, SiteId,
    link::{ANSWER_WITHIN, failed, is_connected, stored},
    prepare, put_model,
    subjects::{desired_subject, latest_desired_subject, streams_of},
};

/// The connection of a centre. Copies share it.
#[derive(Clone)]
pub struct Hub {
    client: Client,
    context: Context,
    /// Tells that the connection is there (again).
    again: Arc<Notify>,
}

/// A value that stands under the key of a machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    pub machine: MachineId,
    /// The value; empty: it was deleted.
    pub value: Bytes,
}

/// What is heard of the keys of the machines.
pub enum Heard {
    /// A value was put, by this centre or by anybody else.
    Put(Found),
    /// The connection is there, for the first time or again: what was put meanwhile has not been heard.
    Connected,
}

/// Listens to what is put under the keys of the machines.
pub struct DesiredWatch {
    puts: async_nats::Subscriber,
    again: Arc<Notify>,
}

impl Hub {
    /// Connects with the nkey of a centre. Where the server is not there it goes on trying in the background.
    ///
    /// # Errors
    /// A seed or an address that is none.
    pub async fn connect(settings: &LinkSettings) -> Result<Self, LinkError> {
        let again = Arc::new(Notify::new());
        let client = settings
            .options(&again)?
            .name("volcomp-centre")
            .connect(settings.servers())
            .await
            .map_err(failed("connecting"))?;
        let mut context = jetstream::new(client.clone());
        context.set_timeout(ANSWER_WITHIN);
        Ok(Self {
            client,
            context,
            again,
        })
    }

    /// The JetStream context, for what this crate has no function for.
    pub fn context(&self) -> &Context {
        &self.context
    }

    /// Whether the server is connected now.
    pub fn is_connected(&self) -> bool {
        is_connected(&self.client)
    }

    /// Makes the bucket and the streams of these sites; see [`prepare`].
    ///
    /// # Errors
    /// The server does not answer or does not allow it.
    pub async fn prepare(&self, sites: &[SiteId], keeping: Keeping) -> Result<(), LinkError> {
        prepare(&self.context, sites, keeping).await
    }

    /// Puts a value under the key of a machine, and waits until it is stored.
    ///
    /// # Errors
    /// It is not known whether it was stored: put it again.
    pub async fn put_desired(&self, machine: &MachineId, value: Bytes) -> Result<(), LinkError> {
        let subject = desired_subject(machine.as_str());
        let what = "putting a manifest";
        stored(what, &self.context, subject, HeaderMap::new(), value).await
    }

    /// The value under the key of a machine now; `None`: there is none.
    ///
    /// # Errors
    /// The server does not answer.
    pub async fn desired(&self, machine: &MachineId) -> Result<Option<Bytes>, LinkError> {
        let subject = latest_desired_subject(machine);
        let answer = timeout(ANSWER_WITHIN, self.client.request(subject, Bytes::new()));
        let message = answer
            .await
            .map_err(|_| LinkError::Late {
                what: "asking for a manifest",
                within: ANSWER_WITHIN,
            })?
            .map_err(failed("asking for a manifest"))?;
        // A status stands for "no such message"; a deletion is a value without bytes.
        Ok((message.status.is_none() && !message.payload.is_empty()).then_some(message.payload))
    }

    /// Puts a model that is too large for its manifest; see [`put_model`].
    ///
    /// # Errors
    /// The server does not answer or does not allow it.
    pub async fn put_model(
        &self,
        machine: &MachineId,
        sha256: &str,
        model: &[u8],
        replicas: usize,
    ) -> Result<(), LinkError> {
        put_model(&self.context, machine, sha256, model, replicas).await
    }

    /// Listens to the keys of all machines. One listener is told of connections; with several, each of some.
    ///
    /// # Errors
    /// The connection is closed.
    pub async fn watch_desired(&self) -> Result<DesiredWatch, LinkError> {
        let puts = self
            .client
            .subscribe(desired_subject("*"))
            .await
            .map_err(failed("listening to manifests"))?;
        Ok(DesiredWatch {
            puts,
            again: Arc::clone(&self.again),
        })
    }

    /// Collects what the machines of a site say: conditions and telemetry, and audit records and acknowledgements.
    pub fn collections(&self, site: &SiteId) -> [Collection; 2] {
        streams_of(site).map(|(stream, _)| Collection::new(self.context.clone(), stream))
    }
}

impl DesiredWatch {
    /// What is heard next; `None`: the connection was closed for good. Giving up waiting loses nothing.
    pub async fn next(&mut self) -> Option<Heard> {
        loop {
            tokio::select! {
                message = self.puts.next() => {
                    let message = message?;
                    let machine = message.subject.as_str().rsplit('.').next().map(str::parse);
                    // A key that is no name of a machine is nobody's.
                    if let Some(Ok(machine)) = machine {
                        return Some(Heard::Put(Found { machine, value: message.payload }));
                    }
                }
                () = self.again.notified() => return Some(Heard::Connected),
            }
        }
    }
}
