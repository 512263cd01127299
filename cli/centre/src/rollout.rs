//! A roll-out as a pure state machine: what happened goes in, what is to be done comes out.
//!
//! The first machines (canaries) get the model, must activate it, and are watched for the time of the soak; then the others,
//! wave by wave. It stops by itself where a machine refuses the model, its guard faults, its residual rises, or too many stay
//! out; then a person decides. Time is counted while the centre watches: a clock that jumps and a centre that was down
//! shorten no soak. Every state is plain data, so a centre that is started again goes on from what it has stored.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use volcomp_fleet::{MachineId, Outcome};

/// One look counts for no more than this, s: after a gap nothing is known of the time between.
const LONGEST_LOOK_S: f64 = 10.0;
/// A residual is judged after it was seen for so long, s.
const RESIDUAL_AFTER_S: f64 = 10.0;

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

/// Where the turn of one machine stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "step", rename_all = "kebab-case")]
pub enum Step {
    /// It has not been sent anything.
    Waiting,
    /// The manifest is under its key, and it has not answered.
    Sent {
        /// The version.
        version: u64,
        /// For so long, s.
        waited_s: f64,
    },
    /// A person must confirm the change.
    NeedsConfirmation {
        /// The version.
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
        /// The version.
        version: u64,
        /// It was watched for so long, s.
        soaked_s: f64,
        /// The mean residual in this time, µm.
        residual_um: f64,
        /// The residual was known for so long, s.
        known_s: f64,
    },
    /// It is in force, and nothing spoke against it.
    Done {
        /// The version.
        version: u64,
    },
    /// It is out: it did not answer, or something speaks against the model.
    Out {
        /// The version, where one was sent.
        version: Option<u64>,
        /// Why.
        why: String,
        /// Whether the roll-out must stop for it, however many may stay out.
        against: bool,
        /// Whether a person has let the roll-out go on in spite of it.
        excused: bool,
    },
}

impl Step {
    fn is_over(&self) -> bool {
        matches!(self, Self::Done { .. } | Self::Out { .. })
    }
}

/// The turn of one machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Turn {
    /// The machine.
    pub machine: MachineId,
    /// Its wave; 0: the canaries.
    pub wave: u32,
    /// The residual before, µm; `None`: not known, and then a rise is not seen.
    pub before_um: Option<f64>,
    /// Where it stands.
    #[serde(flatten)]
    pub step: Step,
}

/// How the whole stands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "kebab-case")]
pub enum Phase {
    /// It goes on.
    Running,
    /// A person holds it.
    Paused {
        /// Who.
        by: String,
    },
    /// It stopped by itself.
    Stopped {
        /// Why.
        why: String,
    },
    /// A person has ended it.
    Aborted {
        /// Who.
        by: String,
    },
    /// Every machine had its turn.
    Done,
}

impl Phase {
    /// Whether nothing will happen any more.
    pub fn is_over(&self) -> bool {
        matches!(self, Self::Aborted { .. } | Self::Done)
    }
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
    /// The rules.
    pub rules: Rules,
    /// How it stands.
    pub phase: Phase,
    /// The turns, by wave.
    pub turns: Vec<Turn>,
}

/// What is seen of a machine at one look.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// Whether it has been heard since the last look, or a little before.
    pub heard: bool,
    /// The version that is in force.
    pub version: u64,
    /// The guard is faulted, or was since the last look: why.
    pub faulted: Option<String>,
    /// The residual, µm.
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
        seen: BTreeMap<MachineId, Seen>,
    },
    /// A manifest was issued.
    Issued {
        /// For this machine.
        machine: MachineId,
        /// With this version.
        version: u64,
        /// The residual before, µm.
        before_um: Option<f64>,
    },
    /// A manifest cannot be issued.
    NotIssued {
        /// For this machine.
        machine: MachineId,
        /// Why.
        why: String,
    },
    /// A machine has answered.
    Answered {
        /// The machine.
        machine: MachineId,
        /// The version that it answers.
        version: u64,
        /// What became of it.
        outcome: Outcome,
    },
    /// A person wishes something.
    Wished {
        /// What.
        wish: Wish,
        /// Who.
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
    /// To confirm the change of one machine.
    Confirm {
        /// The machine.
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
        /// The machine.
        machine: MachineId,
        /// The hash that a person has confirmed.
        confirm: Option<String>,
    },
}

