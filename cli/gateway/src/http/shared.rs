//! The state that the routes of the dashboard share.

use std::sync::{
    Arc,
    atomic::{AtomicUsize, Ordering},
};

use volcomp_runtime::DisarmSwitch;

use super::tokens::Tokens;
use crate::{
    config::DashboardConfig, interop::quantities::Quantity, models::Models, published::Published,
    request::Asks,
};

/// The largest number of event streams at one time.
pub(super) const MAX_STREAMS: usize = 16;

/// Who is let in.
pub struct Door {
    /// Who may do what.
    pub tokens: Tokens,
    /// Host names, besides addresses, under which browsers may ask.
    pub hosts: Vec<String>,
    /// Whether reading needs a token, since others can reach it.
    pub reading_needs_token: bool,
}

impl Door {
    /// The door of a configured dashboard, with its tokens.
    pub fn new(config: &DashboardConfig, tokens: Tokens) -> Self {
        Self {
            tokens,
            hosts: config.hosts.clone(),
            reading_needs_token: config.reading_needs_token(),
        }
    }
}

/// The state that the routes of the dashboard share.
pub struct Dashboard {
    /// The models: which there were, and the one that somebody is making.
    pub models: Models,
    /// The state, history and model that the service publishes.
    pub published: Published,
    /// The quantities of the gateway.
    pub quantities: Vec<Quantity>,
    /// Where requests to the service go.
    pub asks: Asks,
    /// The order to disarm, which waits for no service.
    pub switch: DisarmSwitch,
    /// Who is let in.
    pub door: Arc<Door>,
    /// The number of event streams that are open.
    pub streams: AtomicUsize,
}

/// What every request finds.
pub(super) type Shared = Arc<Dashboard>;

/// A place among the event streams, given back with it.
pub(super) struct StreamSlot(Arc<Dashboard>);

impl StreamSlot {
    pub(super) fn take(dashboard: &Arc<Dashboard>) -> Option<Self> {
        let more = |open| (open < MAX_STREAMS).then_some(open + 1);
        let taken = dashboard
            .streams
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, more);
        taken.ok().map(|_| Self(Arc::clone(dashboard)))
    }
}

impl Drop for StreamSlot {
    fn drop(&mut self) {
        self.0.streams.fetch_sub(1, Ordering::AcqRel);
    }
}
