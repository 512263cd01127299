//! The audit log of a map sender. A separate thread writes it, so that the map is kept valid even if the disk hangs.

use std::{collections::BTreeMap, io, path::Path, time::Duration};

use volcomp_port::Clock;

use super::Checked;
use crate::{
    audit::{
        AuditLog, Entry,
        clerk::{Clerk, Receipt},
    },
    documents::{Details, Event},
    signals::{Heard, Signal},
};

/// Timeout for the record of a new map, which is then not sent.
pub(super) const RECORD: Duration = Duration::from_secs(5);
/// Polling interval for the first record, before anything is sent.
const LOOK: Duration = Duration::from_millis(10);
/// Timeout for the last records at shutdown; then they are lost.
const END: Duration = Duration::from_secs(1);

/// The log. Only calls before the first map is sent and after the last one wait for the disk.
pub(super) struct Log {
    clerk: Clerk,
    clock: Clock,
    /// The last reported reason why records may be missing.
    trouble: Option<&'static str>,
}

impl Log {
    /// Opens the log in a folder.
    ///
    /// # Errors
    /// The folder cannot be written, or the operating system cannot create a thread.
    pub(super) fn begin(folder: &Path, clock: Clock) -> io::Result<Self> {
        let (audit, _) = AuditLog::open(folder)?;
        Ok(Self {
            clerk: Clerk::start(audit, clock.clone())?,
            clock,
            trouble: None,
        })
    }

    /// Queues a record about a map.
    pub(super) fn record(&self, checked: &Checked, what: &str) -> Receipt {
        self.clerk.record(entry(checked, what))
    }

    /// Waits until the first record is written; nothing is sent before. Returns `false` if a signal ends the wait.
    ///
    /// # Errors
    /// The record cannot be written, or the disk does not respond.
    pub(super) fn wait_for_first(&self, checked: &Checked, heard: &Heard) -> io::Result<bool> {
        let receipt = self.record(checked, "a map is going to be sent");
        let until = self.clock.now() + RECORD;
        loop {
            match receipt.written() {
                Some(true) => return Ok(true),
                Some(false) => {
                    return Err(io::Error::other(
                        "the audit log cannot be written, and nothing was sent",
                    ));
                }
                None if self.clock.now() > until => {
                    return Err(io::Error::new(
                        io::ErrorKind::TimedOut,
                        format!(
                            "the disk of the audit log has not answered for {} s, and nothing was sent",
                            RECORD.as_secs()
                        ),
                    ));
                }
                None => {}
            }
            if heard.next(LOOK) == Some(Signal::Stop) {
                return Ok(false);
            }
        }
    }

    /// Reports changes of the log's health and retries a failed log. `checked` is the map being sent.
    pub(super) fn look_after(&mut self, checked: &Checked) {
        let trouble = self.clerk.trouble();
        if trouble != self.trouble {
            if let Some(trouble) = trouble {
                tracing::error!(
                    "{trouble}: the map stays in use, and no other one is taken until it is written again"
                );
            } else {
                tracing::info!("the audit log is written again");
            }
            self.trouble = trouble;
        }
        let again = || entry(checked, "audit log can be written again");
        self.clerk.try_again(again);
    }

    /// Waits at most [`END`] for the last records.
    pub(super) fn end(&self) {
        if !self.clerk.settle(END) {
            tracing::error!("the disk of the audit log does not answer: the last records are lost");
        }
    }
}

/// A record about a map, with the current time.
fn entry(checked: &Checked, what: &str) -> Entry {
    let details = Details {
        model: format!("map {}", checked.hash),
        output_um: BTreeMap::new(),
        output_urad: BTreeMap::new(),
        what: Event::Nothing,
    };
    Entry::new("send-map", what, details)
}
