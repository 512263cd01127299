//! Pending requests, which advance independently. Arming and reloading wait for the disk; they are executed one at a
//! time in separate modules.

use std::time::Duration;

use volcomp_guard::{Interlock, Reasons, Request, SensorFlaw, State};
use volcomp_runtime::{Order, Report};

use super::{
    Service,
    step::{
        AUTO_ARM, Effect, PendingRequest, Progress, Step, control_unavailable, describe, finish,
        is_reached, refusal, settled,
    },
};
use crate::{
    documents::{Answer, Event},
    request::{CentreOperation, Operation, Reply, ServiceRequest, refused},
};

const EFFECT_TIMEOUT: Duration = Duration::from_millis(300);

impl Service {
    /// Receives a request. The control thread received an order to disarm when the request was created.
    pub(super) fn receive(&mut self, request: ServiceRequest) {
        // An operator's request ends auto-arm.
        let decides = !matches!(
            request.operation,
            Operation::Reload(_) | Operation::Centre(_) | Operation::Model(_)
        );
        self.person_decides |= decides;
        self.auto_arm_done |= decides;
        self.received_disarms += u64::from(request.operation.disarms());
        match request.operation {
            Operation::Arm(_)
            | Operation::Reload(_)
            | Operation::Model(_)
            | Operation::Centre(CentreOperation::Take { .. }) => {
                self.waiting.push_back(request);
            }
            Operation::Centre(_) => self.execute_centre_operation(request),
            Operation::Disarm => {
                let effect = self.ordered(Request::Disarm);
                self.record_disarm(&request);
                self.begin(request, Step::Effect(effect));
            }
            Operation::Acknowledge => self.acknowledge(request),
        }
    }

    /// Records who disarmed. The record survives a restart.
    fn record_disarm(&mut self, request: &ServiceRequest) {
        // The standing state is written before the record. The response does not wait for the disk, and a program
        // killed soon after it must not lose the disarm because the disk was still writing the log.
        let who = request.who.clone();
        self.change_standing(|standing| standing.disarmed_by = Some(who));
        self.record_request(&request.who, "disarm");
    }

    /// Handles requests that arrive while the gateway stops: a disarm is recorded, all other requests are refused.
    pub(super) fn answer_remaining(&mut self) {
        while let Ok(request) = self.requests.recv_timeout(Duration::ZERO) {
            let reply = if request.operation == Operation::Disarm {
                self.record_disarm(&request);
                let report = *self.parts.handle.report();
                settled(200, report.state, self.all_reasons(&report), None)
            } else {
                refused(503, "the gateway is stopping")
            };
            finish(&request.who, request.answer, reply);
        }
    }

    /// Acknowledges a fault. Refused if there is nothing to acknowledge.
    fn acknowledge(&mut self, request: ServiceRequest) {
        let report = *self.parts.handle.report();
        let from_before = self.is_faulted_from_before();
        if !(from_before || needs_acknowledgement(&report)) {
            let why = if shows_interlock(&report) {
                "an interlock is on: it ends at the control, and cannot be acknowledged"
            } else if report.sensors.iter().any(|sensor| sensor.jumped) {
                "a temperature that jumped has no valid reading now: it can be acknowledged when its sensor works again"
            } else {
                "there is nothing to acknowledge: no fault, no interlock of a silent controller, and no temperature that jumped; a position that jumped needs disarm, then arm"
            };
            let reply = settled(409, report.state, self.all_reasons(&report), Some(why));
            return finish(&request.who, request.answer, reply);
        }
        if from_before && may_not_end(&report) {
            let why = Some(refusal(Request::Acknowledge, report.state));
            let reply = settled(409, report.state, self.all_reasons(&report), why);
            return finish(&request.who, request.answer, reply);
        }
        let effect = self.ordered(Request::Acknowledge);
        if self.send(Request::Acknowledge, effect.until, request.disarms) {
            if !report.state.is_armed() {
                // The operator has decided, so auto-arm stays off, even after a restart. This decision is written
                // before the end of the fault.
                let who = request.who.clone();
                self.change_standing(|standing| standing.disarmed_by = Some(who));
            }
            self.record_request(&request.who, "acknowledge");
            self.begin(request, Step::Effect(effect));
        } else {
            finish(&request.who, request.answer, control_unavailable());
        }
    }

