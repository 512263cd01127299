//! The steps of pending requests, and their responses.

use std::{
    sync::mpsc::Receiver,
    time::{Duration, Instant},
};

use tokio::sync::oneshot;
use volcomp_guard::{End, Reasons, Request, State};
use volcomp_runtime::Model;

use crate::{
    audit::writer::Receipt,
    config::Config,
    documents::{Answer, ModelSource, Question, Settled},
    error::GatewayError,
    identity::Judgement,
    plan::Plan,
    request::{ModelActivation, Reply, refused},
};

pub(super) const FILES_TIMEOUT: Duration = Duration::from_secs(8);

pub(super) const AUTO_ARM: &str = "auto_arm";

pub(super) struct PendingRequest {
    pub(super) who: String,
    pub(super) answer: Option<oneshot::Sender<Reply>>,
    pub(super) disarms: u64,
    pub(super) step: Step,
}

pub(super) enum Step {
    /// Arming: the model armed last is read and compared with the present one.
    Comparison(Comparison),
    ArmingRecord(ArmingRecord),
    FileReading(FileReading),
    ReloadRecord(Box<ReloadRecord>),
    Effect(Effect),
}

#[derive(Clone, Copy)]
pub(super) struct Effect {
    pub(super) request: Request,
    /// Number of the last cycle before the order.
    pub(super) cycle: u64,
    /// Deadline for the effect. Only disarming is executed after it.
    pub(super) until: Instant,
}

pub(super) enum Progress {
    Waits(Step),
    Next(Step),
    Done(Reply),
}

pub(super) struct Compared {
    pub(super) question: Option<Question>,
    pub(super) last: Option<Model>,
}

/// `Err` holds the reason why the comparison failed.
pub(super) type ComparisonResult = Result<Compared, String>;

pub(super) struct Comparison {
    pub(super) result: Receiver<ComparisonResult>,
    pub(super) until: Instant,
}

pub(super) struct ArmingRecord {
    pub(super) receipts: [Receipt; 3],
    pub(super) written: [bool; 3],
    pub(super) until: Instant,
}

/// Result of planning a reload: the plan, its effect on the correction, and the question to confirm first.
pub(super) type PlanResult = Result<(Box<Plan>, Judgement), GatewayError>;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum ModelOrigin {
    /// Machine file named in the configuration. The configuration is read again as well.
    Configured,
    /// The fleet's centre, with the hash confirmed there. Only the machine file changes.
    Centre(Option<String>),
    /// Selected by an operator. Only the machine file changes.
    Operator(Box<ModelActivation>),
}

impl ModelOrigin {
    /// Origin of a model, and the name of its file. `config` is the configuration to be applied.
    pub(super) fn describe_origin(&self, config: &Config) -> (ModelSource, String) {
        match self {
            Self::Operator(activation) => (activation.from, activation.file.clone()),
            Self::Centre(_) => (ModelSource::Centre, "centre".to_owned()),
            Self::Configured => (config.machine_from(), config.machine.display().to_string()),
        }
    }
}

pub(super) struct FileReading {
    pub(super) origin: ModelOrigin,
    pub(super) result: Receiver<PlanResult>,
    pub(super) until: Instant,
}

pub(super) struct ReloadRecord {
    pub(super) who: String,
    pub(super) origin: ModelOrigin,
    pub(super) plan: Box<Plan>,
    /// The judged change of the correction, without an open question.
    pub(super) judged: Judgement,
    pub(super) receipts: Vec<Receipt>,
    pub(super) until: Instant,
}

pub(super) fn is_reached(request: Request, state: State) -> bool {
    match request {
        Request::Arm | Request::TakeOver | Request::Switched => state.is_armed(),
        Request::Disarm | Request::End => !state.is_armed(),
        Request::Acknowledge => !matches!(state, State::Faulted(_)),
    }
}

/// Why a request has not taken effect. The reasons of the state give the cause.
pub(super) fn refusal(request: Request, state: State) -> &'static str {
    match (request, state) {
        (Request::Acknowledge, _) => {
            "still faulted: a fault ends when no interlock is active and the applied correction is known"
        }
        (Request::Disarm | Request::End, _) => "not disarmed yet",
        (_, State::Faulted(_)) => "not armed: acknowledge the fault first",
        (_, State::RampingOut(End::Disarmed)) => {
            "not armed: the correction still ramps to zero, and the reasons of the state prevent arming"
        }
        _ => "not armed: the reasons of the state prevent it",
    }
}

