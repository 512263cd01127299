//! Reloads configuration and machine file while the gateway runs: read and compare, record, apply. Decisions of the
//! fleet's centre and models selected by an operator take the same path, with the same confirmation and ramp; they do
//! not override what an operator has decided.

use std::{
    path::PathBuf,
    sync::{Arc, mpsc::TryRecvError},
};

use volcomp_guard::{Reasons, Request};
use volcomp_port::Description;
use volcomp_runtime::{Model, Order, Replacement};

use super::{
    Service,
    step::{
        FILES, Keeping, Planned, Progress, Reading, Step, Whose, disk_silent, finish, in_words,
        no_log, no_orders, settled,
    },
};
use crate::{
    audit::utc_now,
    config::Config,
    documents::{
        Answer, ConfirmedLimits, Event, LimitChanges, ModelEntry, ModelOutcome, ModelSource,
        Question, Reloaded,
    },
    error::GatewayError,
    identity::{self, Judge, Judged},
    options::Options,
    plan::Plan,
    request::{Ask, Asked, CentreAsk, ModelAsk, Reply, refused},
    simulate,
};

impl Service {
    /// Starts reading all files again.
    pub(super) fn read_again(&mut self, confirm: Option<String>) -> Result<Step, Reply> {
        let judge = self.judge(confirm);
        let old = self.parts.config.clone();
        let options = self.parts.options.clone();
        let (model, limits) = (Arc::clone(&self.parts.model), self.limits());
        let opened = self.parts.controllers.clone();
        let work = move || plan_again(&options, &old, &opened, &model, &limits, judge.as_ref());
        let told = self.worker.begin(work).ok_or_else(disk_silent)?;
        Ok(Step::Reading(Reading {
            whose: Whose::Configured,
            told,
            until: self.clock.now() + FILES,
        }))
    }

    /// Checks whether the files have been read; if the result may be applied, starts writing its record.
    pub(super) fn planned(&mut self, step: Reading, who: &str) -> Progress {
        let whose = step.whose.clone();
        let planned = match step.told.try_recv() {
            Ok(planned) => planned,
            Err(TryRecvError::Empty) if self.clock.now() < step.until => {
                return Progress::Waits(Step::Reading(step));
            }
            Err(_) => return Progress::Done(self.not_taken(&whose, disk_silent())),
        };
        if let Whose::Person(ask) = &whose
            && let Some(why) = ask.differences.refusal.clone()
        {
            return Progress::Done(self.refused_files(&whose, who, why));
        }
        let (plan, mut judged) = match planned {
            Ok(planned) => planned,
            Err(e) => {
                return Progress::Done(self.refused_files(&whose, who, e.to_string()));
            }
        };
        if let Whose::Person(ask) = &whose
            && plan.model.hash != ask.hash
        {
            let what = format!(
                "{}: its hash is {}, expected {}: the file has become another one meanwhile",
                ask.machine.display(),
                plan.model.hash,
                ask.hash
            );
            return Progress::Done(self.refused_files(&whose, who, what));
        }
        if let Some(question) = judged.question.take() {
            self.note(
                &whose,
                who,
                &plan,
                judged.worst,
                ModelOutcome::MustBeConfirmed,
            );
            return Progress::Done(self.must_be_confirmed(&whose, who, question));
        }
        let to = plan.config.guard.as_ref().map(identity::limits);
        let event = Event::Reload {
            from: self.parts.model.hash.clone(),
            to: plan.model.hash.clone(),
            limits: identity::changes(&self.limits(), &to.unwrap_or_default()),
            model_of: match &whose {
                Whose::Person(ask) => Some(ask.file.clone()),
                _ => None,
            },
        };
        let (what, confirmed) = match &whose {
            Whose::Configured => ("reload", None),
            Whose::Centre(confirm) => ("reload", confirm.as_ref()),
            Whose::Person(ask) => ("model", ask.confirm.as_ref()),
        };
        let is_confirmed = confirmed == Some(&plan.model.hash);
        let mut receipts = vec![self.log(who, what, event)];
        if is_confirmed {
            receipts.push(self.keep_confirmed_machine(&plan.model));
        }
        Progress::Next(Step::Keeping(Box::new(Keeping {
            who: who.to_owned(),
            whose,
            plan,
            judged,
            receipts,
            until: self.clock.now() + FILES,
        })))
    }

