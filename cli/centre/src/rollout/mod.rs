//! A roll-out as a pure state machine: events go in, actions come out.
//!
//! The canaries receive the model first, must activate it, and are observed for the soak time; then the other machines follow in waves. The
//! roll-out stops automatically if a machine rejects the model, its guard faults, its residual rises, or too many machines drop out; then the user
//! decides. Time counts only while the centre is running: clock jumps and downtime do not shorten the soak. Every state is plain data, so a
//! restarted centre continues from the store.

mod course;

use std::{collections::BTreeMap, fmt::Display, ops::RangeInclusive};

use serde::{Deserialize, Serialize};
use volcomp_fleet::{MachineId, Outcome};

/// Rules for advancing and stopping a roll-out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rules {
    /// After the canaries: cumulative percentage of the other machines at the end of each wave, ascending to 100.
    pub waves: Vec<u32>,
    /// Observation time of a machine after it activated the model, s.
    pub soak_s: f64,
    /// Timeout for a machine's outcome, s; after it the machine drops out.
    pub answer_s: f64,
    /// Maximum number of machines after the canaries that may drop out before the roll-out stops.
    pub tolerate: u32,
    /// The roll-out stops if the residual exceeds its earlier value by this factor, …
    pub residual_ratio: f64,
    /// … and by this amount, µm.
    pub residual_um: f64,
}

impl Default for Rules {
    /// Waves of 25 % and 100 %, 10 min soak, 5 min timeout, no dropouts, residual limits of factor 1.5 and 2 µm.
    fn default() -> Self {
        Self {
            waves: vec![25, 100],
            soak_s: 600.0,
            answer_s: 300.0,
            tolerate: 0,
            residual_ratio: 1.5,
            residual_um: 2.0,
        }
    }
}

impl Rules {
    pub const SOAK_S: RangeInclusive<f64> = 0.0..=1e7;
    pub const ANSWER_S: RangeInclusive<f64> = 1.0..=1e7;
    pub const TOLERATE: RangeInclusive<u32> = 0..=1_000_000;
    pub const RESIDUAL_RATIO: RangeInclusive<f64> = 1.0..=1e3;
    pub const RESIDUAL_UM: RangeInclusive<f64> = 0.0..=1e4;
    pub const WAVES: &'static str = "percentages from 1 on that rise to 100, such as [25, 100]";

    pub fn are_waves(waves: &[u32]) -> bool {
        let rises = waves.windows(2).all(|two| two[0] < two[1]);
        rises && waves.first().is_some_and(|first| *first > 0) && waves.last() == Some(&100)
    }

    /// Validates the rules.
    ///
    /// # Errors
    /// The key of the first invalid rule, and what was found and expected.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        if !Self::are_waves(&self.waves) {
            let why = format!("found {:?}, expected {}", self.waves, Self::WAVES);
            return Err(("waves", why));
        }
        within("soak_s", &self.soak_s, &Self::SOAK_S)?;
        within("answer_s", &self.answer_s, &Self::ANSWER_S)?;
        within("tolerate", &self.tolerate, &Self::TOLERATE)?;
        within(
            "residual_ratio",
            &self.residual_ratio,
            &Self::RESIDUAL_RATIO,
        )?;
        within("residual_um", &self.residual_um, &Self::RESIDUAL_UM)
    }
}

fn within<N: PartialOrd + Display>(
    key: &'static str,
    found: &N,
    range: &RangeInclusive<N>,
) -> Result<(), (&'static str, String)> {
    if range.contains(found) {
        return Ok(());
    }
    let (start, end) = (range.start(), range.end());
    Err((key, format!("found {found}, expected {start} to {end}")))
}

/// Progress of a target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "step", rename_all = "kebab-case")]
pub enum Step {
    /// Nothing has been sent to it.
    Waiting,
    /// The manifest is under its key; its outcome is pending.
    Sent {
        version: u64,
        /// Waiting time so far, s.
        waited_s: f64,
    },
    /// The operator must confirm the change.
    NeedsConfirmation {
        version: u64,
        hash: String,
        /// Largest change of a linear axis, µm, as reported by the machine.
        worst_um: String,
        /// Largest change of a rotary axis, µrad, as reported by the machine.
        worst_urad: String,
    },
    /// The model is active and under observation.
    Soaking {
        version: u64,
        /// Observation time so far, s.
        soaked_s: f64,
        /// Mean residual during the observation, µm.
        residual_um: f64,
        /// Time for which the residual was known, s.
        known_s: f64,
        /// Time for which it has been reporting an older version as active, s.
        #[serde(default)]
        older_s: f64,
        /// Time without compensation, s; the soak time does not advance meanwhile.
        #[serde(default)]
        idle_s: f64,
    },
    /// The model is active, and its observation found no problem.
    Done { version: u64 },
    /// Dropped out: it did not respond, or it showed a problem with the model.
    Out {
        /// Version that was sent and not withdrawn since.
        version: Option<u64>,
        /// Reason, a sentence without its full stop.
        why: String,
        /// True if the roll-out must stop because of it, whatever the number of tolerated dropouts.
        against: bool,
        /// True if the user resumed the roll-out in spite of it.
        excused: bool,
    },
}

impl Step {
    /// True if this outcome of this version is new.
    pub fn waits_for(&self, answered: u64, outcome: &Outcome) -> bool {
        match self {
            Self::Sent { version, .. } => answered >= *version,
            Self::NeedsConfirmation { version, .. } => {
                answered > *version
                    || (answered == *version
                        && !matches!(outcome, Outcome::NeedsConfirmation { .. }))
            }
            // A late activation is detected from the reported version.
            Self::Out {
                version: Some(version),
                against: false,
                ..
            } => answered >= *version && *outcome != Outcome::Activated,
            Self::Waiting | Self::Soaking { .. } | Self::Done { .. } | Self::Out { .. } => false,
        }
    }

