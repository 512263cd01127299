//! A bus that is described without being opened.

use std::time::Instant;

use volcomp_port::Fault;

use crate::frame::{CanPort, Frame, Received};

/// A bus that is only named, for checks before opening: it never receives a frame.
pub(crate) struct Unopened(pub(crate) String);

impl CanPort for Unopened {
    fn device(&self) -> &str {
        &self.0
    }

    fn receive(&mut self, _deadline: Instant) -> Result<Option<Received>, Fault> {
        Err(Fault::NotConnected)
    }

    fn send(&mut self, _frame: &Frame, _deadline: Instant) -> Result<(), Fault> {
        Err(Fault::NotConnected)
    }
}
