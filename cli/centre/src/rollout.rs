//! A roll-out as a pure state machine: events go in, actions come out.
//!
//! The canaries receive the model first, must activate it, and are observed for the soak time. Then the other machines
//! follow in waves. The roll-out stops if a machine rejects the model, its guard faults, its residual rises, or too
//! many machines drop out. After a stop the user decides.
//!
//! Time counts only while the centre is running, so clock jumps and downtime do not shorten the soak. Every state is
//! plain data, so a restarted centre continues from the store.

use std::{collections::BTreeMap, fmt::Display, ops::RangeInclusive};

use serde::{Deserialize, Serialize};
use volcomp_fleet::{MachineId, Outcome};

/// Maximum time credited per pass, s: the state during a longer gap is unknown.
const MAX_ELAPSED_S: f64 = 10.0;
/// Time for which a residual must be known before the stop rules apply to it, s.
const RESIDUAL_AFTER_S: f64 = 10.0;

/// Rules for advancing and stopping a roll-out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rules {
    /// Cumulative percentages of the machines after the canaries at the end of each wave, ascending to 100.
    pub waves: Vec<u32>,
    /// Observation time of a machine after it activated the model, s.
    pub soak_s: f64,
    /// Timeout for a machine's outcome, s. A machine that exceeds it drops out.
    pub answer_s: f64,
    /// Maximum number of machines after the canaries that may drop out before the roll-out stops.
    pub tolerate: u32,
    /// Ratio of a machine's residual to its earlier residual above which the roll-out stops, if `residual_um` is
    /// exceeded too.
    pub residual_ratio: f64,
    /// Increase of a machine's residual, µm, above which the roll-out stops, if `residual_ratio` is exceeded too.
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
    pub const WAVES: &'static str = "percentages from 1, ascending to 100, such as [25, 100]";

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
        within("residual_ratio", &self.residual_ratio, &Self::RESIDUAL_RATIO)?;
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

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "step", rename_all = "kebab-case")]
pub enum Step {
    Waiting,
    /// The manifest is under the machine's key; its outcome is pending.
    Sent {
        version: u64,
        /// Waiting time so far, s.
        waited_s: f64,
    },
    NeedsConfirmation {
        version: u64,
        hash: String,
        /// Largest change of a linear axis, µm, as reported by the machine.
        worst_um: String,
        /// Largest change of a rotary axis, µrad, as reported by the machine.
        worst_urad: String,
        /// Signs that the model belongs to another machine, as reported by the machine.
        #[serde(default)]
        differences: Vec<String>,
    },
    Soaking {
        version: u64,
        /// Observation time so far, s.
        soaked_s: f64,
        /// Mean residual during the observation, µm.
        residual_um: f64,
        /// Time for which the residual was known, s.
        known_s: f64,
        /// Time for which the machine has been reporting an older version as active, s.
        #[serde(default)]
        older_s: f64,
        /// Time without compensation, s; the soak time stops meanwhile.
        #[serde(default)]
        idle_s: f64,
    },
    /// The model is active, and its observation found no problem.
    Done {
        version: u64,
    },
    /// The machine dropped out: it did not respond, or it reported a problem with the model.
    Out {
        /// Version that was sent; `None` if no version was sent, or the version was withdrawn.
        version: Option<u64>,
        /// Reason, a sentence without its full stop.
        why: String,
        /// True if this dropout stops the roll-out, regardless of the number of tolerated dropouts.
        against: bool,
        /// True if the user resumed the roll-out despite this dropout.
        excused: bool,
    },
}

impl Step {
    pub fn is_new_outcome(&self, answered: u64, outcome: &Outcome) -> bool {
        match self {
            Self::Sent { version, .. } => answered >= *version,
            Self::NeedsConfirmation { version, .. } => {
                answered > *version
                    || (answered == *version
                        && !matches!(outcome, Outcome::NeedsConfirmation { .. }))
            }
            // A late activation is detected from the reported version.
            Self::Out { version: Some(version), against: false, .. } => {
                answered >= *version && *outcome != Outcome::Activated
            }
            Self::Waiting | Self::Soaking { .. } | Self::Done { .. } | Self::Out { .. } => false,
        }
    }