    /// Queues an audit record of a request, with the present state.
    pub(super) fn record_request(&mut self, who: &str, what: &str) {
        let state = self.parts.handle.report().state.into();
        let _ = self.log(who, what, Event::Request { state });
    }

    pub(super) fn begin(&mut self, request: ServiceRequest, step: Step) {
        self.pending.push(PendingRequest {
            who: request.who,
            answer: request.answer,
            disarms: request.disarms,
            step,
        });
    }

    pub(super) fn ordered(&mut self, request: Request) -> Effect {
        Effect {
            request,
            cycle: self.parts.handle.report().cycle,
            until: self.clock.now() + EFFECT_TIMEOUT.max(self.parts.config.cycle() * 5),
        }
    }

    pub(super) fn send(
        &mut self,
        request: Request,
        until: std::time::Instant,
        disarms: u64,
    ) -> bool {
        let order = Order::Request(request);
        self.parts.handle.send_by(order, until, disarms)
    }

    pub(super) fn advance(&mut self) {
        for mut pending in std::mem::take(&mut self.pending) {
            let mut step = pending.step;
            loop {
                let (who, disarms) = (&*pending.who, pending.disarms);
                let progress = match step {
                    Step::Comparison(step) => self.check_comparison(step, who),
                    Step::ArmingRecord(step) => self.check_arming_record(step, who, disarms),
                    Step::FileReading(step) => self.check_plan(step, who),
                    Step::ReloadRecord(step) => self.check_reload_record(*step),
                    Step::Effect(effect) => self.check_effect(effect, who, disarms),
                };
                match progress {
                    Progress::Next(next) => step = next,
                    Progress::Waits(same) => {
                        pending.step = same;
                        self.pending.push(pending);
                        break;
                    }
                    Progress::Done(reply) => {
                        self.handle_reply(&pending.who, &reply);
                        // Publish first, so that a state read after the response is consistent with it.
                        self.publish();
                        finish(&pending.who, pending.answer, reply);
                        break;
                    }
                }
            }
        }
        let is_slow = |pending: &PendingRequest| !matches!(&pending.step, Step::Effect(effect) if effect.request != Request::Arm);
        self.show_confirmation_need();
        if self.unconfirmed.is_none()
            && !self.pending.iter().any(is_slow)
            && let Some(mut request) = self.waiting.pop_front()
        {
            let step = match &mut request.operation {
                Operation::Arm(confirm) => self.compare(confirm.take()),
                Operation::Reload(confirm) => self.begin_reload(confirm.take()),
                Operation::Centre(CentreOperation::Take { machine, confirm }) => {
                    self.begin_centre_model(std::mem::take(machine), confirm.take())
                }
                Operation::Model(activation) => self.begin_operator_model(activation.clone()),
                // Operations of this kind are never queued.
                Operation::Disarm | Operation::Acknowledge | Operation::Centre(_) => return,
            };
            match step {
                Ok(step) => self.begin(request, step),
                Err(reply) => finish(&request.who, request.answer, reply),
            }
        }
    }

    /// Logs a refusal of automatic arming, and stops automatic arming if the operator must confirm.
    fn handle_reply(&mut self, who: &str, reply: &Reply) {
        if who == AUTO_ARM && reply.status != 200 {
            tracing::warn!("auto_arm: {}", describe(&reply.answer));
            // Auto-arm must not repeat a request that requires the operator's confirmation. Keep the flag if it is
            // already set: the operator may have decided while the request was pending.
            self.auto_arm_done |= matches!(reply.answer, Answer::Question(_));
        }
    }