pub(super) fn finish(who: &str, answer: Option<oneshot::Sender<Reply>>, reply: Reply) {
    match answer {
        // The receiver may have been dropped.
        Some(to) => drop(to.send(reply)),
        None if who == AUTO_ARM => {}
        None => tracing::info!("{who}: {}", describe(&reply.answer)),
    }
}

pub(super) fn control_unavailable() -> Reply {
    refused(503, "the control thread accepts no orders")
}

pub(super) fn log_unavailable(state: State, why: Option<&str>) -> Reply {
    let why = why.unwrap_or("the audit log cannot be written");
    settled(409, state, Reasons::AUDIT, Some(why))
}

pub(super) fn settled(status: u16, state: State, reasons: Reasons, error: Option<&str>) -> Reply {
    Reply {
        status,
        answer: Answer::Settled(Settled {
            state: state.into(),
            reasons: reasons.texts().map(str::to_owned).collect(),
            error: error.map(str::to_owned),
        }),
    }
}

pub(super) fn describe(answer: &Answer) -> String {
    match answer {
        Answer::Question(question) => {
            let size = |size: Option<f64>| {
                size.map_or("an unknown number of".to_owned(), |size| format!("{size:.1}"))
            };
            let limits: Vec<&str> = question.limits.keys().map(String::as_str).collect();
            let limits = if limits.is_empty() {
                String::new()
            } else {
                format!("; {} changed", limits.join(", "))
            };
            // Without limits for rotary axes no rotary axis is corrected.
            let rotary = question.confirm_urad.map_or(String::new(), |_| {
                format!(" and {} µrad", size(question.worst_corner_urad))
            });
            let differences: Vec<&str> = question
                .differences
                .iter()
                .map(|difference| difference.trim_end_matches('.'))
                .collect();
            let differences = if differences.is_empty() {
                String::new()
            } else {
                format!("; {}", differences.join("; "))
            };
            format!(
                "{} must be confirmed: it moves a point of the work space by {} µm{rotary}{limits}{differences}",
                question.model,
                size(question.worst_corner_um)
            )
        }
        Answer::Settled(settled) => {
            let why = settled.error.iter().chain(&settled.reasons);
            let words: Vec<&str> = why.map(String::as_str).collect();
            let state = settled.state.name();
            if words.is_empty() {
                state.to_owned()
            } else {
                format!("{state}: {}", words.join(", "))
            }
        }
        Answer::Reloaded(reloaded) if reloaded.unchanged => {
            format!("model {}, nothing has changed", reloaded.model)
        }
        Answer::Reloaded(reloaded) => format!("model {}", reloaded.model),
        Answer::Refusal(refusal) => refusal.error.clone(),
    }
}

pub(super) fn disk_timeout() -> Reply {
    refused(503, "the disk with the files does not answer: try again")
}

#[cfg(test)]
mod tests {
    use super::is_reached;
    use volcomp_guard::{Cause, End, Hold, Phase, Request, State};

    #[test]
    fn every_state_and_every_request() {
        let [arm, disarm, acknowledge] = [Request::Arm, Request::Disarm, Request::Acknowledge];
        // State, then the expected results of arming, disarming and acknowledging.
        let table = [
            (State::Disarmed, [false, true, true]),
            (State::Arming(Phase::Proving), [true, false, true]),
            (State::Arming(Phase::Ramping), [true, false, true]),
            (State::Compensating, [true, false, true]),
            (State::Holding(Hold::Stale), [true, false, true]),
            (State::Holding(Hold::Lost), [true, false, true]),
            (State::Holding(Hold::Interlocked), [true, false, true]),
            (State::Holding(Hold::Unconfirmed), [true, false, true]),
            (State::RampingOut(End::Disarmed), [false, true, true]),
            // The guard resumes automatically when positions return.
            (State::RampingOut(End::Lost), [true, false, true]),
            (State::Faulted(Cause::DoesNotStick), [false, true, false]),
            (State::Faulted(Cause::Contradiction), [false, true, false]),
            (State::Faulted(Cause::BeyondLimit), [false, true, false]),
            (State::Faulted(Cause::OtherGateway), [false, true, false]),
        ];
        for (state, expected) in table {
            let found = [arm, disarm, acknowledge].map(|request| is_reached(request, state));
            assert_eq!(found, expected, "{state:?}");
        }
    }
}