    fn is_over(&self) -> bool {
        matches!(self, Self::Done { .. } | Self::Out { .. })
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Target {
    pub machine: MachineId,
    /// Wave number; 0: the canaries.
    pub wave: u32,
    /// Residual before the change, µm. If it is `None` (unknown), a rise is not detected.
    pub before_um: Option<f64>,
    #[serde(flatten)]
    pub step: Step,
    /// User who decided that the machine keeps the model although the roll-out was not completed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept_by: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "kebab-case")]
pub enum Phase {
    Running,
    Paused {
        by: String,
    },
    Stopped {
        /// Reason, a sentence without its full stop.
        why: String,
    },
    Aborted {
        by: String,
    },
    Done,
}

impl Phase {
    /// True if the roll-out stopped or was aborted before all machines were done, so that its model has not been
    /// validated.
    pub fn is_broken_off(&self) -> bool {
        matches!(self, Self::Stopped { .. } | Self::Aborted { .. })
    }

    /// True if the roll-out still sends a change that the user confirms now.
    pub fn takes_confirmations(&self) -> bool {
        matches!(self, Self::Running | Self::Paused { .. })
    }

    /// True if the roll-out will not change any more.
    pub fn is_over(&self) -> bool {
        matches!(self, Self::Aborted { .. } | Self::Done)
    }
}

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
    /// True if the model of the roll-out was not validated and no user has decided that this machine keeps it.
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
            return Err(format!("roll-out {id} is over and sends nothing"));
        }
        if !self.phase.takes_confirmations() {
            return Err(format!(
                "roll-out {id} has stopped and sends nothing: resume it with `rollout resume {id}`, then confirm the change"
            ));
        }
        let mut targets = self.targets.iter();
        let target = targets.find(|target| target.machine == *machine);
        match target.map(|target| &target.step) {
            None => Err(format!("{machine} is not a machine of roll-out {id}")),
            Some(Step::NeedsConfirmation { hash: shown, .. }) if shown == hash => Ok(()),
            Some(Step::NeedsConfirmation { hash: shown, .. }) => Err(format!(
                "found the hash {hash}, expected {shown}: the hash of the pending change of {machine}"
            )),
            Some(_) => Err(format!("{machine} has no pending change in roll-out {id}")),
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observation {
    /// True if a condition was received recently.
    pub reachable: bool,
    pub version: u64,
    /// Checksum of the active model.
    pub model: String,
    /// True if the machine is compensating. Without a correction the model cannot be judged.
    pub corrects: bool,
    /// Reason, if the guard is faulted or has been since the last pass.
    pub faulted: Option<String>,
    /// Residual error while the machine compensates, µm.
    pub residual_um: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A pass of the centre.
    Pass {
        elapsed_s: f64,
        /// Machines not included are treated as silent.
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
    Requested {
        request: UserRequest,
        by: String,
    },
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "wish", rename_all = "kebab-case")]
pub enum UserRequest {
    /// Pause: nothing more is sent.
    Pause,
    /// Continue in spite of the reason for the stop.
    Resume,
    /// Abort: nothing more is sent; machines keep their active versions.
    Abort,
    /// Confirm the change of one machine; a stopped roll-out does not send it.
    Confirm {
        machine: MachineId,
        /// The hash that was shown to the user.
        hash: String,
    },
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Issue the model for a machine and report [`Event::Issued`] or [`Event::NotIssued`].
    Issue {
        machine: MachineId,
        /// Hash of the change that the operator has confirmed.
        confirm: Option<String>,
    },
    /// Withdraw the version sent to a machine that has not activated it, so that the machine does not accept it when it
    /// reconnects. The key receives its previous value.
    Withdraw { machine: MachineId },
}

impl Rollout {
    /// A roll-out of the model with this checksum. `machines` states for each machine whether it is a canary; without a canary the first machine
    /// becomes one. `since_s` is for display, s since 1970.
    pub fn new(
        id: u64,
        model: &str,
        machines: &[(MachineId, bool)],
        rules: Rules,
        by: &str,
        since_s: f64,
    ) -> Self {
        let any = machines.iter().any(|(_, canary)| *canary);
        let is_canary = |place: usize| machines[place].1 || (!any && place == 0);
        let others = (0..machines.len()).filter(|place| !is_canary(*place)).count() as u64;
        let mut targets = Vec::new();
        let mut rank = 0;
        for (place, (machine, _)) in machines.iter().enumerate() {
            let wave = if is_canary(place) {
                0
            } else {
                rank += 1;
                wave_of(&rules.waves, rank, others)
            };
            targets.push(Target {
                machine: machine.clone(),
                wave,
                before_um: None,
                step: Step::Waiting,
                kept_by: None,
            });
        }
        targets.sort_by_key(|target| target.wave);
        let phase = if targets.is_empty() { Phase::Done } else { Phase::Running };
        Self { id, model: model.to_owned(), by: by.to_owned(), since_s, rules, phase, targets }
    }

    pub fn step(&mut self, event: Event) -> Vec<Action> {
        if self.phase.is_over() {
            return Vec::new();
        }
        let (was_broken_off, actions) = (self.phase.is_broken_off(), self.apply(event));
        if self.phase.is_over() || (self.phase.is_broken_off() && !was_broken_off) {
            return self.withdraw();
        }
        actions
    }

    fn apply(&mut self, event: Event) -> Vec<Action> {
        match event {
            Event::Pass { elapsed_s, seen } => self.observe(elapsed_s, &seen),
            Event::Issued { machine, version, before_um } => {
                if let Some(target) = self.target(&machine) {
                    // A second manifest for the same target (after confirmation) keeps the residual before the first
                    // one for comparison.
                    if target.step == Step::Waiting {
                        target.before_um = before_um;
                    }
                    target.step = Step::Sent { version, waited_s: 0.0 };
                }
                return Vec::new();
            }
            Event::NotIssued { machine, why } => {
                if let Some(target) = self.target(&machine) {
                    target.step = dropped_out(None, why, true);
                }
            }
            Event::Answered { machine, version, outcome } => {
                self.apply_outcome(&machine, version, outcome);
            }
            Event::Requested { request, by } => {
                if let Some(action) = self.apply_request(request, by) {
                    return vec![action];
                }
            }
        }
        self.check_stop_rules();
        self.next_issues()
    }

    pub fn is_waiting(&self, machine: &MachineId) -> bool {
        let mut targets = self.targets.iter();
        targets.any(|target| target.machine == *machine && target.step == Step::Waiting)
    }

    fn target(&mut self, machine: &MachineId) -> Option<&mut Target> {
        self.targets.iter_mut().find(|target| target.machine == *machine)
    }

    fn observe(&mut self, elapsed_s: f64, seen: &BTreeMap<MachineId, Observation>) {
        // This form treats a NaN as zero.
        let elapsed_s = if elapsed_s > 0.0 { elapsed_s.min(MAX_ELAPSED_S) } else { 0.0 };
        let rules = &self.rules;
        for target in &mut self.targets {
            let seen = seen.get(&target.machine).filter(|seen| seen.reachable);
            target.step = match (std::mem::replace(&mut target.step, Step::Waiting), seen) {
                (Step::Sent { version, .. }, Some(seen)) if seen.version >= version => {
                    soaking(version)
                }
                (Step::Sent { version, waited_s }, _) => {
                    let waited_s = waited_s + elapsed_s;
                    if waited_s > rules.answer_s {
                        dropped_out(Some(version), "no answer in time".to_owned(), false)
                    } else {
                        Step::Sent { version, waited_s }
                    }
                }
                // The machine activated the version after its timeout; no other version was sent since.
                (Step::Out { version: Some(version), against: false, .. }, Some(seen))
                    if seen.version >= version =>
                {
                    soaking(version)
                }
                (step @ Step::Soaking { .. }, Some(seen)) => {
                    advance_soak(step, seen, elapsed_s, rules, target.before_um)
                }
                // The soak time of the machine is over, but a fault still counts until the roll-out ends.
                (
                    Step::Done { version },
                    Some(Observation { version: seen, faulted: Some(why), .. }),
                ) if *seen >= version => faulted(version, why),
                (step, _) => step,
            };
        }
    }

    fn apply_outcome(&mut self, machine: &MachineId, answered: u64, outcome: Outcome) {
        let soak = self.rules.soak_s;
        let Some(target) = self.target(machine) else {
            return;
        };
        // Duplicate outcomes do not change a target whose version is active or was never sent.
        let (Step::Sent { version: sent, .. }
        | Step::NeedsConfirmation { version: sent, .. }
        | Step::Out { version: Some(sent), against: false, .. }) = target.step
        else {
            return;
        };
        if answered < sent {
            return;
        }
        target.step = match outcome {
            Outcome::Activated if soak <= 0.0 => Step::Done { version: answered },
            Outcome::Activated => soaking(answered),
            Outcome::NeedsConfirmation { hash, worst_um, worst_urad, differences } => {
                Step::NeedsConfirmation {
                    version: answered,
                    hash,
                    worst_um,
                    worst_urad,
                    differences,
                }
            }
            Outcome::Refused { why } => {
                dropped_out(Some(answered), format!("it has rejected the model: {why}"), true)
            }
        };
    }

    fn apply_request(&mut self, request: UserRequest, by: String) -> Option<Action> {
        match request {
            UserRequest::Pause => self.phase = Phase::Paused { by },
            UserRequest::Abort => self.phase = Phase::Aborted { by },
            UserRequest::Resume => {
                for target in &mut self.targets {
                    // The user's decision applied to the previous stop; a new stop requires a new decision.
                    target.kept_by = None;
                    if let Step::Out { excused, .. } = &mut target.step {
                        *excused = true;
                    }
                }
                self.phase = Phase::Running;
            }
            UserRequest::Confirm { machine, hash } => {
                // A version sent after a stop would not be withdrawn.
                if !self.phase.takes_confirmations() {
                    return None;
                }
                let target = self.target(&machine)?;
                if matches!(&target.step, Step::NeedsConfirmation { hash: shown, .. } if *shown == hash)
                {
                    return Some(Action::Issue { machine, confirm: Some(hash) });
                }
            }
        }
        None
    }

    /// Withdraws versions that were sent but are not active, so that a machine that was offline does not accept a
    /// stopped model when it reconnects. Versions that were rejected or wait for confirmation are withdrawn once the
    /// roll-out can no longer be resumed.
    fn withdraw(&mut self) -> Vec<Action> {
        let ended = matches!(self.phase, Phase::Aborted { .. });
        let mut actions = Vec::new();
        if self.phase == Phase::Done {
            return actions;
        }
        for target in &mut self.targets {
            match &mut target.step {
                Step::Sent { .. } => target.step = Step::Waiting,
                Step::NeedsConfirmation { .. } if ended => target.step = Step::Waiting,
                Step::Out { version: version @ Some(_), against: false, .. } => *version = None,
                Step::Out { version: Some(_), .. } if ended => {}
                _ => continue,
            }
            actions.push(Action::Withdraw { machine: target.machine.clone() });
        }
        actions
    }

    fn check_stop_rules(&mut self) {
        if !matches!(self.phase, Phase::Running | Phase::Paused { .. }) {
            return;
        }
        let mut stayed_out = 0;
        for target in &self.targets {
            let Step::Out { why, against, excused: false, .. } = &target.step else {
                continue;
            };
            stayed_out += 1;
            if *against || target.wave == 0 || stayed_out > self.rules.tolerate {
                self.phase = Phase::Stopped { why: format!("{}: {why}", target.machine) };
                return;
            }
        }
        if self.targets.iter().all(|target| target.step.is_over()) {
            self.phase = Phase::Done;
        }
    }

    fn next_issues(&self) -> Vec<Action> {
        if self.phase != Phase::Running {
            return Vec::new();
        }
        let unfinished = self.targets.iter().filter(|target| !target.step.is_over());
        let Some(wave) = unfinished.map(|target| target.wave).min() else {
            return Vec::new();
        };
        let waiting = self.targets.iter();
        waiting
            .filter(|target| target.wave == wave && target.step == Step::Waiting)
            .map(|target| Action::Issue { machine: target.machine.clone(), confirm: None })
            .collect()
    }
}

/// Advances the observation of a machine with the model by one pass.
fn advance_soak(
    step: Step,
    seen: &Observation,
    elapsed_s: f64,
    rules: &Rules,
    before_um: Option<f64>,
) -> Step {
    let Step::Soaking { version, soaked_s, residual_um, known_s, older_s, idle_s } = step else {
        return step;
    };
    let unchanged = |older_s, idle_s| Step::Soaking {
        version,
        soaked_s,
        residual_um,
        known_s,
        older_s,
        idle_s,
    };
    if let Some(why) = &seen.faulted {
        return faulted(version, why);
    }
    // The outcome may arrive before the condition with the new version. A machine that keeps reporting an older version (its folder was restored,
    // or its gateway was replaced) is not being observed with the model.
    if seen.version < version {
        let older_s = older_s + elapsed_s;
        if older_s > rules.answer_s {
            let why = "its model is not active any more".to_owned();
            return dropped_out(Some(version), why, false);
        }
        return unchanged(older_s, idle_s);
    }
    if !seen.corrects {
        return unchanged(0.0, idle_s + elapsed_s);
    }
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
    let risen = before_um.filter(|before| {
        judged
            && residual_um > before * rules.residual_ratio
            && residual_um > before + rules.residual_um
    });
    if let Some(before) = risen {
        let why = format!("its residual has risen from {before:.1} µm to {residual_um:.1} µm");
        dropped_out(Some(version), why, true)
    } else if is_soaked {
        Step::Done { version }
    } else {
        Step::Soaking { version, soaked_s, residual_um, known_s, older_s: 0.0, idle_s: 0.0 }
    }
}

fn faulted(version: u64, why: &str) -> Step {
    dropped_out(Some(version), format!("its guard has faulted: {why}"), true)
}

fn soaking(version: u64) -> Step {
    Step::Soaking {
        version,
        soaked_s: 0.0,
        residual_um: 0.0,
        known_s: 0.0,
        older_s: 0.0,
        idle_s: 0.0,
    }
}

fn dropped_out(version: Option<u64>, why: String, against: bool) -> Step {
    Step::Out { version, why, against, excused: false }
}

/// Wave of the machine with this rank (from 1) among `of` machines: the first wave whose cumulative percentage includes it. Machines beyond all waves
/// form one more wave.
fn wave_of(percent: &[u32], rank: u64, of: u64) -> u32 {
    let reached =
        percent.iter().position(|percent| rank * 100 <= u64::from(*percent).saturating_mul(of));
    u32::try_from(reached.unwrap_or(percent.len()) + 1).unwrap_or(u32::MAX)
}
