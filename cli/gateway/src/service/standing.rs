//! State that survives a restart.
//!
//! It consists of an unacknowledged fault, a disarm by an operator, jumped temperatures and positions, and interlocks
//! that were not seen to clear.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use volcomp_guard::{Interlock, Reasons, State};
use volcomp_port::Description;
use volcomp_runtime::Report;

use super::Service;
use crate::{
    audit::{
        log_files, standing_file,
        writer::{self, RETRY_INTERVAL, Receipt},
    },
    documents::Standing,
};

/// Value of `disarmed_by` if the file is unreadable.
const UNKNOWN_REQUESTER: &str = "unknown";

/// Reads the state from before the start. Auto-arm stays off, as after a disarm by an operator, if the file is
/// unreadable, or missing although the log has records.
pub(crate) fn read(dir: &Path) -> Standing {
    let path = standing_file(dir);
    let unread = |error: String| {
        tracing::error!("{}: {error}: auto-arm is off", path.display());
        Standing { disarmed_by: Some(UNKNOWN_REQUESTER.to_owned()), ..Standing::default() }
    };
    let standing = match std::fs::read(&path) {
        Ok(bytes) => match writer::latest(&bytes) {
            Some((_, text)) => {
                serde_json::from_str(&text).unwrap_or_else(|e| unread(e.to_string()))
            }
            None => unread("no whole record".to_owned()),
        },
        Err(e) if e.kind() == std::io::ErrorKind::NotFound && !has_records(dir) => {
            Standing::default()
        }
        Err(e) => unread(e.to_string()),
    };
    with_jumps(standing)
}

/// True if a gateway has run with this folder.
fn has_records(dir: &Path) -> bool {
    let is_empty = |file: &PathBuf| file.metadata().is_ok_and(|file| file.len() == 0);
    !log_files(dir).iter().all(is_empty)
}

/// Converts sensors that jumped before a restart to a fault. After the start the temperature before the jump is
/// unknown, and the first reading would be accepted, so the operator must check the sensor first.
fn with_jumps(mut standing: Standing) -> Standing {
    let jumped = std::mem::take(&mut standing.jumped);
    if !jumped.is_empty() {
        let what = format!("temperature that jumped before the restart: {}", jumped.join(", "));
        standing.faulted.get_or_insert_default().push(what);
    }
    standing
}

/// The interlocks from before the start, with the index of the controller that showed them. The interlock of a
/// controller that is no longer configured cannot be seen to clear, so it becomes a fault that the operator must
/// acknowledge.
pub(crate) fn interlocks(
    standing: &mut Standing,
    controllers: &[Description],
) -> Vec<(usize, Interlock)> {
    let (faulted, mut shown) = (&mut standing.faulted, Vec::new());
    standing.interlocks.retain(|device, texts| {
        let reasons = texts.iter().filter_map(|text| Reasons::with_text(text));
        let interlock = Interlock::of(reasons.fold(Reasons::NONE, |all, reason| all | reason));
        let indices = controllers.iter().enumerate();
        let indices = indices.filter(|(_, controller)| controller.device == *device);
        let before = shown.len();
        if interlock.is_set() {
            shown.extend(indices.map(|(index, _)| (index, interlock)));
        }
        let is_known = shown.len() > before;
        if !is_known {
            let what = format!("interlock not seen to clear before the restart: {device}");
            faulted.get_or_insert_default().push(what);
        }
        is_known
    });
    shown
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

    /// Saves a fault until the fault has ended. `before` is the previous state.
    pub(super) fn save_fault(&mut self, before: State, reasons: &[String]) {
        if matches!(self.last_state, State::Faulted(_)) {
            let reasons = reasons.to_vec();
            self.change_standing(|standing| standing.faulted = Some(reasons));
        } else if matches!(before, State::Faulted(_)) {
            self.change_standing(|standing| standing.faulted = None);
        }
    }

    /// Saves the sensors and the axes whose readings have jumped. These sensors stay excluded after a restart, even if
    /// they are silent or faulty by then. While disarmed the guards accept any position, so jumped axes are kept until
    /// the gateway is armed.
    ///
    /// Called after each tick of the service. A jump in the last 50 ms before the program is killed is lost, because
    /// the cycle itself must not wait for a disk.
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

    /// Saves the interlocks that controllers show, or showed before they stopped responding.
    pub(super) fn save_interlocks(&mut self, report: &Report) {
        // Before the first cycle the report is empty.
        if report.cycle == 0 {
            return;
        }
        let mut interlocks = BTreeMap::<String, Vec<String>>::new();
        for (controller, path) in self.parts.controllers.iter().zip(&report.paths) {
            let shown = Interlock::REASONS.into_iter();
            let shown = shown.filter(|reason| path.reasons.contains(*reason));
            let texts = shown.flat_map(Reasons::texts).map(str::to_owned);
            let texts: Vec<String> = texts.collect();
            if !texts.is_empty() {
                let device = controller.device.clone();
                interlocks.entry(device).or_default().extend(texts);
            }
        }
        self.change_standing(|standing| standing.interlocks = interlocks);
    }

    /// Bit mask of the axes whose position had jumped when the gateway was last armed. Automatic arming would accept
    /// such a position. Zero if an operator has disarmed since: arming is then a decision of an operator.
    pub(super) fn jumped_axes(&self) -> u16 {
        if self.last_state.is_armed() || self.standing.disarmed_by.is_some() {
            return 0;
        }
        let axes = self.parts.model.axes.iter().enumerate();
        let jumped = axes.filter(|(_, axis)| self.standing.jumped_axes.contains(axis));
        jumped.fold(0, |bits, (index, _)| bits | 1 << index)
    }

    /// True if there is an unacknowledged fault from before the start, which is unknown to the guards.
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

#[cfg(test)]
mod tests {
    use volcomp_port::{Heartbeat, ShownStates};

    use super::*;

    fn controller(device: &str) -> Description {
        Description {
            device: device.to_owned(),
            channel: String::new(),
            axes: Vec::new(),
            reads: Vec::new(),
            heartbeat: Heartbeat::Watched,
            barrier: false,
            tells_applied: true,
            shown: ShownStates::ALL,
            sees_other_gateways: true,
            shortest_cycle: std::time::Duration::from_millis(1),
        }
    }

    /// An interlock belongs to its controller even if the index of the controller has changed. The interlock of a
    /// removed controller becomes a fault.
    #[test]
    fn interlocks_belong_to_their_controllers() {
        let shown = |device: &str, text: &str| (device.to_owned(), vec![text.to_owned()]);
        let mut standing = Standing {
            interlocks: BTreeMap::from([
                shown("a", "emergency stop"),
                shown("b", "controller alarm"),
                shown("c", "a reason of a later version"),
            ]),
            ..Standing::default()
        };
        let found = interlocks(&mut standing, &["x", "c", "a"].map(controller));
        let stop = Interlock::of(Reasons::EMERGENCY_STOP);
        assert!(stop.emergency_stop && !stop.alarm && !stop.unreferenced);
        assert_eq!(found, [(2, stop)]);
        let unseen = |device| format!("interlock not seen to clear before the restart: {device}");
        assert_eq!(standing.faulted, Some(["b", "c"].map(unseen).to_vec()));
        assert_eq!(standing.interlocks, BTreeMap::from([shown("a", "emergency stop")]));
    }
}
