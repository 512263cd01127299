use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

/// Time since some start: the system's monotonic clock, or one that a test sets.
#[derive(Clone, Debug)]
pub enum Clock {
    /// The monotonic clock of the system, counted from this instant.
    System(Instant),
    /// Nanoseconds from some instant on that somebody else counts.
    Manual(Instant, Arc<AtomicU64>),
}

impl Clock {
    /// The monotonic clock, starting now.
    pub fn system() -> Self {
        Self::System(Instant::now())
    }

    /// A clock that stands at 0 until [`advance`](Self::advance).
    pub fn manual() -> Self {
        Self::Manual(Instant::now(), Arc::default())
    }

    /// Time since the start.
    pub fn elapsed(&self) -> Duration {
        match self {
            Self::System(start) => start.elapsed(),
            Self::Manual(_, nanos) => Duration::from_nanos(nanos.load(Ordering::Acquire)),
        }
    }

    /// The instant at which the clock started.
    pub fn start(&self) -> Instant {
        match self {
            Self::System(start) | Self::Manual(start, _) => *start,
        }
    }

    /// The present instant by this clock.
    pub fn now(&self) -> Instant {
        self.start() + self.elapsed()
    }

    /// Moves a manual clock on; the system's goes by itself.
    pub fn advance(&self, by: Duration) {
        if let Self::Manual(_, nanos) = self {
            let by = u64::try_from(by.as_nanos()).unwrap_or(u64::MAX);
            nanos.fetch_add(by, Ordering::AcqRel);
        }
    }
}
