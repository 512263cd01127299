//! Who confirms in the demonstration: a person at the page, or after a while the demonstration itself.

use std::{
    collections::HashMap,
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_fleet::MachineId;

use crate::{
    rollout::{Step, Wish},
    store::{Store, StoreError},
};

/// For so long a person may confirm before the demonstration does.
pub const CONFIRMS_AFTER: Duration = Duration::from_secs(20);
/// Who has confirmed, in the audit log.
const BY: &str = "demonstration";

/// What waits: the roll-out, the machine and its hash.
type Waiting = (u64, MachineId, String);

/// Confirms what has waited for long enough, again and again, until the runtime ends.
pub(super) async fn confirm(store: Arc<Store>) {
    let mut since: HashMap<Waiting, Instant> = HashMap::new();
    let mut ticks = tokio::time::interval(Duration::from_secs(1));
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let store = Arc::clone(&store);
        let looked = tokio::task::spawn_blocking(move || {
            let looked = look(&store, &mut since);
            (looked, since)
        });
        match looked.await {
            Ok((looked, kept)) => {
                since = kept;
                if let Err(error) = looked {
                    tracing::warn!("demo: {error}");
                }
            }
            Err(error) => {
                tracing::error!("demo: {error}");
                return;
            }
        }
    }
}

fn look(store: &Store, since: &mut HashMap<Waiting, Instant>) -> Result<(), StoreError> {
    let mut waiting = Vec::new();
    for id in store.open_rollouts()? {
        let Some(rollout) = store.rollout(id)? else {
            continue;
        };
        for target in rollout.targets {
            if let Step::NeedsConfirmation { hash, .. } = target.step {
                waiting.push((id, target.machine, hash));
            }
        }
    }
    since.retain(|known, _| waiting.contains(known));
    for one in waiting {
        let begun = *since.entry(one.clone()).or_insert_with(Instant::now);
        if begun.elapsed() >= CONFIRMS_AFTER {
            let (id, machine, hash) = one.clone();
            match store.wish(id, &Wish::Confirm { machine, hash }, BY) {
                // It has gone on, or stopped, since it was looked at.
                Ok(()) | Err(StoreError::NotConfirmed { .. }) => {}
                Err(error) => return Err(error),
            }
            // The engine takes it up within a second; where it does not, it is wished again after the same while.
            since.insert(one, Instant::now());
        }
    }
    Ok(())
}
