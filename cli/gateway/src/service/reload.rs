//! Reloads the configuration and the machine file while the gateway runs.
//!
//! A reload has three steps: read and compare, record, apply. Models of the fleet's centre and models selected by an
//! operator take the same steps, with the same confirmation and ramp. They do not override an operator's decision to
//! disarm.

use std::{
    path::PathBuf,
    sync::{Arc, mpsc::TryRecvError},
};

use volcomp_guard::{Reasons, Request};
use volcomp_port::Description;
use volcomp_runtime::{Model, Order, Replacement};

use crate::{
    audit::utc_now,
    config::Config,
    documents::{
        Answer, ConfirmedLimits, Event, LimitChanges, ModelEntry, ModelOutcome, ModelSource,
        Question, Reloaded,
    },
    error::GatewayError,
    identity::{self, Judge, Judgement},
    options::Options,
    plan::Plan,
    request::{CentreOperation, ModelActivation, Operation, Reply, ServiceRequest, refused},
    service::{
        FILES_TIMEOUT, FileReading, ModelOrigin, PlanResult, Progress, ReloadRecord, Service, Step,
        control_unavailable, describe, disk_timeout, finish, log_unavailable, settled,
    },
    simulate,
};

impl Service {
    pub(super) fn begin_reload(&mut self, confirm: Option<String>) -> Result<Step, Reply> {
        let judge = self.judge(confirm);
        let old = self.parts.config.clone();
        let options = self.parts.options.clone();
        let (model, limits) = (Arc::clone(&self.parts.model), self.limits());
        let opened = self.parts.controllers.clone();
        let work = move || plan_again(&options, &old, &opened, &model, &limits, judge.as_ref());
        let result = self.worker.begin(work).ok_or_else(disk_timeout)?;
        Ok(Step::FileReading(FileReading {
            origin: ModelOrigin::Configured,
            result,
            until: self.clock.now() + FILES_TIMEOUT,
        }))
    }

    pub(super) fn check_plan(&mut self, step: FileReading, who: &str) -> Progress {
        let origin = step.origin.clone();
        let planned = match step.result.try_recv() {
            Ok(planned) => planned,
            Err(TryRecvError::Empty) if self.clock.now() < step.until => {
                return Progress::Waits(Step::FileReading(step));
            }
            Err(_) => return Progress::Done(self.reject(&origin, disk_timeout())),
        };
        if let ModelOrigin::Operator(activation) = &origin
            && let Some(why) = activation.differences.refusal.clone()
        {
            return Progress::Done(self.reject_files(&origin, who, why));
        }
        let (plan, mut judged) = match planned {
            Ok(planned) => planned,
            Err(e) => {
                return Progress::Done(self.reject_files(&origin, who, e.to_string()));
            }
        };
        if let ModelOrigin::Operator(activation) = &origin
            && plan.model.hash != activation.hash
        {
            let what = format!(
                "{}: its hash is {}, expected {}: the file has become another one meanwhile",
                activation.machine.display(),
                plan.model.hash,
                activation.hash
            );
            return Progress::Done(self.reject_files(&origin, who, what));
        }
        if let Some(question) = judged.question.take() {
            let asked = (&plan.config, &plan.model);
            self.record_model(&origin, who, asked, judged.worst, ModelOutcome::MustBeConfirmed);
            return Progress::Done(self.must_be_confirmed(&origin, who, question));
        }
        let to = identity::limits(&plan.config);
        let event = Event::Reload {
            from: self.parts.model.hash.clone(),
            to: plan.model.hash.clone(),
            limits: identity::changes(&self.limits(), &to),
            model_of: match &origin {
                ModelOrigin::Operator(activation) => Some(activation.file.clone()),
                _ => None,
            },
        };
        let (what, confirmed) = match &origin {
            ModelOrigin::Configured => ("reload", None),
            ModelOrigin::Centre(confirm) => ("reload", confirm.as_ref()),
            ModelOrigin::Operator(activation) => ("model", activation.confirm.as_ref()),
        };
        let is_confirmed = confirmed == Some(&plan.model.hash);
        let mut receipts = vec![self.log(who, what, event)];
        if is_confirmed {
            receipts.push(self.save_confirmed_machine(&plan.model));
        }
        Progress::Next(Step::ReloadRecord(Box::new(ReloadRecord {
            who: who.to_owned(),
            origin,
            plan,
            judged,
            receipts,
            until: self.clock.now() + FILES_TIMEOUT,
        })))
    }

