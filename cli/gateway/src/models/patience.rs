//! How long somebody waits for a model to be put in force: what waits for a disk that hangs is not done later, when nobody expects
//! it any more.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// So long it may take until the service is asked: whoever asked hears that it is given up before the request is too old to be
/// answered.
const WITHIN: Duration = Duration::from_secs(5);

/// The patience for one request: either it goes to the service, or whoever asked gives it up. Never both.
#[derive(Clone, Debug)]
pub(crate) struct Patience {
    until: Instant,
    is_decided: Arc<AtomicBool>,
}

impl Patience {
    /// It begins now.
    pub(crate) fn begin() -> Self {
        Self {
            until: Instant::now() + WITHIN,
            is_decided: Arc::default(),
        }
    }

    /// How long it lasts from now on.
    pub(crate) fn left(&self) -> Duration {
        self.until.saturating_duration_since(Instant::now())
    }

    /// Whether the request may go to the service now; it goes there then.
    pub(crate) fn lets_go_on(&self) -> bool {
        !self.left().is_zero() && !self.is_decided.swap(true, Ordering::AcqRel)
    }

    /// Whether the request is given up now: it does not go to the service any more.
    pub(crate) fn gives_up(&self) -> bool {
        !self.is_decided.swap(true, Ordering::AcqRel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_goes_on_or_is_given_up() {
        let patience = Patience::begin();
        let of_desk = patience.clone();
        assert!(of_desk.lets_go_on());
        assert!(!patience.gives_up(), "its answer comes from the service");
        let patience = Patience::begin();
        let of_desk = patience.clone();
        assert!(patience.gives_up());
        assert!(!of_desk.lets_go_on());
        // Nobody gave it up, and it is late.
        let late = Patience {
            until: Instant::now(),
            is_decided: Arc::default(),
        };
        assert!(!late.lets_go_on());
    }
}
