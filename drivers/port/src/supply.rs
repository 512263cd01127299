//! Connections that a helper thread opens and reopens.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, Thread},
    time::{Duration, Instant},
};

use rtrb::{Consumer, Producer, PushError, RingBuffer};

use crate::{DeviceError, Fault};

/// Delays between connection attempts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Backoff {
    /// Delay after the first failure. Each further failure doubles the delay.
    pub first: Duration,
    /// Maximum delay. After a connection that lasted longer than `first`, the delay starts again at `first`.
    pub most: Duration,
}

impl Default for Backoff {
    /// The first delay is 100 ms, the maximum 10 s.
    fn default() -> Self {
        Self { first: Duration::from_millis(100), most: Duration::from_secs(10) }
    }
}

impl Backoff {
    /// Delay after the next failure. `before` is the previous delay, and `lived` the duration of the lost connection,
    /// zero if none was opened.
    #[must_use]
    pub fn next(self, before: Duration, lived: Duration) -> Duration {
        let doubled =
            if lived > self.first { self.first } else { before.saturating_mul(2).max(self.first) };
        doubled.min(self.most)
    }
}

const POLL_INTERVAL: Duration = Duration::from_micros(500);

#[derive(Default)]
struct Shared {
    opened: AtomicU64,
    ends: AtomicBool,
    last_error: Mutex<Option<DeviceError>>,
}

/// A connection that is reopened automatically. The real-time thread uses the open connection, and hands it back when
/// it fails. A helper thread closes failed connections, and opens new ones with a delay between attempts. It ends when
/// the supply is dropped. Lock-free queues connect both threads, so that the real-time thread never waits.
pub struct Supply<T> {
    current: Option<T>,
    kept: Option<T>,
    open: Consumer<T>,
    dead: Producer<T>,
    connector: Thread,
    shared: Arc<Shared>,
}

impl<T: Send + 'static> Supply<T> {
    /// Starts a helper thread that connects by calling `open`. Each call of `open` must end after a limited time.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn new(
        device: &str,
        backoff: Backoff,
        open: impl FnMut() -> Result<T, DeviceError> + Send + 'static,
    ) -> Result<Self, DeviceError> {
        let (hand_over, taken) = RingBuffer::new(1);
        let (give_back, dead) = RingBuffer::new(1);
        let shared = Arc::new(Shared::default());
        let name: String = device.chars().take(15).collect();
        let connector = Connector { open, hand_over, dead, shared: Arc::clone(&shared), backoff };
        let connector =
            thread::Builder::new().name(name).spawn(move || connector.run()).map_err(|e| {
                let remedy = "check the limits on threads and memory of this process";
                DeviceError::open(device, format!("no thread for its connection: {e}"), remedy)
                    .caused_by(e)
            })?;
        Ok(Self {
            current: None,
            kept: None,
            open: taken,
            dead: give_back,
            connector: connector.thread().clone(),
            shared,
        })
    }

    /// Returns the open connection. Never blocks, allocates or frees.
    ///
    /// # Errors
    /// [`Fault::NotConnected`] until the helper thread has opened a connection.
    pub fn current(&mut self) -> Result<&mut T, Fault> {
        if let Some(dead) = self.kept.take() {
            self.give_back(dead);
        }
        if self.current.is_none() {
            self.current = self.open.pop().ok();
        }
        self.current.as_mut().ok_or(Fault::NotConnected)
    }

    /// Gives up the connection after a timeout or an invalid answer. The helper thread closes it and opens a new
    /// connection. Never blocks, allocates or frees.
    pub fn lose(&mut self) {
        if let Some(dead) = self.current.take() {
            self.give_back(dead);
        }
    }

    /// Hands a failed connection to the helper thread. Dropping the connection here would close and free it on the
    /// real-time thread.
    fn give_back(&mut self, dead: T) {
        match self.dead.push(dead) {
            Ok(()) => self.connector.unpark(),
            // Unreachable, because there is only one connection at a time. The connection is kept, and the next call
            // retries.
            Err(PushError::Full(dead)) => self.kept = Some(dead),
        }
    }

    /// Waits until a connection is open. Do not call this on a real-time thread.
    ///
    /// # Errors
    /// No connection was opened within `at_most`. The error is that of the last attempt, or [`DeviceError::NoAnswer`]
    /// if no attempt has failed.
    pub fn wait(&mut self, at_most: Duration) -> Result<&mut T, DeviceError> {
        let begun = Instant::now();
        while self.current().is_err() {
            if begun.elapsed() >= at_most {
                return Err(self.last_error().unwrap_or_else(|| {
                    let what = format!("no connection within {} ms", at_most.as_millis());
                    DeviceError::no_answer("connection", what, "check the address and the cable")
                }));
            }
            thread::sleep(POLL_INTERVAL);
        }
        self.current()
            .map_err(|fault| DeviceError::of_fault("connection", fault, "check the cable"))
    }

    pub fn opened(&self) -> u64 {
        self.shared.opened.load(Ordering::Relaxed)
    }

    /// Error of the last attempt to connect; `None` if the attempt succeeded or none was made. Takes a lock, so do not
    /// call this on a real-time thread.
    pub fn last_error(&self) -> Option<DeviceError> {
        let last = self.shared.last_error.lock();
        last.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl<T> Drop for Supply<T> {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Release);
        self.connector.unpark();
    }
}

struct Connector<T, F> {
    open: F,
    hand_over: Producer<T>,
    dead: Consumer<T>,
    shared: Arc<Shared>,
    backoff: Backoff,
}

impl<T, F: FnMut() -> Result<T, DeviceError>> Connector<T, F> {
    fn run(mut self) {
        let mut pause = Duration::ZERO;
        while !self.ends() {
            let mut lived = Duration::ZERO;
            match (self.open)() {
                Ok(connection) => {
                    self.note(None);
                    self.shared.opened.fetch_add(1, Ordering::Relaxed);
                    let born = Instant::now();
                    // The queue has room for one connection. It is empty, because the previous connection has been
                    // taken from it.
                    if self.hand_over.push(connection).is_err() {
                        return;
                    }
                    let Some(dead) = self.dead() else { return };
                    drop(dead);
                    lived = born.elapsed();
                }
                Err(error) => self.note(Some(error)),
            }
            pause = self.backoff.next(pause, lived);
            self.rest(pause);
        }
    }

    fn ends(&self) -> bool {
        self.shared.ends.load(Ordering::Acquire)
    }

    /// Waits until the real-time thread gives up the connection, and returns the connection; `None` when the supply
    /// ends.
    fn dead(&mut self) -> Option<T> {
        loop {
            if let Ok(dead) = self.dead.pop() {
                return Some(dead);
            }
            if self.ends() {
                return None;
            }
            thread::park();
        }
    }

    /// Waits for `pause`, or until the supply ends.
    fn rest(&self, pause: Duration) {
        let end = Instant::now() + pause;
        while !self.ends() {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            thread::park_timeout(left);
        }
    }

    fn note(&self, error: Option<DeviceError>) {
        let last = self.shared.last_error.lock();
        *last.unwrap_or_else(PoisonError::into_inner) = error;
    }
}
