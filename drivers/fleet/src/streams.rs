//! Buckets and streams at the server, created by the centre.
//!
//! A key-value bucket is a stream whose name starts with `KV_`. Buckets are created as streams, because the client's
//! function for buckets requires information that servers of version 2.9 do not return.

use std::time::Duration;

use async_nats::jetstream::{Context, object_store, stream};

use crate::{
    LinkError, MachineId, SiteId,
    link::nats_error,
    subjects::{DESIRED_BUCKET, Kind, desired_subject, models_bucket},
};

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
pub(crate) fn streams_of(site: &SiteId) -> [(String, Vec<String>); 2] {
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