impl Rollout {
    /// A roll-out that begins: machines with whether each is a canary. Where none is, the first is one.
    pub fn new(
        id: u64,
        model: String,
        machines: &[(MachineId, bool)],
        rules: Rules,
        by: String,
        since_s: f64,
    ) -> Self {
        let any = machines.iter().any(|(_, canary)| *canary);
        let is_canary = |place: usize| machines[place].1 || (!any && place == 0);
        let others = (0..machines.len())
            .filter(|place| !is_canary(*place))
            .count() as u64;
        let mut turns = Vec::new();
        let mut rank = 0;
        for (place, (machine, _)) in machines.iter().enumerate() {
            let wave = if is_canary(place) {
                0
            } else {
                rank += 1;
                wave_of(&rules.waves, rank, others)
            };
            turns.push(Turn {
                machine: machine.clone(),
                wave,
                before_um: None,
                step: Step::Waiting,
            });
        }
        turns.sort_by_key(|turn| turn.wave);
        let phase = if turns.is_empty() {
            Phase::Done
        } else {
            Phase::Running
        };
        Self {
            id,
            model,
            by,
            since_s,
            rules,
            phase,
            turns,
        }
    }

    /// Takes what happened, and tells what is to be done.
    pub fn step(&mut self, event: Event) -> Vec<Action> {
        if self.phase.is_over() {
            return Vec::new();
        }
        match event {
            Event::Looked { elapsed_s, seen } => self.look(elapsed_s, &seen),
            Event::Issued {
                machine,
                version,
                before_um,
            } => {
                if let Some(turn) = self.turn(&machine) {
                    // A second manifest of the same turn (confirmed) is compared with what was before the first.
                    if turn.step == Step::Waiting {
                        turn.before_um = before_um;
                    }
                    turn.step = Step::Sent {
                        version,
                        waited_s: 0.0,
                    };
                }
                return Vec::new();
            }
            Event::NotIssued { machine, why } => {
                if let Some(turn) = self.turn(&machine) {
                    turn.step = out(None, why, true);
                }
            }
            Event::Answered {
                machine,
                version,
                outcome,
            } => self.answered(&machine, version, outcome),
            Event::Wished { wish, by } => {
                if let Some(action) = self.wished(wish, by) {
                    return vec![action];
                }
            }
        }
        self.judge();
        self.next()
    }

    /// Whether a machine has been sent nothing yet.
    pub fn is_waiting(&self, machine: &MachineId) -> bool {
        let mut turns = self.turns.iter();
        turns.any(|turn| turn.machine == *machine && turn.step == Step::Waiting)
    }

    fn turn(&mut self, machine: &MachineId) -> Option<&mut Turn> {
        self.turns.iter_mut().find(|turn| turn.machine == *machine)
    }

    fn look(&mut self, elapsed_s: f64, seen: &BTreeMap<MachineId, Seen>) {
        // Written so that a time which is no number counts for nothing.
        let elapsed_s = if elapsed_s > 0.0 {
            elapsed_s.min(LONGEST_LOOK_S)
        } else {
            0.0
        };
        let rules = &self.rules;
        for turn in &mut self.turns {
            let seen = seen.get(&turn.machine).filter(|seen| seen.heard);
            let before_um = turn.before_um;
            turn.step = match (std::mem::replace(&mut turn.step, Step::Waiting), seen) {
                (Step::Sent { version, .. }, Some(seen)) if seen.version >= version => {
                    soaking(version)
                }
                (Step::Sent { version, waited_s }, _) => {
                    let waited_s = waited_s + elapsed_s;
                    if waited_s > rules.answer_s {
                        out(Some(version), "it has not answered".to_owned(), false)
                    } else {
                        Step::Sent { version, waited_s }
                    }
                }
                // It came late, and nobody has asked for anything else.
                (
                    Step::Out {
                        version: Some(version),
                        against: false,
                        ..
                    },
                    Some(seen),
                ) if seen.version >= version => soaking(version),
                (
                    Step::Soaking {
                        version,
                        soaked_s,
                        residual_um,
                        known_s,
                    },
                    Some(seen),
                ) => {
                    let known = seen.residual_um.filter(|um| um.is_finite());
                    let (residual_um, known_s) = match known {
                        Some(um) if elapsed_s > 0.0 => {
                            let all_s = known_s + elapsed_s;
                            ((residual_um * known_s + um * elapsed_s) / all_s, all_s)
                        }
                        _ => (residual_um, known_s),
                    };
                    let soaked_s = soaked_s + elapsed_s;
                    let is_soaked = soaked_s >= rules.soak_s;
                    let judged = known_s >= RESIDUAL_AFTER_S || (is_soaked && known_s > 0.0);
                    if let Some(why) = &seen.faulted {
                        out(Some(version), format!("its guard has faulted: {why}"), true)
                    } else if let Some(before) = before_um.filter(|before| {
                        judged
                            && residual_um > before * rules.residual_ratio
                            && residual_um > before + rules.residual_um
                    }) {
                        let why = format!(
                            "its residual has risen from {before:.1} µm to {residual_um:.1} µm"
                        );
                        out(Some(version), why, true)
                    } else if is_soaked {
                        Step::Done { version }
                    } else {
                        Step::Soaking {
                            version,
                            soaked_s,
                            residual_um,
                            known_s,
                        }
                    }
                }
                (step, _) => step,
            };
        }
    }

