//! Arming in three steps: compare the model and limits with those armed last, write the record, give the order.

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
use volcomp_guard::{Reasons, Request, State};
use volcomp_model::{Fading, Machine, ModelError};
use volcomp_runtime::Model;

use super::{
    Service,
    step::{
        AUTO_ARM, ArmingRecord, Compared, Comparison, ComparisonResult, FILES_TIMEOUT, Progress,
        Step, control_unavailable, disk_timeout, log_unavailable, settled,
    },
};
use crate::{
    audit::writer::Receipt,
    differences::ACTIVE,
    documents::{Answer, ConfirmedLimits, Event},
    identity::{self, Judge},
    request::{Reply, refused},
};

const RECORD_TIMEOUT: Duration = Duration::from_secs(2);
impl Service {
    /// Paths of the machine file and the limits of the last arming.
    pub(super) fn confirmed_paths(&self) -> [PathBuf; 2] {
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
    pub(super) fn check_comparison(&mut self, step: Comparison, who: &str) -> Progress {
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
    pub(super) fn check_arming_record(
        &mut self,
        mut step: ArmingRecord,
        who: &str,
        disarms: u64,
    ) -> Progress {
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
