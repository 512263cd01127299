//! Compares the motion of the axes with the rules.

use std::time::Duration;

use volcomp_port::inject::Injection;
use volcomp_runtime::{
    PathPlan,
    guard::{Reasons, State},
};
use volcomp_vocabulary::AxisKind;

use super::{
    faults::{Fault, FaultAction},
    machine::Rig,
    run::{GARBAGE, MAX_ACTIONS},
};
use crate::documents::{Excursion, RehearsedAxis, RehearsedFault, round};

/// Tolerance for rounding errors of summed steps, in steps.
const ROUNDING: f64 = 1e-6;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    Compensating,
    Ramping,
}

impl Phase {
    fn name(self) -> &'static str {
        match self {
            Self::Compensating => "compensating",
            Self::Ramping => "ramping",
        }
    }
}

pub(super) struct Findings {
    pub(super) ready: bool,
    /// Time from the fault until the gateway compensated again; `None` if it did not.
    pub(super) again: Option<Duration>,
    pub(super) needed: Vec<&'static str>,
    pub(super) reasons: Reasons,
    pub(super) worst: State,
    pub(super) rejected_position: bool,
}

/// True if only the limit bounds the effect of a fault, because the fault causes an undetectable step.
fn is_bounded_by_limit(fault: &Fault, path: &PathPlan) -> bool {
    // Without read-back the gateway cannot detect that the control's words have changed.
    let is_unknown = path.no_read_back
        && matches!(
            fault.act,
            FaultAction::PowerUp | FaultAction::ProgramStopped | FaultAction::Garbage
        );
    path.barrier.is_none() && (fault.is_unseen_without_barrier || is_unknown)
}

/// True if the correction can be held during this fault: by the barrier, or by the gateway if its device reports the
/// condition that forbids motion.
fn can_hold(fault: &Fault, path: &PathPlan) -> bool {
    let shown = path.description.shown;
    let is_shown = match fault.act {
        FaultAction::EmergencyStop => shown.emergency_stop,
        FaultAction::Alarm => shown.alarm,
        FaultAction::Unreferenced => shown.referenced,
        _ => !fault.hides_interlock,
    };
    path.barrier.is_some() || is_shown
}

pub(super) fn judge(
    fault: &Fault,
    phase: Phase,
    path: &PathPlan,
    rig: &Rig,
    findings: Findings,
) -> RehearsedFault {
    let log = &rig.controls.axes;
    let bounded_by_limit = is_bounded_by_limit(fault, path);
    let (changes, furthest) = (log.largest_change(), log.furthest());
    let period_s = path.limits.period.as_secs_f64();
    let (mut broken, mut axes) = (Vec::new(), Vec::new());
    for (place, axis) in path.description.axes.iter().enumerate() {
        let limits = &path.limits.axes[place];
        let overwritten = matches!(fault.act, FaultAction::Garbage) && rig.barrier.is_none();
        // The control applied the other sender's values, and the correction ramps from them.
        let most = if overwritten { limits.limit * GARBAGE } else { limits.reachable() };
        let allowed = match &rig.barrier {
            Some(barrier) => f64::from(barrier.rate[place]) * limits.resolution,
            None if bounded_by_limit => most + limits.limit,
            None => (limits.slew_per_s * period_s).max(limits.resolution),
        };
        let forgiven = if overwritten { limits.resolution } else { ROUNDING * limits.resolution };
        let (is_fast, is_far) = (
            changes[place] > allowed + ROUNDING * limits.resolution,
            furthest[place] > most + forgiven,
        );
        let (name, unit) = (axis.name, unit(axis.kind()));
        let shown = |value: f64| round(value * in_shown_unit(axis.kind()));
        let excursion = Excursion {
            largest_change: shown(changes[place]),
            allowed_change: shown(allowed),
            furthest: shown(furthest[place]),
            limit: shown(most),
        };
        if is_fast {
            broken.push(format!(
                "axis {name} moved by {} {unit} in one step, allowed {} {unit}",
                excursion.largest_change, excursion.allowed_change
            ));
        }
        if is_far {
            broken.push(format!(
                "axis {name} was corrected by {} {unit}, the limit is {} {unit}",
                excursion.furthest, excursion.limit
            ));
        }
        let is_linear = axis.kind() == AxisKind::Linear;
        axes.push(RehearsedAxis {
            axis: name,
            um: is_linear.then_some(excursion),
            urad: (!is_linear).then_some(excursion),
        });
    }
    let moved_while_held = log.changes_while_held();
    if moved_while_held > 0 && can_hold(fault, path) {
        broken.push(format!(
            "axes moved {moved_while_held} times in emergency stop, alarm or without reference"
        ));
    }
    let is_jump = matches!(fault.act, FaultAction::Directed(Injection::WrongPosition { add, .. }) if add != 0.0);
    if is_jump && findings.ready && !findings.rejected_position {
        broken.push("a position 4 m away was accepted: see rapid_m_per_min".to_owned());
    }
    if findings.again.is_none() {
        let reasons: Vec<&str> = findings.reasons.texts().collect();
        let when = if !findings.ready {
            "after the start within 30 s"
        } else if findings.needed.len() > MAX_ACTIONS {
            "again, despite repeated acknowledging and arming"
        } else {
            "again within 30 s"
        };
        broken.push(format!("it did not compensate {when}: {}", reasons.join(", ")));
    }
    RehearsedFault {
        fault: fault.name.to_owned(),
        meaning: fault.meaning.to_owned(),
        phase: phase.name().to_owned(),
        passed: broken.is_empty(),
        broken,
        bounded_by_limit,
        interlock_hidden: !can_hold(fault, path),
        state: findings.worst.name().to_owned(),
        compensating_after_s: findings.again.map(|time| round(time.as_secs_f64())),
        needed: findings.needed.into_iter().map(str::to_owned).collect(),
        moved_while_held,
        axes,
    }
}

pub(super) fn in_shown_unit(kind: AxisKind) -> f64 {
    match kind {
        AxisKind::Linear => 1e3,
        AxisKind::Rotary => 1e6,
    }
}

pub(super) fn unit(kind: AxisKind) -> &'static str {
    match kind {
        AxisKind::Linear => "µm",
        AxisKind::Rotary => "µrad",
    }
}