    /// Checks whether the record is written; then applies the plan.
    pub(super) fn kept(&mut self, mut step: Keeping) -> Progress {
        let whose = step.whose.clone();
        while let Some(receipt) = step.receipts.last() {
            match receipt.written() {
                // A receipt returns its result only once.
                Some(true) => drop(step.receipts.pop()),
                None if self.clock.now() < step.until => {
                    return Progress::Waits(Step::Keeping(Box::new(step)));
                }
                Some(false) | None => {
                    let reply = no_log(self.last_state, self.clerk.trouble());
                    return Progress::Done(self.not_taken(&whose, reply));
                }
            }
        }
        // Limits and model must be applied together or not at all, and a thread that hangs would apply neither.
        let handle = &self.parts.handle;
        let is_silent = handle.pulse().silence().is_some();
        if is_silent || handle.room() <= step.plan.limits().len() {
            return Progress::Done(self.not_taken(&whose, no_orders()));
        }
        let plan = *step.plan;
        let is_configured = whose == Whose::Configured;
        let has_same_model = plan.model.hash == self.parts.model.hash;
        let unchanged = has_same_model && (plan.config == self.parts.config || !is_configured);
        if !(has_same_model && is_configured) {
            self.note(&whose, &step.who, &plan, step.judged.worst, ModelOutcome::InForce);
        }
        let mut note = None;
        if is_configured && plan.config.machine != plan.config.configured_machine {
            let who = if plan.config.is_machine_of_centre() {
                "the centre"
            } else {
                "a person"
            };
            note = Some(format!(
                "{} was not read: the model that {who} has put in force holds",
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
            self.take(plan, step.judged.is_confirmed);
        }
        match whose {
            Whose::Configured => {
                self.tells = self.tells.without(Reasons::NOT_RELOADED);
                self.must_confirm(false);
            }
            Whose::Centre(_) => {
                self.tells = self.tells.without(Reasons::CENTRE_FILE);
                self.took_other();
            }
            Whose::Person(_) => self.took_other(),
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

    /// The response if an operator must confirm a machine file first.
    fn must_be_confirmed(&mut self, whose: &Whose, who: &str, question: Question) -> Reply {
        let (model, answer) = (question.model.clone(), Answer::Question(Box::new(question)));
        match whose {
            Whose::Centre(_) => {
                let words = in_words(&answer);
                tracing::warn!("{who}: {words}");
                let _ = self.log(who, "manifest must be confirmed", Event::Refused(words));
            }
            // The files on disk do not differ from the active ones, so no reason is shown.
            Whose::Person(_) => {
                let what = Event::Refused(format!("{model} must be confirmed"));
                let _ = self.log(who, "model must be confirmed", what);
            }
            Whose::Configured => {
                tracing::warn!("reload: {model} must be confirmed");
                self.must_confirm(true);
            }
        }
        let status = 409;
        self.not_taken(whose, Reply { status, answer })
    }

    /// Reports the outcome of a model for its history.
    fn note(
        &self,
        whose: &Whose,
        who: &str,
        plan: &Plan,
        [worst_um, worst_urad]: [Option<f64>; 2],
        outcome: ModelOutcome,
    ) {
        let (from, file) = whose.origin(&plan.config);
        let entry = ModelEntry {
            time: utc_now(),
            who: who.to_owned(),
            hash: plan.model.hash.clone(),
            name: plan.model.name.clone(),
            from,
            file,
            outcome,
            why: None,
            worst_um,
            worst_urad,
        };
        let text = plan.model.text.clone();
        self.parts.notes.tell(entry, Some(text));
    }

    /// The response for invalid files; it is recorded.
    fn refused_files(&mut self, whose: &Whose, who: &str, what: String) -> Reply {
        let title = match whose {
            Whose::Person(ask) => {
                let (hash, file) = (ask.hash.clone(), ask.file.clone());
                let entry = ModelEntry::refused(who, hash, ask.from, file, what.clone());
                self.parts.notes.tell(entry, None);
                "model refused"
            }
            _ => "reload refused",
        };
        let _ = self.log(who, title, Event::Refused(what.clone()));
        tracing::warn!("{title}: {what}");
        self.not_taken(whose, refused(422, what))
    }

    /// The response if nothing was applied; for a reload, this is also shown as a reason.
    fn not_taken(&mut self, whose: &Whose, reply: Reply) -> Reply {
        // The built-in configuration has no files that could differ from it.
        if *whose == Whose::Configured && self.parts.options.config.is_some() {
            self.tells |= Reasons::NOT_RELOADED;
            self.tell_thread();
        }
        reply
    }

    /// Executes a request of the centre that does not wait.
    pub(super) fn centre_asks(&mut self, asked: Asked) {
        match &asked.ask {
            Ask::Centre(CentreAsk::Disable) => {
                self.parts.forbids |= Reasons::DISABLED_BY_CENTRE;
                self.tell_thread();
                // Disarm again: auto-arm may have armed between the order and this reason.
                self.switch.disarm();
                let effect = self.ordered(Request::Disarm);
                self.write_down(&asked.who, "disable");
                return self.begin(asked, Step::Effect(effect));
            }
            Ask::Centre(CentreAsk::Enable) => self.enable(&asked.who),
            Ask::Centre(CentreAsk::Refused(why)) => {
                tracing::warn!("{}: manifest refused: {why}", asked.who);
                let why = Event::Refused(why.clone());
                let _ = self.log(&asked.who, "manifest refused", why);
            }
            Ask::Centre(CentreAsk::Damaged(what)) => {
                tracing::error!("fleet: {what}");
                let what = Event::Refused(what.clone());
                let _ = self.log("gateway", "files of the fleet damaged", what);
                self.tells |= Reasons::CENTRE_FILE;
                self.tell_thread();
            }
            // Other requests are handled elsewhere.
            _ => {}
        }
        let report = *self.parts.handle.report();
        let reply = settled(200, report.state, self.all_reasons(&report), None);
        finish(&asked.who, asked.answer, reply);
    }

    /// Permits arming again. If only the centre prevented it, auto-arm resumes as after the start.
    fn enable(&mut self, who: &str) {
        if !self.parts.forbids.contains(Reasons::DISABLED_BY_CENTRE) {
            return;
        }
        self.parts.forbids = self.parts.forbids.without(Reasons::DISABLED_BY_CENTRE);
        self.tell_thread();
        self.write_down(who, "enable");
        self.auto_arm_done &= self.person_decides;
    }

    /// Starts reading a machine file of the centre.
    pub(super) fn read_of_centre(
        &mut self,
        machine: PathBuf,
        confirm: Option<String>,
    ) -> Result<Step, Reply> {
        self.read_other(machine, confirm.clone(), Vec::new(), Whose::Centre(confirm))
    }

    /// Starts reading a machine file selected by an operator. Refused while a model of the centre is active: the
    /// machine must not use another model than the centre assumes.
    pub(super) fn read_of_person(&mut self, ask: Box<ModelAsk>) -> Result<Step, Reply> {
        if self.parts.config.is_machine_of_centre() {
            return Err(refused(
                409,
                "the centre has put the model in force: a new one comes from there",
            ));
        }
        let (machine, confirm) = (ask.machine.clone(), ask.confirm.clone());
        self.read_other(
            machine,
            confirm,
            ask.differences.to_confirm.clone(),
            Whose::Person(ask),
        )
    }

    /// Starts reading a machine file without any other change of the configuration, whatever is on disk. `differences`
    /// must be confirmed in addition to a large change of the correction.
    fn read_other(
        &mut self,
        machine: PathBuf,
        confirm: Option<String>,
        differences: Vec<String>,
        whose: Whose,
    ) -> Result<Step, Reply> {
        let judge = self.judge(confirm);
        let judge = judge.map(|judge| Judge {
            differences,
            ..judge
        });
        let config = Config {
            machine,
            ..self.parts.config.clone()
        };
        let (model, limits) = (Arc::clone(&self.parts.model), self.limits());
        let opened = self.parts.controllers.clone();
        let work = move || plan_with(config, &opened, &model, &limits, judge.as_ref());
        let told = self.worker.begin(work).ok_or_else(disk_silent)?;
        Ok(Step::Reading(Reading {
            whose,
            told,
            until: self.clock.now() + FILES,
        }))
    }

    /// Completes the activation of another machine file than the configured one.
    pub(super) fn took_other(&mut self) {
        if self.last_state.is_armed() {
            self.must_confirm(false);
        } else {
            // The model armed last may be another one: check it again. Arming asks, and a confirmation sent with this
            // model answers.
            self.ask_whether_confirmed();
            self.auto_arm_done &= self.person_decides;
            self.tell_thread();
        }
    }

    /// Applies limits and model of a plan. Only a confirmed model becomes the one from which the next change is measured.
    fn take(&mut self, plan: Plan, is_confirmed: bool) {
        for (index, limits) in plan.limits().into_iter().enumerate() {
            // The queue has room for all of them: this is the only sending thread.
            let _ = self
                .parts
                .handle
                .send(Order::Limits(index, Box::new(limits)));
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
            let _ = self.keep_confirmed();
        }
        self.tell_thread();
    }
}

/// Plans from the reread files. Changes that need a restart are rejected with the key.
fn plan_again(
    options: &Options,
    old: &Config,
    opened: &[Description],
    model: &Model,
    limits: &ConfirmedLimits,
    judge: Option<&Judge>,
) -> Planned {
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
    let machine = if holds {
        &old.machine
    } else {
        &config.configured_machine
    };
    config.machine.clone_from(machine);
    plan_with(config, opened, model, limits, judge)
}

/// Plans a new configuration for the open devices.
fn plan_with(
    config: Config,
    opened: &[Description],
    model: &Model,
    limits: &ConfirmedLimits,
    judge: Option<&Judge>,
) -> Planned {
    let Some(guard) = &config.guard else {
        return Err(GatewayError::invalid_in(
            config.file,
            "[guard] is missing, expected it: without limits nothing may be corrected; nothing was changed",
        ));
    };
    let new_limits = identity::limits(guard);
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
    // Without earlier limits nothing was armed.
    let changes = if limits.is_empty() {
        LimitChanges::new()
    } else {
        identity::changes(limits, &new_limits)
    };
    let differs = plan.model.hash != model.hash || !changes.is_empty();
    let Some(judge) = judge.filter(|_| differs) else {
        return Ok((Box::new(plan), Judged::default()));
    };
    let mut judged = judge.judged([model, &plan.model], changes.clone(), &new_limits);
    if judged.question.is_none()
        && let Some(confirmed) = &judge.confirmed_model
    {
        let since_confirmed = judge.judged([confirmed, &plan.model], changes, &new_limits);
        judged.question = since_confirmed.question;
    }
    Ok((Box::new(plan), judged))
}

/// Rejects changes of keys that are fixed while the gateway runs.
fn can_change(old: &Config, config: &Config) -> Result<(), GatewayError> {
    let fixed = |config: &Config| {
        // Without limits the cycle runs with those of the simulation.
        let guard = config.guard_settings().unwrap_or_else(simulate::guard);
        (
            guard.hand_back,
            guard.temperatures,
            guard.fading,
            guard.rotary_step,
            guard.rapid,
        )
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

    /// A DBC file was changed while the gateway ran: the step of 1 µm became 0.1 µm for the limits, while the open controller
    /// and the control kept the old one, and each correction was ten times too large.
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
        let options = Options {
            config: Some(dir.path().join("gateway.toml")),
            ..Options::default()
        };
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

    /// A gateway that was started without limits took other speeds together with limits: `check` showed them, and the cycle went on
    /// with those of its start.
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