    pub(super) fn check_reload_record(&mut self, mut step: ReloadRecord) -> Progress {
        let origin = step.origin.clone();
        while let Some(receipt) = step.receipts.last() {
            match receipt.written() {
                // A receipt returns its result only once, so drop it.
                Some(true) => drop(step.receipts.pop()),
                None if self.clock.now() < step.until => {
                    return Progress::Waits(Step::ReloadRecord(Box::new(step)));
                }
                Some(false) | None => {
                    let reply = log_unavailable(self.last_state, self.writer.trouble());
                    return Progress::Done(self.reject(&origin, reply));
                }
            }
        }
        // Limits and model must be applied together or not at all. A thread that hangs would apply neither.
        let handle = &self.parts.handle;
        let is_silent = handle.pulse().silence().is_some();
        if is_silent || handle.room() <= step.plan.limits().len() {
            return Progress::Done(self.reject(&origin, control_unavailable()));
        }
        let plan = *step.plan;
        let is_configured = origin == ModelOrigin::Configured;
        let has_same_model = plan.model.hash == self.parts.model.hash;
        let unchanged = has_same_model && (plan.config == self.parts.config || !is_configured);
        if !(has_same_model && is_configured) {
            let taken = (&plan.config, &plan.model);
            self.record_model(&origin, &step.who, taken, step.judged.worst, ModelOutcome::InForce);
        }
        let mut note = None;
        if is_configured && plan.config.machine != plan.config.configured_machine {
            let who = if plan.config.is_machine_of_centre() { "the centre" } else { "an operator" };
            note = Some(format!(
                "{} was not read: the model that {who} has activated remains active",
                plan.config.configured_machine.display()
            ));
        }
        if plan.config.configured_machine != self.parts.config.configured_machine {
            let machine = plan.config.configured_machine.clone();
            self.parts.notes.configured(machine);
        }
        if unchanged {
            self.parts.config.machine = plan.config.machine;
        } else {
            self.apply(plan, step.judged.is_confirmed);
        }
        match origin {
            ModelOrigin::Configured => {
                self.shown_reasons = self.shown_reasons.without(Reasons::NOT_RELOADED);
                self.must_confirm(false);
            }
            ModelOrigin::Centre(_) => {
                self.shown_reasons = self.shown_reasons.without(Reasons::CENTRE_FILE);
                self.finish_activation();
            }
            ModelOrigin::Operator(_) => self.finish_activation(),
        }
        Progress::Done(Reply {
            status: 200,
            answer: Answer::Reloaded(Reloaded {
                model: self.parts.model.hash.clone(),
                unchanged,
                note,
            }),
        })
    }

    /// The response if an operator must first confirm a machine file.
    fn must_be_confirmed(&mut self, origin: &ModelOrigin, who: &str, question: Question) -> Reply {
        let (model, answer) = (question.model.clone(), Answer::Question(Box::new(question)));
        match origin {
            ModelOrigin::Centre(_) => {
                let words = describe(&answer);
                tracing::warn!("{who}: {words}");
                let _ = self.log(who, "manifest must be confirmed", Event::Refused(words));
            }
            // The files on disk equal the active ones, so no reason is shown.
            ModelOrigin::Operator(_) => {
                let what = Event::Refused(format!("{model} must be confirmed"));
                let _ = self.log(who, "model must be confirmed", what);
            }
            ModelOrigin::Configured => {
                tracing::warn!("reload: {model} must be confirmed");
                self.must_confirm(true);
            }
        }
        let status = 409;
        self.reject(origin, Reply { status, answer })
    }

    pub(super) fn record_model(
        &self,
        origin: &ModelOrigin,
        who: &str,
        (config, model): (&Config, &Model),
        [worst_um, worst_urad]: [Option<f64>; 2],
        outcome: ModelOutcome,
    ) {
        let (from, file) = origin.describe_origin(config);
        let entry = ModelEntry {
            time: utc_now(),
            who: who.to_owned(),
            hash: model.hash.clone(),
            name: model.name.clone(),
            from,
            file,
            outcome,
            why: None,
            worst_um,
            worst_urad,
        };
        self.parts.notes.report(entry, Some(model.text.clone()));
    }

