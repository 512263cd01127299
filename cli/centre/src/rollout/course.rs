//! Transitions of a roll-out: how each event changes the targets, when the roll-out stops, and which machines come next.

use std::collections::BTreeMap;

use volcomp_fleet::{MachineId, Outcome};

use super::{Action, Event, Observation, Phase, Rollout, Rules, Step, Target, Wish};

/// Maximum time credited per poll, s: after a gap nothing is known of the time between.
const LONGEST_LOOK_S: f64 = 10.0;
/// Time for which a residual must have been observed before it is judged, s.
const RESIDUAL_AFTER_S: f64 = 10.0;

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
        let others = (0..machines.len())
            .filter(|place| !is_canary(*place))
            .count() as u64;
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
        let phase = if targets.is_empty() {
            Phase::Done
        } else {
            Phase::Running
        };
        Self {
            id,
            model: model.to_owned(),
            by: by.to_owned(),
            since_s,
            rules,
            phase,
            targets,
        }
    }

    /// Processes an event and returns the resulting actions.
    pub fn step(&mut self, event: Event) -> Vec<Action> {
        if self.phase.is_over() {
            return Vec::new();
        }
        let (was_broken_off, actions) = (self.phase.is_broken_off(), self.happened(event));
        if self.phase.is_over() || (self.phase.is_broken_off() && !was_broken_off) {
            return self.withdraw();
        }
        actions
    }

    fn happened(&mut self, event: Event) -> Vec<Action> {
        match event {
            Event::Looked { elapsed_s, seen } => self.look(elapsed_s, &seen),
            Event::Issued {
                machine,
                version,
                before_um,
            } => {
                if let Some(target) = self.target(&machine) {
                    // A second manifest for the same target (after confirmation) is compared with the residual before the first one.
                    if target.step == Step::Waiting {
                        target.before_um = before_um;
                    }
                    target.step = Step::Sent {
                        version,
                        waited_s: 0.0,
                    };
                }
                return Vec::new();
            }
            Event::NotIssued { machine, why } => {
                if let Some(target) = self.target(&machine) {
                    target.step = out(None, why, true);
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

    /// True if nothing has been sent to the machine yet.
    pub fn is_waiting(&self, machine: &MachineId) -> bool {
        let mut targets = self.targets.iter();
        targets.any(|target| target.machine == *machine && target.step == Step::Waiting)
    }

    fn target(&mut self, machine: &MachineId) -> Option<&mut Target> {
        self.targets
            .iter_mut()
            .find(|target| target.machine == *machine)
    }

    fn look(&mut self, elapsed_s: f64, seen: &BTreeMap<MachineId, Observation>) {
        // Written so that a NaN counts as zero.
        let elapsed_s = if elapsed_s > 0.0 {
            elapsed_s.min(LONGEST_LOOK_S)
        } else {
            0.0
        };
        let rules = &self.rules;
        for target in &mut self.targets {
            let seen = seen.get(&target.machine).filter(|seen| seen.heard);
            target.step = match (std::mem::replace(&mut target.step, Step::Waiting), seen) {
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
                // It was activated late; nothing else was sent since.
                (
                    Step::Out {
                        version: Some(version),
                        against: false,
                        ..
                    },
                    Some(seen),
                ) if seen.version >= version => soaking(version),
                (step @ Step::Soaking { .. }, Some(seen)) => {
                    watched(step, seen, elapsed_s, rules, target.before_um)
                }
                // Its soak time is over, but it has the model as long as the roll-out continues.
                (
                    Step::Done { version },
                    Some(Observation {
                        version: seen,
                        faulted: Some(why),
                        ..
                    }),
                ) if *seen >= version => faulted(version, why),
                (step, _) => step,
            };
        }
    }

    fn answered(&mut self, machine: &MachineId, answered: u64, outcome: Outcome) {
        let soak = self.rules.soak_s;
        let Some(target) = self.target(machine) else {
            return;
        };
        // Duplicate outcomes do not undo a version that is active or was never sent.
        let (Step::Sent { version: sent, .. }
        | Step::NeedsConfirmation { version: sent, .. }
        | Step::Out {
            version: Some(sent),
            against: false,
            ..
        }) = target.step
        else {
            return;
        };
        if answered < sent {
            return;
        }
        target.step = match outcome {
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
                for target in &mut self.targets {
                    // That decision applied to the stopped roll-out; if it stops again, it must be decided again.
                    target.kept_by = None;
                    if let Step::Out { excused, .. } = &mut target.step {
                        *excused = true;
                    }
                }
                self.phase = Phase::Running;
            }
            Wish::Confirm { machine, hash } => {
                // After a stop nothing would withdraw a sent version.
                if !self.phase.takes_confirmations() {
                    return None;
                }
                let target = self.target(&machine)?;
                if matches!(&target.step, Step::NeedsConfirmation { hash: shown, .. } if *shown == hash)
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

    /// Withdraws versions that were sent but are not active: a machine that was offline must not accept a stopped model on its return. Versions
    /// that wait for confirmation or were rejected are withdrawn once the roll-out can no longer be resumed.
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
                Step::Out {
                    version: version @ Some(_),
                    against: false,
                    ..
                } => *version = None,
                Step::Out {
                    version: Some(_), ..
                } if ended => {}
                _ => continue,
            }
            actions.push(Action::Withdraw {
                machine: target.machine.clone(),
            });
        }
        actions
    }

    /// Stops the roll-out if a stop rule applies.
    fn judge(&mut self) {
        if !matches!(self.phase, Phase::Running | Phase::Paused { .. }) {
            return;
        }
        let mut stayed_out = 0;
        for target in &self.targets {
            let Step::Out {
                why,
                against,
                excused: false,
                ..
            } = &target.step
            else {
                continue;
            };
            stayed_out += 1;
            if *against || target.wave == 0 || stayed_out > self.rules.tolerate {
                self.phase = Phase::Stopped {
                    why: format!("{}: {why}", target.machine),
                };
                return;
            }
        }
        if self.targets.iter().all(|target| target.step.is_over()) {
            self.phase = Phase::Done;
        }
    }

    /// Issue actions for waiting machines of the current wave.
    fn next(&self) -> Vec<Action> {
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
            .map(|target| Action::Issue {
                machine: target.machine.clone(),
                confirm: None,
            })
            .collect()
    }
}

/// Advances the observation of a machine with the model by one pass.
fn watched(
    step: Step,
    seen: &Observation,
    elapsed_s: f64,
    rules: &Rules,
    before_um: Option<f64>,
) -> Step {
    let Step::Soaking {
        version,
        soaked_s,
        residual_um,
        known_s,
        older_s,
        idle_s,
    } = step
    else {
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
            let why = format!("it has version {} in force again", seen.version);
            return out(Some(version), why, false);
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
        out(Some(version), why, true)
    } else if is_soaked {
        Step::Done { version }
    } else {
        Step::Soaking {
            version,
            soaked_s,
            residual_um,
            known_s,
            older_s: 0.0,
            idle_s: 0.0,
        }
    }
}

fn faulted(version: u64, why: &str) -> Step {
    out(Some(version), format!("its guard has faulted: {why}"), true)
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

fn out(version: Option<u64>, why: String, against: bool) -> Step {
    Step::Out {
        version,
        why,
        against,
        excused: false,
    }
}

/// Wave of the machine with this rank (from 1) out of `of`: the first whose share includes it; machines beyond all waves form one more.
fn wave_of(percent: &[u32], rank: u64, of: u64) -> u32 {
    let reached = percent
        .iter()
        .position(|percent| rank * 100 <= u64::from(*percent).saturating_mul(of));
    u32::try_from(reached.unwrap_or(percent.len()) + 1).unwrap_or(u32::MAX)
}
