use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

/// A monotonic clock: the system's, or one that a test advances.
#[derive(Clone, Debug)]
pub enum Clock {
    /// The monotonic clock of the system. Its time is counted from this instant.
    System(Instant),
    /// A manual clock, which only a test advances: the instant of its start, and the nanoseconds since its start.
    Manual(Instant, Arc<AtomicU64>),
}

impl Clock {
    /// The monotonic clock of the system. Its time is counted from now.
    pub fn system() -> Self {
        Self::System(Instant::now())
    }

    /// A manual clock. It stays at 0 until [`advance`](Self::advance).
    pub fn manual() -> Self {
        Self::Manual(Instant::now(), Arc::default())
    }

    pub fn elapsed(&self) -> Duration {
        match self {
            Self::System(start) => start.elapsed(),
            Self::Manual(_, nanos) => Duration::from_nanos(nanos.load(Ordering::Acquire)),
        }
    }

    pub fn start(&self) -> Instant {
        match self {
            Self::System(start) | Self::Manual(start, _) => *start,
        }
    }

    pub fn now(&self) -> Instant {
        self.start() + self.elapsed()
    }

    /// Advances a manual clock. Has no effect on the system clock.
    pub fn advance(&self, by: Duration) {
        if let Self::Manual(_, nanos) = self {
            let by = u64::try_from(by.as_nanos()).unwrap_or(u64::MAX);
            nanos.fetch_add(by, Ordering::AcqRel);
        }
    }
}