    fn reject_files(&mut self, origin: &ModelOrigin, who: &str, what: String) -> Reply {
        let title = match origin {
            ModelOrigin::Operator(activation) => {
                let (hash, file) = (activation.hash.clone(), activation.file.clone());
                let entry = ModelEntry::refused(who, hash, activation.from, file, what.clone());
                self.parts.notes.report(entry, None);
                "model refused"
            }
            _ => "reload refused",
        };
        let _ = self.log(who, title, Event::Refused(what.clone()));
        tracing::warn!("{title}: {what}");
        self.reject(origin, refused(422, what))
    }

    /// The response if nothing was applied. For a reload the state then shows a reason.
    fn reject(&mut self, origin: &ModelOrigin, reply: Reply) -> Reply {
        // The built-in configuration has no files.
        if *origin == ModelOrigin::Configured && self.parts.options.config.is_some() {
            self.shown_reasons |= Reasons::NOT_RELOADED;
            self.update_reasons();
        }
        reply
    }

    /// Executes a request of the centre that does not change the model.
    pub(super) fn execute_centre_operation(&mut self, request: ServiceRequest) {
        match &request.operation {
            Operation::Centre(CentreOperation::Disable) => {
                self.parts.forbids |= Reasons::DISABLED_BY_CENTRE;
                self.update_reasons();
                // Disarm again, because an operator may have armed between the order and this reason.
                self.switch.disarm();
                self.received_disarms += 1;
                let effect = self.ordered(Request::Disarm);
                self.record_request(&request.who, "disable");
                return self.begin(request, Step::Effect(effect));
            }
            Operation::Centre(CentreOperation::Enable) => self.enable(&request.who),
            Operation::Centre(CentreOperation::Refused(why)) => {
                tracing::warn!("{}: manifest refused: {why}", request.who);
                let why = Event::Refused(why.clone());
                let _ = self.log(&request.who, "manifest refused", why);
            }
            Operation::Centre(CentreOperation::Damaged(what)) => {
                tracing::error!("fleet: {what}");
                let what = Event::Refused(what.clone());
                let _ = self.log("gateway", "files of the fleet damaged", what);
                self.shown_reasons |= Reasons::CENTRE_FILE;
                self.update_reasons();
            }
            // Other functions handle the other requests.
            _ => {}
        }
        let report = *self.parts.handle.report();
        let reply = settled(200, report.state, self.all_reasons(&report), None);
        finish(&request.who, request.answer, reply);
    }

    /// Permits arming again. If only the centre prevented arming, auto-arm resumes as after the start.
    fn enable(&mut self, who: &str) {
        if !self.parts.forbids.contains(Reasons::DISABLED_BY_CENTRE) {
            return;
        }
        self.parts.forbids = self.parts.forbids.without(Reasons::DISABLED_BY_CENTRE);
        self.update_reasons();
        self.record_request(who, "enable");
        self.auto_arm_done &= self.person_decides;
    }

    pub(super) fn begin_centre_model(
        &mut self,
        machine: PathBuf,
        confirm: Option<String>,
    ) -> Result<Step, Reply> {
        self.begin_model(machine, confirm.clone(), ModelOrigin::Centre(confirm))
    }

    /// Starts reading a machine file selected by an operator. Refused while a model of the centre is active, because
    /// the centre assumes that the machine uses that model.
    pub(super) fn begin_operator_model(
        &mut self,
        activation: Box<ModelActivation>,
    ) -> Result<Step, Reply> {
        if self.parts.config.is_machine_of_centre() {
            return Err(refused(
                409,
                "the centre has activated the model: only the centre can replace it",
            ));
        }
        let (machine, confirm) = (activation.machine.clone(), activation.confirm.clone());
        self.begin_model(machine, confirm, ModelOrigin::Operator(activation))
    }

    /// Starts reading a machine file. All other keys of the configuration keep their values, even if the file has
    /// changed.
    fn begin_model(
        &mut self,
        machine: PathBuf,
        confirm: Option<String>,
        origin: ModelOrigin,
    ) -> Result<Step, Reply> {
        let judge = self.judge(confirm);
        let config = Config { machine, ..self.parts.config.clone() };
        let (model, limits) = (Arc::clone(&self.parts.model), self.limits());
        let opened = self.parts.controllers.clone();
        let work = move || plan_with(config, &opened, &model, &limits, judge.as_ref());
        let result = self.worker.begin(work).ok_or_else(disk_timeout)?;
        Ok(Step::FileReading(FileReading {
            origin,
            result,
            until: self.clock.now() + FILES_TIMEOUT,
        }))
    }