    fn is_over(&self) -> bool {
        matches!(self, Self::Done { .. } | Self::Out { .. })
    }
}

/// Target of a roll-out: one machine that receives the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Target {
    pub machine: MachineId,
    /// Wave number; 0: the canaries.
    pub wave: u32,
    /// Residual before the change, µm; `None` if unknown: then a rise is not detected.
    pub before_um: Option<f64>,
    #[serde(flatten)]
    pub step: Step,
    /// User who decided that it keeps the model although the roll-out was not completed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept_by: Option<String>,
}

/// Overall state of a roll-out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "kebab-case")]
pub enum Phase {
    Running,
    Paused {
        by: String,
    },
    /// It stopped automatically.
    Stopped {
        /// Reason, a sentence without its full stop.
        why: String,
    },
    /// The user ended it.
    Aborted {
        by: String,
    },
    /// All machines are done.
    Done,
}

impl Phase {
    /// True if it stopped or was aborted before all machines were done: its model has not been validated.
    pub fn is_broken_off(&self) -> bool {
        matches!(self, Self::Stopped { .. } | Self::Aborted { .. })
    }

    /// True if a confirmed change is still sent.
    pub fn takes_confirmations(&self) -> bool {
        matches!(self, Self::Running | Self::Paused { .. })
    }

    /// True if nothing will change any more.
    pub fn is_over(&self) -> bool {
        matches!(self, Self::Aborted { .. } | Self::Done)
    }
}

/// A roll-out of one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rollout {
    pub id: u64,
    pub model: String,
    pub by: String,
    /// Start time, s, for display.
    pub since_s: f64,
    pub rules: Rules,
    pub phase: Phase,
    /// The target machines, by wave.
    #[serde(rename = "turns")]
    pub targets: Vec<Target>,
}

impl Rollout {
    /// True if its model was not validated and no user has decided that this machine keeps it.
    pub fn is_suspect_on(&self, machine: &MachineId) -> bool {
        let mut targets = self.targets.iter();
        let is_kept = targets.any(|target| target.machine == *machine && target.kept_by.is_some());
        self.phase.is_broken_off() && !is_kept
    }

    /// Checks that the user can confirm this change of a machine now. `is_ending`: an abort was requested but not yet processed.
    ///
    /// # Errors
    /// The reason, and what to do.
    pub fn may_confirm(
        &self,
        machine: &MachineId,
        hash: &str,
        is_ending: bool,
    ) -> Result<(), String> {
        let id = self.id;
        if self.phase.is_over() || is_ending {
            return Err(format!("roll-out {id} is over, and nothing more is sent"));
        }
        if !self.phase.takes_confirmations() {
            return Err(format!(
                "roll-out {id} has stopped, and sends nothing: `rollout resume {id}` lets it go on in spite of what it stopped for, and the change can be confirmed then"
            ));
        }
        let mut targets = self.targets.iter();
        let target = targets.find(|target| target.machine == *machine);
        match target.map(|target| &target.step) {
            None => Err(format!("{machine} has no turn in roll-out {id}")),
            Some(Step::NeedsConfirmation { hash: shown, .. }) if shown == hash => Ok(()),
            Some(Step::NeedsConfirmation { hash: shown, .. }) => Err(format!(
                "found the hash {hash}, expected {shown}, that of the change of {machine} which waits for a confirmation"
            )),
            Some(_) => Err(format!(
                "{machine} has no change in roll-out {id} that waits for a confirmation"
            )),
        }
    }
}

/// Observation of a machine in one pass.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observation {
    /// True if a condition was received recently.
    pub heard: bool,
    /// The active version.
    pub version: u64,
    /// True if it is compensating: without a correction the model cannot be judged.
    pub corrects: bool,
    /// Reason, if the guard is faulted or was since the last pass.
    pub faulted: Option<String>,
    /// Residual during compensation, µm.
    pub residual_um: Option<f64>,
}

/// Input of the state machine.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A pass of the centre, `elapsed_s` after the previous one.
    Looked {
        elapsed_s: f64,
        /// Observations; machines not included count as silent.
        seen: BTreeMap<MachineId, Observation>,
    },
    Issued {
        machine: MachineId,
        version: u64,
        /// Residual before the change, µm.
        before_um: Option<f64>,
    },
    NotIssued {
        machine: MachineId,
        why: String,
    },
    Answered {
        machine: MachineId,
        version: u64,
        outcome: Outcome,
    },
    /// Request of a user.
    Wished {
        wish: Wish,
        by: String,
    },
}

/// A user's request for a roll-out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "wish", rename_all = "kebab-case")]
pub enum Wish {
    /// Pause: nothing more is sent.
    Pause,
    /// Continue in spite of the reason for the stop.
    Resume,
    /// Abort. Sent versions remain.
    Abort,
    /// Confirm the change of one machine; a stopped roll-out does not send it.
    Confirm {
        machine: MachineId,
        /// The hash that was shown to the user.
        hash: String,
    },
}

/// Output of the state machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Issue the model for a machine and report [`Event::Issued`] or [`Event::NotIssued`].
    Issue {
        machine: MachineId,
        /// Hash of the change that the operator has confirmed.
        confirm: Option<String>,
    },
    /// Restore the value under a machine's key from before this roll-out, unless the model is active there: the machine must not accept the sent
    /// version when it reconnects.
    Withdraw { machine: MachineId },
}