    fn check_effect(&mut self, effect: Effect, who: &str, disarms: u64) -> Progress {
        let report = *self.parts.handle.report();
        // Wait two cycles, because the order may have arrived in the middle of the first one.
        let seen = report.cycle > effect.cycle + 2;
        if seen && is_reached(effect.request, report.state) {
            // The report may be older than a disarm ordered meanwhile.
            let since = self.switch.count() != disarms;
            if effect.request == Request::Arm && who != AUTO_ARM && !since {
                self.change_standing(|standing| standing.disarmed_by = None);
            }
            if effect.request == Request::Acknowledge {
                // A fault from before the start is unknown to the guards, so it is cleared here.
                self.change_standing(|standing| standing.faulted = None);
            }
            let reasons = self.all_reasons(&report);
            return Progress::Done(settled(200, report.state, reasons, None));
        }
        if self.clock.now() <= effect.until {
            return Progress::Waits(Step::Effect(effect));
        }
        Progress::Done(if seen {
            let why = refusal(effect.request, report.state);
            let reasons = self.all_reasons(&report);
            settled(409, report.state, reasons, Some(why))
        } else if effect.request == Request::Disarm {
            refused(
                503,
                "the control thread runs no cycles: the applied correction is unknown; it disarms with its next cycle",
            )
        } else {
            refused(
                503,
                "the control thread runs no cycles: the applied correction is unknown, and the request has expired without effect",
            )
        })
    }

    pub(super) fn all_reasons(&self, report: &Report) -> Reasons {
        report.reasons | self.parts.forbids | self.standing_reasons()
    }

    pub(super) fn auto_arm(&mut self) {
        if !self.parts.config.auto_arm
            || self.auto_arm_done
            || !self.pending.is_empty()
            || !self.waiting.is_empty()
            || self.clock.now() < self.auto_arm_after
            || self.switch.count() != self.received_disarms
        {
            return;
        }
        self.auto_arm_after = self.clock.now() + Duration::from_secs(1);
        let report = *self.parts.handle.report();
        let against = self.all_reasons(&report).without(Reasons::DOES_NOT_FORBID);
        if report.cycle > 1
            && report.state == State::Disarmed
            && against.is_empty()
            && self.trouble.is_none()
        {
            self.waiting.push_back(ServiceRequest {
                operation: Operation::Arm(None),
                who: AUTO_ARM.to_owned(),
                answer: None,
                // The count of received disarms, not of the switch: a disarm that is ordered but not yet received must
                // cancel this request.
                disarms: self.received_disarms,
            });
        }
    }
}

/// True if the state can be acknowledged. An interlock that a controller currently reports cannot be acknowledged.
fn needs_acknowledgement(report: &Report) -> bool {
    let jumped = |flaw: Option<SensorFlaw>| flaw == Some(SensorFlaw::Jumped);
    let has = |reason| report.reasons.contains(reason);
    matches!(report.state, State::Faulted(_))
        || has(Reasons::INTERLOCK_UNSEEN)
        || has(Reasons::LEFT_UNKNOWN)
        || report.sensors.iter().any(|sensor| jumped(sensor.flaw))
}

fn shows_interlock(report: &Report) -> bool {
    report.paths.iter().any(|path| {
        let mut stops = Interlock::REASONS.into_iter();
        let is_stopped = stops.any(|stop| path.reasons.contains(stop));
        is_stopped && !path.reasons.contains(Reasons::INTERLOCK_UNSEEN)
    })
}

/// True if a fault from before the start must persist: a responding controller shows an interlock, or the output of a
/// control with read-back is unknown. Facts that only an operator can know do not count: the end of a silent
/// controller's interlock, and the state of outputs without read-back.
fn may_not_end(report: &Report) -> bool {
    let is_left = report.reasons.contains(Reasons::LEFT_UNKNOWN);
    shows_interlock(report) || !(report.correction_known || is_left)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The operator may override the alarm of a controller that does not respond, but not an emergency stop that
    /// another controller reports now.
    #[test]
    fn a_fault_stays_while_any_controller_shows_an_interlock() {
        let mut report = Report { correction_known: true, ..Report::default() };
        report.paths[0].reasons = Reasons::CONTROLLER_ALARM | Reasons::INTERLOCK_UNSEEN;
        report.reasons = report.paths[0].reasons;
        assert!(!may_not_end(&report));
        report.paths[1].reasons = Reasons::EMERGENCY_STOP;
        report.reasons |= Reasons::EMERGENCY_STOP;
        assert!(may_not_end(&report));
    }
}