    fn finish_activation(&mut self) {
        if self.last_state.is_armed() {
            self.must_confirm(false);
        } else {
            // The model armed last may be another one, so check again. Arming then requires a confirmation, unless one
            // was sent with this model.
            self.begin_confirmation_check();
            self.auto_arm_done &= self.person_decides;
            self.update_reasons();
        }
    }

    /// Applies the limits and the model of a plan. Only a confirmed model becomes the reference of the next comparison.
    fn apply(&mut self, plan: Plan, is_confirmed: bool) {
        for (index, limits) in plan.limits().into_iter().enumerate() {
            // The queue has room for all orders, because only this thread sends and it has checked the room.
            let _ = self.parts.handle.send(Order::Limits(index, Box::new(limits)));
        }
        let Plan { config, model, .. } = plan;
        let has_other_model = model.hash != self.parts.model.hash;
        if has_other_model {
            let copy = Arc::new(model.clone());
            let replacement = Replacement::new(Box::new(model), &self.parts.sensors);
            let _ = self.parts.handle.send(Order::Model(Box::new(replacement)));
            self.lags.replace(&copy, &self.parts.sensors);
            self.publisher.set_model(Arc::clone(&copy));
            self.parts.model = copy;
        }
        self.parts.forbids = self.parts.forbids.without(Reasons::NO_LIMITS);
        self.parts.config = config;
        if is_confirmed && self.last_state.is_armed() {
            let _ = self.save_confirmed(Arc::clone(&self.parts.model));
        }
        self.update_reasons();
    }
}

/// Plans from the files on disk. A change that needs a restart is rejected with its key.
fn plan_again(
    options: &Options,
    old: &Config,
    opened: &[Description],
    model: &Model,
    limits: &ConfirmedLimits,
    judge: Option<&Judge>,
) -> PlanResult {
    if options.config.is_none() {
        let what = "the built-in configuration cannot be read again";
        return Err(GatewayError::invalid(what));
    }
    let mut config = options.configuration()?;
    if config.guard.is_some() {
        can_change(old, &config)?;
    }
    // A model activated by the centre or an operator stays active: only they can change it.
    let holds = old.machine_from() != ModelSource::File;
    let machine = if holds { &old.machine } else { &config.configured_machine };
    config.machine.clone_from(machine);
    plan_with(config, opened, model, limits, judge)
}

fn plan_with(
    config: Config,
    opened: &[Description],
    model: &Model,
    limits: &ConfirmedLimits,
    judge: Option<&Judge>,
) -> PlanResult {
    if config.guard.is_none() {
        return Err(GatewayError::invalid_in(
            config.file,
            "[guard] is missing, expected it: without limits nothing may be corrected; nothing was changed",
        ));
    }
    let new_limits = identity::limits(&config);
    let plan = Plan::new(config)?;
    let is_other = |(now, opened): &(&Description, &Description)| now != opened;
    let other = plan.descriptions().zip(opened).find(is_other);
    if let Some(device) = other.map(|(now, _)| now.device.clone()) {
        // A file that describes the device, such as a DBC file, has changed.
        return Err(GatewayError::invalid_in(
            plan.config.file,
            format_args!(
                "{device}: axes, steps or signals are not those with which it was opened: restart the gateway for that"
            ),
        ));
    }
    if plan.model.axes != model.axes {
        return Err(GatewayError::invalid_in(
            plan.config.machine.display(),
            "other axes than before: restart the gateway for that",
        ));
    }
    // Without earlier limits the gateway was never armed.
    let changes = if limits.is_empty() {
        LimitChanges::new()
    } else {
        identity::changes(limits, &new_limits)
    };
    let differs = plan.model.hash != model.hash || !changes.is_empty();
    let Some(judge) = judge.filter(|_| differs) else {
        return Ok((Box::new(plan), Judgement::default()));
    };
    let mut judged = judge.judged([model, &plan.model], changes.clone(), &new_limits);
    if judged.question.is_none()
        && let Some(confirmed) = &judge.confirmed_model
        && confirmed.hash != model.hash
    {
        let since_confirmed = judge.judged([confirmed, &plan.model], changes, &new_limits);
        judged.question = since_confirmed.question;
    }
    Ok((Box::new(plan), judged))
}

