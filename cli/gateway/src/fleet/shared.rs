//! State shared by the two threads of a fleet, including which thread waits for the disk.
//!
//! A disk that hangs reports no error. Each thread therefore registers its wait first, and a separate task reports long
//! waits.

use std::{
    sync::{
        Arc, Mutex, MutexGuard,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use crate::published::Published;

const CONDITION_S: u64 = 1;
/// Default interval between two complete states, s.
const TELEMETRY_S: u64 = 10;
const DISK_TIMEOUT: Duration = Duration::from_secs(3);
const POLL_INTERVAL: Duration = Duration::from_millis(500);

pub(super) struct Shared {
    pub(super) published: Published,
    /// Version of the active manifest; 0: none.
    pub(super) version: AtomicU64,
    /// Highest received version that forbids correcting; 0: none. Activating an older version does not lift the order.
    forbidding: AtomicU64,
    condition_s: AtomicU64,
    telemetry_s: AtomicU64,
    pub(super) activating: Arc<DiskMonitor>,
    pub(super) reporting: Arc<DiskMonitor>,
}

impl Shared {
    /// `version` is the version of the active manifest; 0 if none is active.
    pub(super) fn new(published: Published, version: u64) -> Self {
        Self {
            published,
            version: AtomicU64::new(version),
            forbidding: AtomicU64::new(0),
            condition_s: AtomicU64::new(CONDITION_S),
            telemetry_s: AtomicU64::new(TELEMETRY_S),
            activating: Arc::default(),
            reporting: Arc::default(),
        }
    }

    pub(super) fn version(&self) -> u64 {
        self.version.load(Ordering::Relaxed)
    }

    pub(super) fn forbid(&self, version: u64) {
        self.forbidding.fetch_max(version, Ordering::Relaxed);
    }

    pub(super) fn is_forbidden_after(&self, version: u64) -> bool {
        self.forbidding.load(Ordering::Relaxed) > version
    }

    /// Intervals between two conditions and between two complete states, at least 1 s each.
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

/// When the current wait for the disk started; `None`: no wait.
#[derive(Default)]
pub(super) struct DiskMonitor(Mutex<Option<Instant>>);

pub(super) struct DiskWait(Arc<DiskMonitor>);

impl DiskMonitor {
    pub(super) fn wait(self: &Arc<Self>) -> DiskWait {
        *self.since() = Some(Instant::now());
        DiskWait(Arc::clone(self))
    }

    fn hangs(&self) -> bool {
        self.since().is_some_and(|since| since.elapsed() > DISK_TIMEOUT)
    }

    fn since(&self) -> MutexGuard<'_, Option<Instant>> {
        // The value is a single `Option`, which a panicking thread cannot leave half changed.
        crate::locked(&self.0)
    }
}

impl Drop for DiskWait {
    fn drop(&mut self) {
        *self.0.since() = None;
    }
}

/// Reports a disk that hangs; never returns. When the disk responds, this task clears its own message, regardless of
/// what the waiting thread has reported.
pub(super) async fn watch(shared: &Shared, folder: &str) {
    let hangs = format!("{folder}: the disk does not answer");
    let activating = format!("{hangs}: the accepted manifest is activated once it does");
    let reporting = format!("{hangs}: messages to the centre wait until it does");
    loop {
        tokio::time::sleep(POLL_INTERVAL).await;
        let (is_acting_late, is_telling_late) =
            (shared.activating.hangs(), shared.reporting.hangs());
        shared.published.update_fleet(|state| {
            tell(&mut state.trouble, is_acting_late, &activating);
            tell(&mut state.waiting, is_telling_late, &reporting);
        });
    }
}

/// Sets the message to `what` while the disk hangs. Afterwards clears the message if it is still `what`.
fn tell(message: &mut Option<String>, hangs: bool, what: &str) {
    if hangs {
        *message = Some(what.to_owned());
    } else if message.as_deref() == Some(what) {
        *message = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The message is cleared even if the waiting thread continued with other work, or its wait ended between two polls.
    #[test]
    fn a_disk_message_ends_with_the_wait() {
        let mut message = None;
        tell(&mut message, true, "it hangs");
        assert_eq!(message.as_deref(), Some("it hangs"));
        tell(&mut message, false, "it hangs");
        assert_eq!(message, None);
        // Messages of other tasks remain.
        message = Some("another trouble".to_owned());
        tell(&mut message, false, "it hangs");
        assert_eq!(message.as_deref(), Some("another trouble"));
    }
}
