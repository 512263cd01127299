//! A roll-out as a pure state machine: what happened goes in, what is to be done comes out.
//!
//! The first machines (canaries) get the model, must activate it, and are watched for the time of the soak; then the others,
//! wave by wave. It stops by itself where a machine refuses the model, its guard faults, its residual rises, or too many stay
//! out; then a person decides. Time is counted while the centre watches: a clock that jumps and a centre that was down
//! shorten no soak. Every state is plain data, so a centre that is started again goes on from what it has stored.

mod course;

use std::{collections::BTreeMap, fmt::Display, ops::RangeInclusive};

use serde::{Deserialize, Serialize};
use volcomp_fleet::{MachineId, Outcome};

/// By what rules a roll-out goes on and stops.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rules {
    /// After the canaries: how many percent of the others have had their turn at the end of each wave, rising to 100.
    pub waves: Vec<u32>,
    /// A machine that has activated the model is watched for so long before its turn is done, s.
    pub soak_s: f64,
    /// A machine that has not answered after so long stays out, s.
    pub answer_s: f64,
    /// So many machines after the canaries may stay out before the roll-out stops.
    pub tolerate: u32,
    /// It stops where the residual is above this many times what it was before, …
    pub residual_ratio: f64,
    /// … and above what it was before by this, µm.
    pub residual_um: f64,
}

impl Default for Rules {
    /// A quarter, then all; ten minutes of watching, five for an answer; none may stay out; half as much again and 2 µm.
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

    /// Whether a roll-out can go by these rules.
    ///
    /// # Errors
    /// The key of the first that is invalid, and what was found and expected.
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
    Running,
    Paused {
        by: String,
    },
    /// It stopped by itself.
    Stopped {
        /// What it stopped for, a sentence without its full stop.
        why: String,
    },
    /// A person has ended it.
    Aborted {
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

/// A roll-out of one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rollout {
    pub id: u64,
    pub model: String,
    pub by: String,
    /// When, s, for people.
    pub since_s: f64,
    pub rules: Rules,
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
        elapsed_s: f64,
        /// What it saw; a machine that is not in here is not heard.
        seen: BTreeMap<MachineId, Observation>,
    },
    Issued {
        machine: MachineId,
        version: u64,
        /// The residual before, µm.
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
    /// A person wishes something.
    Wished {
        wish: Wish,
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
