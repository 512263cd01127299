//! A roll-out as a pure state machine: what happened goes in, what is to be done comes out.
//!
//! The first machines (canaries) get the model, must activate it, and are watched for the time of the soak; then the others,
//! wave by wave. It stops by itself where a machine refuses the model, its guard faults, its residual rises, or too many stay
//! out; then a person decides. Time is counted while the centre watches: a clock that jumps and a centre that was down
//! shorten no soak. Every state is plain data, so a centre that is started again goes on from what it has stored.

mod course;
mod rules;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use volcomp_fleet::{MachineId, Outcome};

pub use rules::{NoRules, Rules};

/// Where a target stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "step", rename_all = "kebab-case")]
pub enum Step {
    /// It has not been sent anything.
    Waiting,
    /// The manifest is under its key, and it has not answered.
    Sent {
        version: u64,
        /// For so long, s.
        waited_s: f64,
    },
    /// A person must confirm the change.
    NeedsConfirmation {
        version: u64,
        /// The hash to be confirmed.
        hash: String,
        /// The largest move of a linear axis, µm, as the machine tells it.
        worst_um: String,
        /// The largest move of a rotary axis, µrad, as the machine tells it.
        worst_urad: String,
    },
    /// It is in force, and watched.
    Soaking {
        version: u64,
        /// It was watched for so long, s.
        soaked_s: f64,
        /// The mean residual in this time, µm.
        residual_um: f64,
        /// The residual was known for so long, s.
        known_s: f64,
        /// It tells for so long that an older version is in force, s.
        #[serde(default)]
        older_s: f64,
        /// How long it has not compensated, s; the soak does not go on meanwhile.
        #[serde(default)]
        idle_s: f64,
    },
    /// It is in force, and nothing spoke against it.
    Done { version: u64 },
    /// It is out: it did not answer, or something speaks against the model.
    Out {
        /// The version, where one was sent and was not taken back since.
        version: Option<u64>,
        /// Why it is out, a sentence without its full stop.
        why: String,
        /// Whether the roll-out must stop for it, however many may stay out.
        against: bool,
        /// Whether a person has let the roll-out go on in spite of it.
        excused: bool,
    },
}

impl Step {
    /// Whether this answer to this version is one that is not known yet.
    pub fn waits_for(&self, answered: u64, outcome: &Outcome) -> bool {
        match self {
            Self::Sent { version, .. } => answered >= *version,
            Self::NeedsConfirmation { version, .. } => {
                answered > *version
                    || (answered == *version
                        && !matches!(outcome, Outcome::NeedsConfirmation { .. }))
            }
            // That it is in force after all is seen by what the machine runs.
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

/// A target of a roll-out: one machine that shall get the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Target {
    pub machine: MachineId,
    /// Its wave; 0: the canaries.
    pub wave: u32,
    /// The residual before, µm; `None`: not known, and then a rise is not seen.
    pub before_um: Option<f64>,
    /// Where it stands.
    #[serde(flatten)]
    pub step: Step,
    /// Who has decided that it keeps the model although the roll-out was not done.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept_by: Option<String>,
}

/// How the whole stands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "kebab-case")]
pub enum Phase {
    /// It goes on.
    Running,
    /// A person holds it.
    Paused {
        /// The name of the user who holds it.
        by: String,
    },
    /// It stopped by itself.
    Stopped {
        /// What it stopped for, a sentence without its full stop.
        why: String,
    },
    /// A person has ended it.
    Aborted {
        /// The name of the user who has ended it.
        by: String,
    },
    /// Every machine had its turn.
    Done,
}

impl Phase {
    /// Whether it stopped, or was ended, before every machine had its turn: whoever has its model has one that was not found
    /// good.
    pub fn is_broken_off(&self) -> bool {
        matches!(self, Self::Stopped { .. } | Self::Aborted { .. })
    }

    /// Whether a change is sent when a person confirms it: not where nothing more is sent.
    pub fn takes_confirmations(&self) -> bool {
        matches!(self, Self::Running | Self::Paused { .. })
    }

    /// Whether nothing will happen any more.
    pub fn is_over(&self) -> bool {
        matches!(self, Self::Aborted { .. } | Self::Done)
    }
}

/// What a roll-out begins with.
#[derive(Clone, Debug)]
pub struct NewRollout<'a> {
    /// The checksum of the model.
    pub model: String,
    /// The machines that shall get it, each with whether it is a canary.
    pub machines: &'a [(MachineId, bool)],
    /// The rules by which it goes on and stops.
    pub rules: Rules,
    /// The name of the user who starts it.
    pub by: String,
    /// When it is started, s since 1970, for people.
    pub since_s: f64,
}

/// A roll-out of one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rollout {
    /// Its number.
    pub id: u64,
    /// The checksum of the model.
    pub model: String,
    /// Who started it.
    pub by: String,
    /// When, s, for people.
    pub since_s: f64,
    pub rules: Rules,
    /// How it stands.
    pub phase: Phase,
    /// The machines that shall get it, by wave.
    #[serde(rename = "turns")]
    pub targets: Vec<Target>,
}

