//! The settings of machines: whoever changes what one is registered with, it is told.

use std::collections::BTreeMap;

use volcomp_fleet::MachineId;

use super::{Engine, writer::lock};
use crate::{
    drift::in_force,
    issue::{NotIssued, differs, settle},
    records::{Machine, Version},
    store::StoreError,
};

/// So many machines are told other settings at one look.
const AT_ONE_LOOK: usize = 200;

/// Has every machine told what it is registered with, whoever changed that and however.
pub(super) fn look(
    engine: &Engine,
    unsettled: &mut BTreeMap<MachineId, String>,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
) -> Result<(), StoreError> {
    let before = std::mem::take(unsettled);
    let mut issued = 0;
    for machine in machines {
        let name = &machine.identity.machine;
        if issued == AT_ONE_LOOK {
            break;
        }
        let is_other = if let Some(newest) = versions.get(name) {
            differs(machine, newest)
        } else {
            // Where nothing is under its key it goes on with what it has.
            let live = lock(&engine.ingest)
                .machine(name)
                .and_then(|heard| heard.live.clone());
            match live.filter(|live| live.version > 0) {
                Some(live) => {
                    let versions = engine.store.versions(name)?;
                    in_force(&versions, Some(&live)).is_some_and(|one| differs(machine, one))
                }
                None => false,
            }
        };
        if !is_other {
            continue;
        }
        match settle(&engine.store, &engine.settings.key, name, "centre") {
            Ok(_) => issued += 1,
            Err(NotIssued::Store(error)) => return Err(error),
            Err(other) => {
                let why = other.to_string();
                if before.get(name) != Some(&why) {
                    tracing::error!("the settings of {name} are not sent: {why}");
                }
                unsettled.insert(name.clone(), why);
            }
        }
    }
    Ok(())
}
