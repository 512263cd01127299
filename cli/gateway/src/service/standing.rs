//! What outlives a restart: a fault that nobody has acknowledged, and that a person disarmed it.

use std::path::Path;

use volcomp_guard::{Reasons, SensorFlaw, State};
use volcomp_runtime::Report;

use super::Service;
use crate::{
    audit::{
        clerk::{RETRY, Receipt},
        slots, standing_file,
    },
    documents::Standing,
};

/// Who disarmed it, where the file does not tell.
const SOMEBODY: &str = "somebody";

/// What stands since before the start. A file that cannot be read is no proof that a person wants it armed.
pub(crate) fn read(dir: &Path) -> Standing {
    let path = standing_file(dir);
    let unread = |error: String| {
        tracing::error!("{}: {error}: it does not arm by itself", path.display());
        Standing {
            disarmed_by: Some(SOMEBODY.to_owned()),
            ..Standing::default()
        }
    };
    let standing = match std::fs::read(&path)
        .map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
    {
        Ok(text) => match slots::latest(&text) {
            Some((_, text)) => serde_json::from_str(text).unwrap_or_else(|e| unread(e.to_string())),
            None => unread("no whole record".to_owned()),
        },
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Standing::default(),
        Err(e) => unread(e.to_string()),
    };
    with_jumps(standing)
}

/// After a start nothing is known of what a sensor told before it jumped, and its first reading is believed: that it is
/// right a person has to say first.
fn with_jumps(mut standing: Standing) -> Standing {
    let jumped = std::mem::take(&mut standing.jumped);
    if !jumped.is_empty() {
        let what = format!(
            "temperature that jumped before the restart: {}",
            jumped.join(", ")
        );
        standing.faulted.get_or_insert_default().push(what);
    }
    standing
}

impl Service {
    /// What stands from now on.
    pub(super) fn change_standing(&mut self, change: impl FnOnce(&mut Standing)) {
        let before = self.standing.clone();
        change(&mut self.standing);
        if self.standing == before {
            return;
        }
        self.write_standing();
        self.tell_thread();
    }

    /// Writes it down. Where that fails it is tried again until it is written, and told meanwhile.
    pub(super) fn write_standing(&mut self) {
        if let Ok(text) = serde_json::to_string(&self.standing) {
            self.standing_kept = Some(self.clerk.keep_standing(text));
        }
    }

    /// Whether what stands could not be written down; it is tried again then.
    pub(super) fn look_after_standing(&mut self) -> bool {
        match self.standing_kept.as_ref().map(Receipt::written) {
            Some(Some(true)) => {
                self.standing_kept = None;
                self.standing_lost = false;
            }
            Some(Some(false)) => {
                self.standing_lost = true;
                if self.since(self.standing_tried) > RETRY {
                    self.standing_tried = self.clock.now();
                    self.write_standing();
                }
            }
            None | Some(None) => {}
        }
        self.standing_lost
    }

    /// A fault outlives the gateway until it has ended. `before` is the state before the present one.
    pub(super) fn keep_fault(&mut self, before: State, reasons: &[String]) {
        if matches!(self.last_state, State::Faulted(_)) {
            let reasons = reasons.to_vec();
            self.change_standing(|standing| standing.faulted = Some(reasons));
        } else if matches!(before, State::Faulted(_)) {
            self.change_standing(|standing| standing.faulted = None);
        }
    }

    /// A sensor that jumped is out for longer than the gateway runs.
    pub(super) fn keep_jumped(&mut self, report: &Report) {
        let sensors = self.parts.sensors.iter().zip(&report.sensors);
        let jumped = sensors.filter(|(_, told)| told.flaw == Some(SensorFlaw::Jumped));
        let jumped = jumped.map(|(name, _)| name.clone()).collect();
        self.change_standing(|standing| standing.jumped = jumped);
    }

    /// The fault from before the start, which nobody has acknowledged: the guards know nothing of it.
    pub(super) fn is_faulted_from_before(&self) -> bool {
        self.standing.faulted.is_some() && !matches!(self.last_state, State::Faulted(_))
    }

    /// The reasons for not arming, and for telling, that stand.
    pub(super) fn standing_reasons(&self) -> Reasons {
        Reasons::FAULTED_BEFORE.when(self.is_faulted_from_before())
            | Reasons::DISARMED_BY_PERSON
                .when(self.standing.disarmed_by.is_some() && self.parts.config.auto_arm)
    }
}
