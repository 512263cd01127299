//! The values under the keys of the machines: writes issued values, and restores them if another
//! client has overwritten them.

use std::{collections::BTreeMap, sync::Arc, time::Duration, time::Instant};

use bytes::Bytes;
use futures_util::StreamExt;
use volcomp_fleet::{
    Desired, DesiredEvent, DesiredValue, DesiredWatch, MachineId, Manifest, ModelRef,
};

use super::{Engine, blocking, lock};
use crate::{Error, records::AlarmKind, store::SignedValue};

const MAX_CONCURRENT: usize = 64;
/// Delay before a foreign value is checked again: the centre may already be writing its next value.
const RECHECK_DELAY: Duration = Duration::from_millis(200);
const RETRY_INTERVAL: Duration = Duration::from_secs(1);

/// Sends every issued value that is not yet under its machine's key. The next pass retries failures. Of several failures
/// the alphabetically first is returned, so that the alarm does not alternate.
pub(super) async fn send(engine: &Arc<Engine>) -> Result<(), String> {
    if !engine.is_connected() {
        return Ok(());
    }
    let engine_clone = Arc::clone(engine);
    let due = match blocking(move || due(&engine_clone)).await {
        Ok(due) => due,
        Err(error) => {
            engine.set_failure(AlarmKind::Store, Some(error.to_string()));
            return Ok(());
        }
    };
    let puts = due.into_iter().map(|issued| put(engine, issued));
    let mut puts = futures_util::stream::iter(puts).buffer_unordered(MAX_CONCURRENT);
    let mut failures = Vec::new();
    while let Some(done) = puts.next().await {
        failures.extend(done.err().map(|error| error.to_string()));
    }
    failures.into_iter().min().map_or(Ok(()), Err)
}

/// Issued values that this program has not yet put under their machines' keys. Other programs, such as the command
/// line, also issue values.
fn due(engine: &Engine) -> Result<Vec<SignedValue>, Error> {
    let wanted = engine.store.desired_versions()?;
    let put = lock(&engine.put).clone();
    let is_put = |machine: &MachineId, version: u64, has_value: bool| {
        put.get(machine)
            .is_some_and(|(known, value)| *known >= version && (has_value || value.is_empty()))
    };
    let mut due = Vec::new();
    for (machine, (version, has_value)) in wanted {
        if is_put(&machine, version, has_value) {
            continue;
        }
        if has_value {
            due.extend(engine.store.issued(&machine)?);
        } else {
            due.push(SignedValue { machine, version, model: String::new(), value: String::new() });
        }
    }
    Ok(due)
}

/// The value under a key; an empty value is a deletion.
fn non_empty(value: Option<&Bytes>) -> Option<&Bytes> {
    value.filter(|value| !value.is_empty())
}

async fn put(engine: &Arc<Engine>, issued: SignedValue) -> Result<(), Error> {
    let value = Bytes::from(issued.value);
    // Put the model first: a machine requests it as soon as it reads the manifest.
    let inline =
        value.is_empty() || Desired::parse(&value).is_ok_and(|desired| desired.model.is_some());
    let text = if inline {
        None
    } else {
        let (engine_clone, model) = (Arc::clone(engine), issued.model.clone());
        match blocking(move || engine_clone.store.model_text(&model)).await {
            Ok(text) => text,
            Err(error) => {
                // The next pass retries the manifest and its model.
                engine.set_failure(AlarmKind::Store, Some(error.to_string()));
                return Ok(());
            }
        }
    };
    if let Some(text) = text {
        engine
            .hub
            .put_model(
                &issued.machine,
                &issued.model,
                text.as_bytes(),
                engine.settings.stream_retention.replicas,
            )
            .await?;
    }
    // After a restart the key may already hold the value; putting it again would notify the machine needlessly.
    let found = engine.hub.desired(&issued.machine).await?;
    if non_empty(found.as_ref()) != non_empty(Some(&value)) {
        if let Some(found) = found
            && !was_issued(engine, &issued.machine, &found).await
        {
            match own_manifest(engine, &found) {
                None => report_foreign_value(engine, &issued.machine),
                Some(newer)
                    if newer.machine == issued.machine && newer.version >= issued.version =>
                {
                    return Err(Error::Conflict(format!(
                        "{}: found version {} of this centre at the server, which the database does not know: the database is an older copy, and its version {} is not sent; start a new roll-out, whose version is above the one that the machine reports",
                        issued.machine, newer.version, issued.version
                    )));
                }
                Some(_) => {}
            }
        }
        engine.hub.put_desired(&issued.machine, value.clone()).await?;
    }
    lock(&engine.put).insert(issued.machine, (issued.version, value));
    Ok(())
}

