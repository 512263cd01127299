//! Current alarm causes of a machine, as a pure function of its state: an alarm is open exactly while its cause is present.

use std::collections::BTreeMap;

use volcomp_fleet::{MachineId, Outcome, largest_moves};

use crate::{
    ingest::Heard,
    records::{AlarmKind, Machine, Model, Version},
};

/// Time an alarm for two simultaneous gateways stays open after the last detection, s.
const CLONED_S: f64 = 60.0;
/// Time an alarm for a momentary event stays open, s.
const TOLD_S: f64 = 600.0;
/// Maximum time until a machine has applied its newest version, s.
const BEHIND_S: f64 = 600.0;

/// State of one machine.
pub(super) struct Known<'a> {
    pub(super) machine: &'a Machine,
    pub(super) heard: Option<&'a Heard>,
    /// Time since its last condition by a monotonic clock, s.
    pub(super) quiet_s: f64,
    pub(super) version: Option<&'a Version>,
    pub(super) model: Option<&'a Model>,
    /// The roll-out of the active version, if it stopped or was aborted.
    pub(super) suspect: Option<&'a Suspect>,
    /// Time since a foreign value was found under its key, s.
    pub(super) clobbered_s: Option<f64>,
    /// Days since a calibration became due.
    pub(super) due_days: Option<f64>,
    pub(super) now_s: f64,
}

/// A stopped or aborted roll-out whose model is active on a machine.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Suspect {
    pub(super) rollout: u64,
    pub(super) what: String,
    /// True if it can still be resumed: its machines are in no other roll-out.
    pub(super) may_go_on: bool,
    /// True if there is an earlier model to return to.
    pub(super) has_way_back: bool,
}

impl Suspect {
    /// Alarm text for a machine, with the available remedies.
    fn in_words(&self, name: &MachineId) -> String {
        let Self { rollout, what, .. } = self;
        let stop = if self.may_go_on {
            format!("after `rollout stop {rollout}` ")
        } else {
            String::new()
        };
        let back = if self.has_way_back {
            format!("{stop}`model back {name}` brings back the one before")
        } else {
            format!(
                "there is no earlier one to go back to, and `machine disable {name}` ends its correction"
            )
        };
        format!(
            "It corrects with the model of roll-out {rollout}, which {what}: {back}; `rollout keep {rollout} {name}` says that the model shall stay."
        )
    }
}

pub(super) fn of(known: &Known<'_>) -> BTreeMap<AlarmKind, String> {
    let mut causes = BTreeMap::new();
    if let Some(ago_s) = known.clobbered_s.filter(|ago_s| *ago_s < TOLD_S) {
        causes.insert(
            AlarmKind::Clobbered,
            format!(
                "A value that this centre did not put stood under its key {ago_s:.0} s ago; its own was put back. The machine refuses a foreign one, but somebody has access to the server who should not."
            ),
        );
    }
    let unreadable = known.heard.and_then(|heard| heard.unreadable.as_ref());
    let unreadable = unreadable.map(|(at, why)| (at.elapsed().as_secs_f64(), why));
    if let Some((ago_s, why)) = unreadable.filter(|(ago_s, _)| *ago_s < TOLD_S) {
        causes.insert(
            AlarmKind::Unreadable,
            format!("A message could not be read {ago_s:.0} s ago: {why}."),
        );
    }
    if let Some(days) = known.due_days.filter(|days| *days >= 0.0) {
        causes.insert(
            AlarmKind::Due,
            format!("The calibration has been due for {days:.0} days."),
        );
    }
    if let Some(suspect) = known.suspect {
        let text = suspect.in_words(&known.machine.identity.machine);
        causes.insert(AlarmKind::Suspect, text);
    }
    of_version(known, &mut causes);
    of_heard(known, &mut causes);
    causes
}

/// Alarm text for a change that the operator must confirm.
pub(super) fn needs_confirmation(version: u64, worst_um: &str, worst_urad: &str) -> String {
    format!(
        "Version {version} moves the axes by up to {}: a person must confirm it.",
        largest_moves(worst_um, worst_urad)
    )
}

