//! A disk that hangs answers nothing, not even that it fails: whoever waits for it says so first, and another thread tells it.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use super::Shared;

/// A disk that has not answered for so long is said to hang.
const HANGS_AFTER: Duration = Duration::from_secs(3);
/// How often it is looked at.
const LOOK: Duration = Duration::from_millis(500);

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
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Waits {
    fn drop(&mut self) {
        *self.0.since() = None;
    }
}

/// Tells it while a disk hangs, for ever. Whoever waits tells what comes after it.
pub(super) async fn watch(shared: &Shared, folder: &str) {
    loop {
        tokio::time::sleep(LOOK).await;
        let hangs = format!("{folder}: the disk does not answer");
        if shared.acting.hangs() {
            let what = format!("{hangs}: what was accepted is not in force before it does");
            shared
                .published
                .tell_fleet(|state| state.trouble = Some(what));
        }
        if shared.telling.hangs() {
            let what = format!("{hangs}: the centre is told nothing before it does");
            shared
                .published
                .tell_fleet(|state| state.waiting = Some(what));
        }
    }
}