/// Rejects changes of keys that are fixed while the gateway runs.
fn can_change(old: &Config, config: &Config) -> Result<(), GatewayError> {
    let fixed = |config: &Config| {
        // Without configured limits the cycle runs with the limits of the simulation.
        let guard = config.guard_settings().unwrap_or_else(simulate::guard);
        (guard.hand_back, guard.temperatures, guard.fading, guard.rotary_step, guard.rapid)
    };
    let guard = fixed(config) == fixed(old);
    let same = [
        (config.controllers == old.controllers, "[[controller]]"),
        (config.thermometers == old.thermometers, "[[thermometer]]"),
        (config.cycle_ms == old.cycle_ms, "cycle_ms"),
        (config.dashboard == old.dashboard, "[dashboard]"),
        (config.audit == old.audit, "[audit]"),
        (config.realtime == old.realtime, "[realtime]"),
        (config.fleet == old.fleet, "[fleet]"),
        (
            guard,
            "[guard] hand_back_s, rotary_step_um, rapid_m_per_min, rapid_rpm or a key of temperatures",
        ),
        (
            (&config.shdr, &config.opc_ua) == (&old.shdr, &old.opc_ua),
            "a table of other systems ([shdr], [opc_ua])",
        ),
    ];
    match same.into_iter().find(|(same, _)| !same) {
        Some((_, key)) => Err(GatewayError::invalid_in(
            &config.file,
            format_args!("{key} changed: restart the gateway for that"),
        )),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step changed in a DBC file needs a restart. The limits would use the new step, 0.1 µm instead of 1 µm, while
    /// the open controller and the control keep the old one. Each correction would then be ten times too large.
    #[test]
    fn another_step_in_a_dbc_file_needs_a_restart() {
        let dir = tempfile::tempdir().expect("writable");
        let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text);
        let dbc = include_str!("../../../../drivers/can/volcomp.dbc");
        let steps = |step: &str| dbc.replace("@1- (1,0) [-2048|2047] \"um\"", step);
        let machine = "structure = \"w X' b Y Z t\"\naxes = { X.travel = [0, 100], Y.travel = [0, 100], Z.travel = [0, 100] }\nerrors = { EYX = 20.0 }\n";
        write("machine.toml", machine).expect("writable");
        write("steps.dbc", dbc).expect("writable");
        let gateway = "machine = \"machine.toml\"\n[guard]\nlimit_um = 30\nslew_um_per_s = 500\nhold_ms = 200\nzero_after_ms = 2000\n[[controller]]\nurl = \"can://can9?dbc=DBC\"\naxes = [\"X\", \"Y\", \"Z\"]\nunwatched = true\n";
        let path = dir.path().join("steps.dbc");
        let gateway = gateway.replace("DBC", &path.display().to_string());
        write("gateway.toml", &gateway).expect("writable");
        let options =
            Options { config: Some(dir.path().join("gateway.toml")), ..Options::default() };
        let config = options.configuration().expect("right");
        let running = Plan::new(config.clone()).expect("right");
        let opened: Vec<Description> = running.descriptions().cloned().collect();
        let limits = ConfirmedLimits::new();
        let again = || plan_again(&options, &config, &opened, &running.model, &limits, None);
        assert!(again().is_ok(), "nothing changed");
        let finer = steps("@1- (0.1,0) [-204.8|204.7] \"um\"");
        assert_ne!(finer, dbc);
        write("steps.dbc", &finer).expect("writable");
        let refused = again().err().map(|error| error.to_string());
        let refused = refused.expect("another step");
        assert!(
            refused.contains("can://can9") && refused.contains("restart the gateway"),
            "{refused}"
        );
    }

    /// A gateway started without limits does not accept new speeds together with its first limits, because the cycle
    /// keeps the old speeds until a restart.
    #[test]
    fn speeds_that_come_with_the_first_limits_need_a_restart() {
        let config = |guard: &str| {
            let text = format!(
                "machine = \"machine.toml\"\n{guard}[[controller]]\nurl = \"focas://127.0.0.1:1\"\naxes = [\"X\"]\n"
            );
            Config::parse(&text, "gateway.toml", "".as_ref()).expect("right")
        };
        let limits =
            "[guard]\nlimit_um = 30\nslew_um_per_s = 500\nhold_ms = 200\nzero_after_ms = 2000\n";
        let without = config("");
        assert!(can_change(&without, &config(limits)).is_ok());
        let slower = config(&format!("{limits}rapid_m_per_min = 50\n"));
        let refused = can_change(&without, &slower).expect_err("another speed");
        assert!(refused.to_string().contains("rapid_m_per_min"), "{refused}");
    }
}
