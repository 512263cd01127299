//! Connections made and made again on a helper thread, handed over open.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use crate::{DeviceError, Fault};

/// How long to wait before the next try.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Backoff {
    /// After the first failure; doubled with every further one.
    pub first: Duration,
    /// At the most. After a connection that lived for ten times `first` it begins anew.
    pub most: Duration,
}

impl Default for Backoff {
    /// 100 ms to 10 s.
    fn default() -> Self {
        Self {
            first: Duration::from_millis(100),
            most: Duration::from_secs(10),
        }
    }
}

impl Backoff {
    fn after(self, before: Duration) -> Duration {
        (before * 2).clamp(self.first, self.most)
    }
}

#[derive(Default)]
struct Shared {
    opened: AtomicU64,
    last_error: Mutex<Option<DeviceError>>,
}

/// A connection that comes back by itself. The thread of a real-time loop takes it open and gives it up
/// when it is dead; resolving, connecting, waiting and closing happen on a thread of its own, which ends with
/// the supply.
pub struct Supply<T> {
    current: Option<T>,
    open: Receiver<T>,
    dead: SyncSender<T>,
    shared: Arc<Shared>,
}

impl<T: Send + 'static> Supply<T> {
    /// Begins to connect by `open`, which must bound its own time.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn new(
        device: &str,
        backoff: Backoff,
        open: impl FnMut() -> Result<T, DeviceError> + Send + 'static,
    ) -> Result<Self, DeviceError> {
        let (hand_over, taken) = sync_channel(1);
        let (give_back, dead) = sync_channel(1);
        let shared = Arc::new(Shared::default());
        let name: String = device.chars().take(15).collect();
        let helper = Helper {
            open,
            hand_over,
            dead,
            shared: Arc::clone(&shared),
            backoff,
        };
        thread::Builder::new()
            .name(name)
            .spawn(move || helper.run())
            .map_err(|e| {
                let remedy = "check the limits on threads and memory of this process";
                DeviceError::open(device, format!("no thread for its connection: {e}"), remedy)
                    .caused_by(e)
            })?;
        Ok(Self {
            current: None,
            open: taken,
            dead: give_back,
            shared,
        })
    }

    /// The open connection. Never blocks or allocates.
    ///
    /// # Errors
    /// [`Fault::NotConnected`].
    pub fn current(&mut self) -> Result<&mut T, Fault> {
        if self.current.is_none() {
            self.current = self.open.try_recv().ok();
        }
        self.current.as_mut().ok_or(Fault::NotConnected)
    }

    /// Gives the connection up, after a time-out or a broken answer: it is closed elsewhere and a new one
    /// made.
    pub fn lose(&mut self) {
        if let Some(dead) = self.current.take() {
            // There is one connection at a time, so there is room.
            let _ = self.dead.try_send(dead);
        }
    }

    /// Waits until there is a connection: for programs that are not in a hurry.
    ///
    /// # Errors
    /// Why the last try failed.
    pub fn wait(&mut self, at_most: Duration) -> Result<&mut T, DeviceError> {
        if self.current.is_none() {
            self.current = self.open.recv_timeout(at_most).ok();
        }
        if self.current.is_none() {
            return Err(self.last_error().unwrap_or_else(|| {
                let what = format!("no connection within {} ms", at_most.as_millis());
                DeviceError::no_answer("connection", what, "check the address and the cable")
            }));
        }
        self.current()
            .map_err(|fault| DeviceError::of_fault("connection", fault, "check the cable"))
    }

    /// How often a connection was made.
    pub fn opened(&self) -> u64 {
        self.shared.opened.load(Ordering::Relaxed)
    }

    /// Why the last try failed; `None` since the last success. Takes a lock: not for a cycle.
    pub fn last_error(&self) -> Option<DeviceError> {
        let last = self.shared.last_error.lock();
        last.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

struct Helper<T, F> {
    open: F,
    hand_over: SyncSender<T>,
    dead: Receiver<T>,
    shared: Arc<Shared>,
    backoff: Backoff,
}

impl<T, F: FnMut() -> Result<T, DeviceError>> Helper<T, F> {
    fn run(mut self) {
        let mut pause = Duration::ZERO;
        loop {
            match (self.open)() {
                Ok(connection) => {
                    self.note(None);
                    self.shared.opened.fetch_add(1, Ordering::Relaxed);
                    let born = Instant::now();
                    if self.hand_over.send(connection).is_err() {
                        return;
                    }
                    let Ok(dead) = self.dead.recv() else { return };
                    drop(dead);
                    if born.elapsed() > self.backoff.first * 10 {
                        pause = Duration::ZERO;
                    }
                }
                Err(error) => self.note(Some(error)),
            }
            pause = self.backoff.after(pause);
            // Nothing can come here but the end of the supply.
            if let Err(RecvTimeoutError::Disconnected) = self.dead.recv_timeout(pause) {
                return;
            }
        }
    }

    fn note(&self, error: Option<DeviceError>) {
        let last = self.shared.last_error.lock();
        *last.unwrap_or_else(PoisonError::into_inner) = error;
    }
}