pub(super) async fn watch(engine: Arc<Engine>) {
    loop {
        match engine.hub.watch_desired().await {
            Ok(watch) => restore_on_change(&engine, watch).await,
            Err(error) => tracing::warn!("listening to the keys: {error}"),
        }
        tokio::time::sleep(RETRY_INTERVAL).await;
    }
}

async fn restore_on_change(engine: &Engine, mut watch: DesiredWatch) {
    while let Some(heard) = watch.next().await {
        match heard {
            DesiredEvent::Put(DesiredValue { machine, value }) => {
                if is_other(engine, &machine, Some(&value)) {
                    tokio::time::sleep(RECHECK_DELAY).await;
                    restore(engine, &machine).await;
                }
            }
            DesiredEvent::Connected => {
                let machines: Vec<MachineId> = lock(&engine.put).keys().cloned().collect();
                let mut checks = futures_util::stream::iter(machines)
                    .map(|machine| async move { restore(engine, &machine).await })
                    .buffer_unordered(MAX_CONCURRENT);
                while checks.next().await.is_some() {}
            }
        }
    }
}

/// True if a value differs from the value that this centre last wrote for the machine. False if this centre has written
/// no value, because there is nothing to restore.
fn is_other(engine: &Engine, machine: &MachineId, value: Option<&Bytes>) -> bool {
    let put = lock(&engine.put);
    let own: &BTreeMap<MachineId, (u64, Bytes)> = &put;
    own.get(machine).is_some_and(|(_, own)| non_empty(Some(own)) != non_empty(value))
}

/// Checks the value under a key, and restores the centre's value if the key holds another one.
async fn restore(engine: &Engine, machine: &MachineId) {
    let result = async {
        let value = engine.hub.desired(machine).await?;
        if !is_other(engine, machine, value.as_ref()) {
            return Ok(());
        }
        let own = lock(&engine.put).get(machine).map(|(_, own)| own.clone());
        let Some(own) = own else { return Ok(()) };
        if value.as_ref().is_none_or(|value| own_manifest(engine, value).is_none()) {
            report_foreign_value(engine, machine);
        }
        engine.hub.put_desired(machine, own).await
    };
    if let Err(error) = result.await {
        // Every key is checked again after a reconnect.
        tracing::warn!("{machine}: {error}");
    }
}

fn report_foreign_value(engine: &Engine, machine: &MachineId) {
    tracing::error!("{machine}: a foreign value under its key is replaced");
    lock(&engine.clobbered).insert(machine.clone(), Instant::now());
}

/// True if this centre issued this value, even with a key that was revoked since; also true (and logged) if the store
/// is unreadable.
async fn was_issued(engine: &Arc<Engine>, machine: &MachineId, value: &[u8]) -> bool {
    let sha256 = ModelRef::of(value).sha256;
    let (engine_clone, machine) = (Arc::clone(engine), machine.clone());
    let versions = blocking(move || engine_clone.store.versions(&machine)).await;
    match versions {
        Ok(versions) => versions.iter().any(|one| one.value_sha256 == sha256),
        Err(error) => {
            engine.set_failure(AlarmKind::Store, Some(error.to_string()));
            true
        }
    }
}

/// The manifest of a value that one of this centre's keys has signed.
fn own_manifest(engine: &Engine, value: &[u8]) -> Option<Manifest> {
    let desired = Desired::parse(value).ok()?;
    let signer = desired.signer().ok()??;
    let mut own = engine.settings.own.iter();
    own.find(|key| key.key.verifying_key() == signer)?;
    serde_json::from_str(&desired.manifest).ok()
}
