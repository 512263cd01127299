//! What the two threads of a fleet share, and which of them waits for the disk.
//!
//! A disk that hangs answers nothing, not even that it fails: whoever waits for it says so first, and another thread tells it.

use std::{
    sync::{
        Arc, Mutex, MutexGuard,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use crate::published::Published;

/// The seconds between two conditions where the manifest does not say.
const CONDITION_S: u64 = 1;
/// The seconds between two whole states where the manifest does not say.
const TELEMETRY_S: u64 = 10;
/// A disk that has not answered for so long is said to hang.
const HANGS_AFTER: Duration = Duration::from_secs(3);
/// How often it is looked at.
const LOOK: Duration = Duration::from_millis(500);

/// What both threads know.
pub(super) struct Shared {
    pub(super) published: Published,
    /// The version of the manifest in force.
    pub(super) version: AtomicU64,
    /// The highest version that was heard and forbids correcting; 0: none. An older one that is put in force meanwhile lifts
    /// nothing.
    forbidding: AtomicU64,
    condition_s: AtomicU64,
    telemetry_s: AtomicU64,
    /// What waits for the disk while something is put in force.
    pub(super) acting: Arc<AtDisk>,
    /// What waits for the disk while the centre is told something.
    pub(super) telling: Arc<AtDisk>,
}

impl Shared {
    /// Of a start, with the version of the manifest in force; 0: none.
    pub(super) fn new(published: Published, version: u64) -> Self {
        Self {
            published,
            version: AtomicU64::new(version),
            forbidding: AtomicU64::new(0),
            condition_s: AtomicU64::new(CONDITION_S),
            telemetry_s: AtomicU64::new(TELEMETRY_S),
            acting: Arc::default(),
            telling: Arc::default(),
        }
    }

    pub(super) fn version(&self) -> u64 {
        self.version.load(Ordering::Relaxed)
    }

    /// Notes that a version forbids correcting.
    pub(super) fn forbid(&self, version: u64) {
        self.forbidding.fetch_max(version, Ordering::Relaxed);
    }

    /// Whether a newer version than this one forbids correcting.
    pub(super) fn is_forbidden_after(&self, version: u64) -> bool {
        self.forbidding.load(Ordering::Relaxed) > version
    }

    /// The times between two conditions and two whole states, at least a second each.
    pub(super) fn pace(&self) -> [Duration; 2] {
        [&self.condition_s, &self.telemetry_s]
            .map(|s| Duration::from_secs(s.load(Ordering::Relaxed).max(1)))
    }

    pub(super) fn set_pace(&self, condition_s: Option<u32>, telemetry_s: Option<u32>) {
        let set = |to: &AtomicU64, value: Option<u32>, default| {
            to.store(value.map_or(default, u64::from), Ordering::Relaxed);
        };
        set(&self.condition_s, condition_s, CONDITION_S);
        set(&self.telemetry_s, telemetry_s, TELEMETRY_S);
    }
}

/// Since when a thread waits for the disk.
#[derive(Default)]
pub(super) struct AtDisk(Mutex<Option<Instant>>);

/// The wait is over when this is dropped.
pub(super) struct Waits(Arc<AtDisk>);

impl AtDisk {
    /// Begins to wait.
    pub(super) fn wait(self: &Arc<Self>) -> Waits {
        *self.since() = Some(Instant::now());
        Waits(Arc::clone(self))
    }

    fn hangs(&self) -> bool {
        self.since()
            .is_some_and(|since| since.elapsed() > HANGS_AFTER)
    }

    fn since(&self) -> MutexGuard<'_, Option<Instant>> {
        // A time or none: whoever ended with it in its hands has left it whole.
        crate::locked(&self.0)
    }
}

impl Drop for Waits {
    fn drop(&mut self) {
        *self.0.since() = None;
    }
}

/// Tells it while a disk hangs, for ever. When it answers again what was told here is taken back here, whatever whoever waited
/// says after that, and whenever.
pub(super) async fn watch(shared: &Shared, folder: &str) {
    let hangs = format!("{folder}: the disk does not answer");
    let acting = format!("{hangs}: what was accepted is not in force before it does");
    let telling = format!("{hangs}: the centre is told nothing before it does");
    loop {
        tokio::time::sleep(LOOK).await;
        let (is_acting_late, is_telling_late) = (shared.acting.hangs(), shared.telling.hangs());
        shared.published.tell_fleet(|state| {
            tell(&mut state.trouble, is_acting_late, &acting);
            tell(&mut state.waiting, is_telling_late, &telling);
        });
    }
}

/// Sets what is told while the disk hangs; where it does not, only that is taken back.
fn tell(told: &mut Option<String>, hangs: bool, what: &str) {
    if hangs {
        *told = Some(what.to_owned());
    } else if told.as_deref() == Some(what) {
        *told = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whoever waited goes on with something else for long, or was answered between two looks: before, what was told stayed.
    #[test]
    fn what_was_told_of_a_disk_ends_with_it() {
        let mut told = None;
        tell(&mut told, true, "it hangs");
        assert_eq!(told.as_deref(), Some("it hangs"));
        tell(&mut told, false, "it hangs");
        assert_eq!(told, None);
        // What somebody else told stays.
        told = Some("another trouble".to_owned());
        tell(&mut told, false, "it hangs");
        assert_eq!(told.as_deref(), Some("another trouble"));
    }
}
