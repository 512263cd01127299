//! The audit log of a sender: a thread of its own writes it, so that the map in use is kept whatever the disk does.

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

/// A map waits for its record for so long; later nobody would expect it any more.
pub(super) const RECORD: Duration = Duration::from_secs(5);
/// How often it is looked whether a record is written, before anything is sent.
const LOOK: Duration = Duration::from_millis(10);
/// The last records get onto the disk within this, or are lost.
const END: Duration = Duration::from_secs(1);

/// The log. No call waits for the disk but those before the first map is sent and after the last one.
pub(super) struct Log {
    clerk: Clerk,
    clock: Clock,
    /// Why records may be missing, as it was told.
    trouble: Option<&'static str>,
}

impl Log {
    /// Opens the log in a folder.
    ///
    /// # Errors
    /// A folder that cannot be written, or the operating system gives no thread.
    pub(super) fn begin(folder: &Path, clock: Clock) -> io::Result<Self> {
        let (audit, _) = AuditLog::open(folder)?;
        Ok(Self {
            clerk: Clerk::start(audit, clock.clone())?,
            clock,
            trouble: None,
        })
    }

    /// Hands over a record about a map.
    pub(super) fn record(&self, checked: &Checked, what: &str) -> Receipt {
        self.clerk.record(entry(checked, what))
    }

    /// Waits until the beginning is on record: nothing is sent before. Whether it is; a signal ends it.
    ///
    /// # Errors
    /// The record cannot be written, or the disk does not answer.
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

    /// Whether the log is written as it should; where it was not, it is tried again. `checked` is the map that is sent.
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

    /// Waits a little for the last records.
    pub(super) fn end(&self) {
        if !self.clerk.settle(END) {
            tracing::error!("the disk of the audit log does not answer: the last records are lost");
        }
    }
}

/// A record about a map, of now.
fn entry(checked: &Checked, what: &str) -> Entry {
    let details = Details {
        model: format!("map {}", checked.hash),
        output_um: BTreeMap::new(),
        output_urad: BTreeMap::new(),
        what: Event::Nothing,
    };
    Entry::new("send-map", what, details)
}