    fn answered(&mut self, machine: &MachineId, answered: u64, outcome: Outcome) {
        let soak = self.rules.soak_s;
        let Some(turn) = self.turn(machine) else {
            return;
        };
        // What is in force or was never sent is not undone by an answer that comes twice.
        let (Step::Sent { version: sent, .. }
        | Step::NeedsConfirmation { version: sent, .. }
        | Step::Out {
            version: Some(sent),
            against: false,
            ..
        }) = turn.step
        else {
            return;
        };
        if answered < sent {
            return;
        }
        turn.step = match outcome {
            Outcome::Activated if soak <= 0.0 => Step::Done { version: answered },
            Outcome::Activated => soaking(answered),
            Outcome::NeedsConfirmation {
                hash,
                worst_um,
                worst_urad,
            } => Step::NeedsConfirmation {
                version: answered,
                hash,
                worst_um,
                worst_urad,
            },
            Outcome::Refused { why } => {
                out(Some(answered), format!("it has refused it: {why}"), true)
            }
        };
    }

    fn wished(&mut self, wish: Wish, by: String) -> Option<Action> {
        match wish {
            Wish::Pause => self.phase = Phase::Paused { by },
            Wish::Abort => self.phase = Phase::Aborted { by },
            Wish::Resume => {
                for turn in &mut self.turns {
                    if let Step::Out { excused, .. } = &mut turn.step {
                        *excused = true;
                    }
                }
                self.phase = Phase::Running;
            }
            Wish::Confirm { machine, hash } => {
                let turn = self.turn(&machine)?;
                if matches!(&turn.step, Step::NeedsConfirmation { hash: shown, .. } if *shown == hash)
                {
                    return Some(Action::Issue {
                        machine,
                        confirm: Some(hash),
                    });
                }
            }
        }
        None
    }

    /// Stops where something speaks against going on.
    fn judge(&mut self) {
        if !matches!(self.phase, Phase::Running | Phase::Paused { .. }) {
            return;
        }
        let mut stayed_out = 0;
        for turn in &self.turns {
            let Step::Out {
                why,
                against,
                excused: false,
                ..
            } = &turn.step
            else {
                continue;
            };
            stayed_out += 1;
            if *against || turn.wave == 0 || stayed_out > self.rules.tolerate {
                self.phase = Phase::Stopped {
                    why: format!("{}: {why}", turn.machine),
                };
                return;
            }
        }
        if self.turns.iter().all(|turn| turn.step.is_over()) {
            self.phase = Phase::Done;
        }
    }

    /// The machines whose turn it is and that have been sent nothing.
    fn next(&self) -> Vec<Action> {
        if self.phase != Phase::Running {
            return Vec::new();
        }
        let unfinished = self.turns.iter().filter(|turn| !turn.step.is_over());
        let Some(wave) = unfinished.map(|turn| turn.wave).min() else {
            return Vec::new();
        };
        let waiting = self.turns.iter();
        waiting
            .filter(|turn| turn.wave == wave && turn.step == Step::Waiting)
            .map(|turn| Action::Issue {
                machine: turn.machine.clone(),
                confirm: None,
            })
            .collect()
    }
}

fn soaking(version: u64) -> Step {
    Step::Soaking {
        version,
        soaked_s: 0.0,
        residual_um: 0.0,
        known_s: 0.0,
    }
}

fn out(version: Option<u64>, why: String, against: bool) -> Step {
    Step::Out {
        version,
        why,
        against,
        excused: false,
    }
}

/// The wave of the machine of this rank (from 1) among so many: the first that reaches its share; what no wave reaches is
/// in one more.
fn wave_of(percent: &[u32], rank: u64, of: u64) -> u32 {
    let reached = percent
        .iter()
        .position(|percent| rank * 100 <= u64::from(*percent).saturating_mul(of));
    u32::try_from(reached.unwrap_or(percent.len()) + 1).unwrap_or(u32::MAX)
}