impl Rollout {
    /// Whether its model was not found good, and nobody has decided that this machine keeps it.
    pub fn is_suspect_on(&self, machine: &MachineId) -> bool {
        let mut targets = self.targets.iter();
        let is_kept = targets.any(|target| target.machine == *machine && target.kept_by.is_some());
        self.phase.is_broken_off() && !is_kept
    }

    /// Whether a person can confirm this change of a machine now. `is_ending`: somebody has ended the roll-out, which is not
    /// taken up yet.
    ///
    /// # Errors
    /// Why not, and what to do.
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

/// What is seen of a machine at one look.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observation {
    /// Whether it has been heard since the last look, or a little before.
    pub heard: bool,
    /// The version that is in force.
    pub version: u64,
    /// Whether it is compensating: without a correction the model shows nothing.
    pub corrects: bool,
    /// The guard is faulted, or was since the last look: why.
    pub faulted: Option<String>,
    /// The residual while it was compensating, µm.
    pub residual_um: Option<f64>,
}

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The centre has looked at the machines, `elapsed_s` after the last look.
    Looked {
        /// The time since the last look, s.
        elapsed_s: f64,
        /// What it saw; a machine that is not in here is not heard.
        seen: BTreeMap<MachineId, Observation>,
    },
    /// A manifest was issued.
    Issued {
        machine: MachineId,
        version: u64,
        /// The residual before, µm.
        before_um: Option<f64>,
    },
    /// A manifest cannot be issued.
    NotIssued {
        machine: MachineId,
        /// Why nothing was issued for it.
        why: String,
    },
    /// A machine has answered.
    Answered {
        machine: MachineId,
        /// The version that it answers.
        version: u64,
        /// What became of it.
        outcome: Outcome,
    },
    /// A person wishes something.
    Wished {
        wish: Wish,
        /// The name of the user who wishes it.
        by: String,
    },
}

/// What a person may wish of a roll-out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "wish", rename_all = "kebab-case")]
pub enum Wish {
    /// To hold it: nothing more is sent.
    Pause,
    /// To let it go on, in spite of what it stopped for.
    Resume,
    /// To end it. What was sent stays sent.
    Abort,
    /// To confirm the change of one machine; in a roll-out that has stopped it is not sent.
    Confirm {
        machine: MachineId,
        /// The hash that was shown.
        hash: String,
    },
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// To issue the model for a machine, and to tell [`Event::Issued`] or [`Event::NotIssued`].
    Issue {
        machine: MachineId,
        /// The hash that a person has confirmed.
        confirm: Option<String>,
    },
    /// To put under the key of a machine what stood there before this roll-out, unless the model is in force there: it was
    /// sent, and the machine shall not take it when it is back.
    Withdraw { machine: MachineId },
}