fn of_version(known: &Known<'_>, causes: &mut BTreeMap<AlarmKind, String>) {
    let Some(version) = known.version else { return };
    match &version.outcome {
        Some(Outcome::Refused { why }) => {
            causes.insert(
                AlarmKind::Refused,
                format!("It has refused version {}: {why}.", version.version),
            );
        }
        Some(Outcome::NeedsConfirmation {
            worst_um,
            worst_urad,
            ..
        }) => {
            causes.insert(
                AlarmKind::NeedsConfirmation,
                needs_confirmation(version.version, worst_um, worst_urad),
            );
        }
        Some(Outcome::Activated) | None => {}
    }
    let live = known.heard.and_then(|heard| heard.live.as_ref());
    let Some(live) = live else {
        return;
    };
    let other = if live.version == version.version {
        let shall = known.model.map(|model| &model.checksum);
        (live.condition.is_some() && shall.is_some_and(|shall| *shall != live.model))
            .then(|| format!("it corrects with the model {}", live.model))
    } else {
        let waits = version.outcome.is_none() || version.outcome == Some(Outcome::Activated);
        (waits && known.now_s - version.issued_s > BEHIND_S)
            .then(|| format!("version {} is in force", live.version))
    };
    if let Some(other) = other {
        causes.insert(
            AlarmKind::OtherModel,
            format!(
                "It shall run version {} of {}, and {other}.",
                version.version,
                known.model.map_or("a model", |model| &model.name)
            ),
        );
    }
}

fn of_heard(known: &Known<'_>, causes: &mut BTreeMap<AlarmKind, String>) {
    let Some(heard) = known.heard else { return };
    let Some(live) = &heard.live else { return };
    if known.machine.is_silent(known.quiet_s) {
        causes.insert(
            AlarmKind::Silent,
            "It is not heard. It goes on with the model that it has.".to_owned(),
        );
    }
    if heard
        .instances
        .cloned_s
        .is_some_and(|at_s| live.heard_s - at_s < CLONED_S)
    {
        let names: Vec<&str> = (heard.instances.heard_since(live.heard_s - CLONED_S))
            .map(|one| one.instance.as_str())
            .collect();
        causes.insert(
            AlarmKind::Clone,
            format!(
                "Gateways {} have its identity at a time: one of them is a copy.",
                names.join(" and ")
            ),
        );
    }
    if live.lost > 0 {
        causes.insert(
            AlarmKind::Gap,
            format!(
                "{} messages are missing: it dropped them for want of room, or they were made by another gateway.",
                live.lost
            ),
        );
    }
    let Some(condition) = &live.condition else {
        return;
    };
    if condition.state == "faulted" {
        causes.insert(
            AlarmKind::Faulted,
            format!("Its guard is faulted: {}.", condition.reasons.join("; ")),
        );
    }
    let broken: Vec<&str> = (condition.temperatures_degc.iter())
        .filter(|(_, degc)| degc.is_none())
        .map(|(name, _)| name.as_str())
        .collect();
    if !broken.is_empty() {
        causes.insert(
            AlarmKind::Sensor,
            format!("Temperatures are not used: {}.", broken.join(", ")),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_suspect_is_told_only_the_ways_that_there_are() {
        let name = "mill-1".parse().expect("a name");
        let mut suspect = Suspect {
            rollout: 3,
            what: "was ended by anna before it was done".to_owned(),
            may_go_on: false,
            has_way_back: true,
        };
        assert_eq!(
            suspect.in_words(&name),
            "It corrects with the model of roll-out 3, which was ended by anna before it was done: `model back mill-1` brings back the one before; `rollout keep 3 mill-1` says that the model shall stay."
        );
        suspect.may_go_on = true;
        assert!(
            suspect
                .in_words(&name)
                .contains("after `rollout stop 3` `model back mill-1`")
        );
        suspect.has_way_back = false;
        let told = suspect.in_words(&name);
        assert!(!told.contains("model back"), "{told}");
        assert!(told.contains("`machine disable mill-1`"), "{told}");
    }
}
