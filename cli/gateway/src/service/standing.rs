//! State that survives a restart: an unacknowledged fault, and a disarm by an operator.

use std::path::Path;

use volcomp_guard::{Reasons, State};
use volcomp_runtime::Report;

use super::Service;
use crate::{
    audit::{
        slots, standing_file,
        writer::{RETRY_INTERVAL, Receipt},
    },
    documents::Standing,
};

/// Used if the file does not record who disarmed.
const UNKNOWN_REQUESTER: &str = "somebody";

/// Reads the state from before the start. If the file is unreadable, auto-arm stays off, as after a disarm by an
/// operator.
pub(crate) fn read(dir: &Path) -> Standing {
    let path = standing_file(dir);
    let unread = |error: String| {
        tracing::error!("{}: {error}: auto-arm is off", path.display());
        Standing {
            disarmed_by: Some(UNKNOWN_REQUESTER.to_owned()),
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

/// After a start, the temperature before a jump is unknown and the first reading would be accepted. The operator must therefore confirm the sensor
/// first.
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
    pub(super) fn change_standing(&mut self, change: impl FnOnce(&mut Standing)) {
        let before = self.standing.clone();
        change(&mut self.standing);
        if self.standing == before {
            return;
        }
        self.write_standing();
        self.update_reasons();
    }

    pub(super) fn write_standing(&mut self) {
        if let Ok(text) = serde_json::to_string(&self.standing) {
            self.standing_receipt = Some(self.writer.keep_standing(text));
        }
    }

    pub(super) fn check_standing(&mut self) -> bool {
        match self.standing_receipt.as_ref().map(Receipt::written) {
            Some(Some(true)) => {
                self.standing_receipt = None;
                self.standing_lost = false;
            }
            Some(Some(false)) => {
                self.standing_lost = true;
                if self.since(self.standing_tried) > RETRY_INTERVAL {
                    self.standing_tried = self.clock.now();
                    self.write_standing();
                }
            }
            None | Some(None) => {}
        }
        self.standing_lost
    }

    /// Saves a fault until it has ended. `before` is the previous state.
    pub(super) fn save_fault(&mut self, before: State, reasons: &[String]) {
        if matches!(self.last_state, State::Faulted(_)) {
            let reasons = reasons.to_vec();
            self.change_standing(|standing| standing.faulted = Some(reasons));
        } else if matches!(before, State::Faulted(_)) {
            self.change_standing(|standing| standing.faulted = None);
        }
    }

    /// Saves the sensors that have jumped, which stay excluded after a restart, also if they are silent or faulty by then, and the axes whose
    /// position has jumped. While disarmed the guards accept any position, so these axes are kept until the gateway is armed.
    pub(super) fn save_jumped(&mut self, report: &Report) {
        let sensors = self.parts.sensors.iter().zip(&report.sensors);
        let jumped = sensors.filter(|(_, result)| result.jumped);
        let jumped = jumped.map(|(name, _)| name.clone()).collect();
        let axes = self.parts.model.axes.iter().enumerate();
        let axes = axes.filter(|(index, _)| report.not_believed >> index & 1 == 1);
        let axes = (report.state.is_armed()).then(|| axes.map(|(_, axis)| *axis).collect());
        self.change_standing(|standing| {
            standing.jumped = jumped;
            standing.jumped_axes = axes.unwrap_or_else(|| standing.jumped_axes.clone());
        });
    }

    /// Bit mask of the axes whose position had jumped when the gateway was last armed. Automatic arming would accept it; an operator who has
    /// disarmed since arms anyway.
    pub(super) fn jumped_axes(&self) -> u16 {
        if self.last_state.is_armed() || self.standing.disarmed_by.is_some() {
            return 0;
        }
        let axes = self.parts.model.axes.iter().enumerate();
        let jumped = axes.filter(|(_, axis)| self.standing.jumped_axes.contains(axis));
        jumped.fold(0, |bits, (index, _)| bits | 1 << index)
    }

    /// Whether there is an unacknowledged fault from before the start, which the guards do not know.
    pub(super) fn is_faulted_from_before(&self) -> bool {
        self.standing.faulted.is_some() && !matches!(self.last_state, State::Faulted(_))
    }

    pub(super) fn standing_reasons(&self) -> Reasons {
        Reasons::FAULTED_BEFORE.when(self.is_faulted_from_before())
            | Reasons::JUMPED.when(self.jumped_axes() != 0)
            | Reasons::DISARMED_BY_PERSON
                .when(self.standing.disarmed_by.is_some() && self.parts.config.auto_arm)
    }
}
