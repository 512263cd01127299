//! Pending requests of the service, which advance independently.
//!
//! Arming and reloading wait for the disk and are executed one at a time. Arming has three steps: compare the model and
//! limits with those armed last, write the record, give the order. Reloading is in the module `reload`.

use std::{
    collections::BTreeMap,
    io::ErrorKind,
    path::{Path, PathBuf},
    sync::{
        Arc,
        mpsc::{Receiver, TryRecvError},
    },
    time::Duration,
};

use volcomp_document::ReadError;
use volcomp_guard::{Interlock, Reasons, Request, SensorFlaw, State};
use volcomp_model::{Fading, Machine, ModelError};
use volcomp_runtime::{Model, Order, Report};

use crate::{
    audit::writer::Receipt,
    documents::{Answer, ConfirmedLimits, Event},
    identity::{self, ACTIVE, Judge},
    request::{CentreOperation, Operation, Reply, ServiceRequest, refused},
    service::{
        AUTO_ARM, ArmingRecord, Compared, Comparison, ComparisonResult, Effect, FILES_TIMEOUT,
        PendingRequest, Progress, Service, Step, control_unavailable, describe, disk_timeout,
        finish, is_reached, log_unavailable, refusal, settled,
    },
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

const RECORD_TIMEOUT: Duration = Duration::from_secs(2);
impl Service {
    /// Paths of the machine file and the limits of the last arming.
    fn confirmed_paths(&self) -> [PathBuf; 2] {
        let dir = self.parts.config.audit_dir();
        ["confirmed-machine.toml", "confirmed-limits.json"].map(|name| dir.join(name))
    }

    /// Facts from which a change is judged; `None` if no limits are configured.
    pub(super) fn judge(&mut self, confirmed: Option<String>) -> Option<Judge> {
        let report = *self.parts.handle.report();
        let guard = self.parts.config.guard_settings()?;
        let sensors = self.parts.sensors.iter().zip(&report.sensors);
        let degc = sensors.filter_map(|(name, sensor)| Some((name.clone(), sensor.degc?)));
        Some(Judge {
            degc: degc.collect::<BTreeMap<_, _>>(),
            running: self.lags.model().clone(),
            controllers: self.parts.controllers.clone(),
            rotary_step: guard.rotary_step,
            confirm_um: guard.linear.confirm.0,
            confirm_urad: guard.rotary.as_ref().map(|rotary| rotary.confirm.0),
            confirmed,
            confirmed_model: (self.confirmed_model.clone()).filter(|_| self.last_state.is_armed()),
            before: ACTIVE,
        })
    }

    pub(super) fn limits(&self) -> ConfirmedLimits {
        identity::limits(&self.parts.config)
    }

    /// Starts the comparison with the model and limits armed last. `None` if the worker is busy.
    fn comparison(&mut self, confirm: Option<String>) -> Option<Receiver<ComparisonResult>> {
        let judge = self.judge(confirm);
        let judge = judge.map(|judge| Judge { before: "the model armed last", ..judge });
        let fading = self.parts.config.guard_settings().map(|guard| guard.fading);
        let fading = fading.unwrap_or_default();
        let (paths, limits) = (self.confirmed_paths(), self.limits());
        let model = Arc::clone(&self.parts.model);
        self.worker.begin(move || against_last(&paths, &model, &limits, fading, judge.as_ref()))
    }

    /// Starts to check whether the model or the limits need confirmation, after a start or a change.
    pub(super) fn begin_confirmation_check(&mut self) {
        let result = self.comparison(None);
        let until = self.clock.now() + FILES_TIMEOUT;
        self.unconfirmed = result.map(|result| Comparison { result, until });
    }

    pub(super) fn show_confirmation_need(&mut self) {
        let Some(comparing) = &self.unconfirmed else {
            return;
        };
        match comparing.result.try_recv() {
            Err(TryRecvError::Empty) if self.clock.now() < comparing.until => {}
            Err(_) => self.unconfirmed = None,
            Ok(compared) => {
                self.unconfirmed = None;
                let is_confirmed = compared.is_ok_and(|compared| compared.question.is_none());
                self.must_confirm(!is_confirmed);
            }
        }
    }

    /// Sets or clears the reason that a confirmation is needed.
    pub(super) fn must_confirm(&mut self, must: bool) {
        let others = self.shown_reasons.without(Reasons::MUST_CONFIRM);
        self.shown_reasons = others | Reasons::MUST_CONFIRM.when(must);
        self.update_reasons();
    }

    pub(super) fn compare(&mut self, confirm: Option<String>) -> Result<Step, Reply> {
        let report = *self.parts.handle.report();
        if self.is_faulted_from_before() || matches!(report.state, State::Faulted(_)) {
            let why = "not armed: acknowledge the fault first";
            return Err(settled(409, report.state, self.all_reasons(&report), Some(why)));
        }
        let result = self.comparison(confirm).ok_or_else(disk_timeout)?;
        Ok(Step::Comparison(Comparison { result, until: self.clock.now() + FILES_TIMEOUT }))
    }

    /// Checks whether the comparison is complete. If it permits arming, starts writing the record.
    fn check_comparison(&mut self, step: Comparison, who: &str) -> Progress {
        let compared = match step.result.try_recv() {
            Ok(compared) => compared,
            Err(TryRecvError::Empty) if self.clock.now() < step.until => {
                return Progress::Waits(Step::Comparison(step));
            }
            Err(_) => return Progress::Done(disk_timeout()),
        };
        match compared {
            Err(what) => {
                tracing::error!("{what}");
                Progress::Done(refused(409, what))
            }
            Ok(Compared { question: Some(question), .. }) => {
                self.must_confirm(true);
                Progress::Done(Reply { status: 409, answer: Answer::Question(Box::new(question)) })
            }
            Ok(Compared { last, .. }) => {
                // Automatic arming keeps the model that an operator armed or confirmed last as the reference, so that
                // small changes do not add up over restarts.
                let origin = last.filter(|_| who == AUTO_ARM).map(Arc::new);
                let origin = origin.unwrap_or_else(|| Arc::clone(&self.parts.model));
                let state = self.parts.handle.report().state.into();
                let record = self.log(who, "arm", Event::Request { state });
                Progress::Next(Step::ArmingRecord(ArmingRecord {
                    receipts: {
                        let [machine, limits] = self.save_confirmed(origin);
                        [machine, limits, record]
                    },
                    written: [false; 3],
                    until: self.clock.now() + RECORD_TIMEOUT,
                }))
            }
        }
    }

    pub(super) fn save_confirmed(&mut self, confirmed: Arc<Model>) -> [Receipt; 2] {
        let limits = serde_json::to_string(&self.limits()).unwrap_or_default();
        let [machine_file, limits_file] = self.confirmed_paths();
        let receipts = [
            self.writer.keep(machine_file, confirmed.text.clone()),
            self.writer.keep(limits_file, limits),
        ];
        self.confirmed_model = Some(confirmed);
        receipts
    }

    /// Saves a model as confirmed. The limits were not part of the question and stay as stored.
    pub(super) fn save_confirmed_machine(&self, model: &Model) -> Receipt {
        let [machine, _] = self.confirmed_paths();
        self.writer.keep(machine, model.text.clone())
    }

    /// Checks whether the record is written. If it is, gives the order to arm, unless a disarm was ordered meanwhile.
    fn check_arming_record(&mut self, mut step: ArmingRecord, who: &str, disarms: u64) -> Progress {
        let state = self.parts.handle.report().state;
        for (receipt, written) in step.receipts.iter().zip(&mut step.written) {
            match receipt.written() {
                Some(true) => *written = true,
                // A receipt returns its result only once.
                Some(false) if !*written => {
                    return Progress::Done(log_unavailable(state, self.writer.trouble()));
                }
                Some(false) | None => {}
            }
        }
        if step.written.contains(&false) {
            if self.clock.now() < step.until {
                return Progress::Waits(Step::ArmingRecord(step));
            }
            // The record may still be written later. The refusal recorded after it states the outcome.
            let what = "not armed: its record was not written in time".to_owned();
            let _ = self.log(who, "arm refused", Event::Refused(what));
            return Progress::Done(log_unavailable(state, self.writer.trouble()));
        }
        if self.switch.count() != disarms {
            let what = "not armed: it was disarmed meanwhile";
            let _ = self.log(who, "arm refused", Event::Refused(what.to_owned()));
            return Progress::Done(settled(409, state, Reasons::NONE, Some(what)));
        }
        self.must_confirm(false);
        let effect = self.ordered(Request::Arm);
        if !self.send(Request::Arm, effect.until, disarms) {
            return Progress::Done(control_unavailable());
        }
        Progress::Next(Step::Effect(effect))
    }
}

/// Compares the current model and limits with those armed last. If no model was armed, no confirmation is needed.
fn against_last(
    [machine, limits_file]: &[PathBuf; 2],
    model: &Model,
    limits: &ConfirmedLimits,
    fading: Fading,
    judge: Option<&Judge>,
) -> ComparisonResult {
    let unread = |path: &Path, error: String| {
        format!(
            "the model or limits armed last cannot be read ({error}): check {}, and remove it if it is damaged",
            path.display()
        )
    };
    let last = match Machine::read(machine).and_then(|machine| Model::new(&machine, fading)) {
        Ok(last) => Some(last),
        // No model was armed before, so there is no comparison.
        Err(ModelError::Read(ReadError::System { ref source, .. }))
            if source.kind() == ErrorKind::NotFound =>
        {
            None
        }
        // An unreadable file does not prove that this model was confirmed.
        Err(error) => return Err(unread(machine, error.to_string())),
    };
    let last_limits = match std::fs::read_to_string(limits_file) {
        Ok(text) => Some(
            serde_json::from_str::<ConfirmedLimits>(&text)
                .map_err(|e| unread(limits_file, e.to_string()))?,
        ),
        Err(e) if e.kind() == ErrorKind::NotFound => None,
        Err(e) => return Err(unread(limits_file, e.to_string())),
    };
    let changes = last_limits.map_or_else(BTreeMap::new, |last| identity::changes(&last, limits));
    let question = judge.and_then(|judge| match &last {
        Some(last) if last.hash != model.hash => {
            judge.judged([last, model], changes, limits).question
        }
        _ if !changes.is_empty() => judge.judged([model, model], changes, limits).question,
        _ => None,
    });
    Ok(Compared { question, last })
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
