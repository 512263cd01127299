//! What the centre of the fleet decides: another machine file, and whether the machine may be corrected at all; and the machine
//! file that a person has chosen. Both go the way of a reload, through the same question and the same ramp, and end nothing that a person has decided.

use std::{path::PathBuf, sync::Arc};

use volcomp_guard::{Reasons, Request};

use super::{
    Service,
    arming::disk_silent,
    reload::{Reading, Whose, plan_with},
    requests::{Step, finish, refused, settled},
};
use crate::{
    config::Config,
    documents::Event,
    identity::Judge,
    request::{Ask, Asked, CentreAsk, ModelAsk, Reply},
};

impl Service {
    /// A request of the centre that waits for nothing.
    pub(super) fn centre_asks(&mut self, asked: Asked) {
        match &asked.ask {
            Ask::Centre(CentreAsk::Disable) => {
                self.parts.forbids |= Reasons::DISABLED_BY_CENTRE;
                self.tell_thread();
                // Again: between the order and its reason it may have armed itself.
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
            // They are carried out elsewhere.
            _ => {}
        }
        let report = *self.parts.handle.report();
        let reply = settled(200, report.state, self.all_reasons(&report), None);
        finish(&asked.who, asked.answer, reply);
    }

    /// Allows arming again. Where nothing but the centre stood against it, it arms itself as after the start.
    fn enable(&mut self, who: &str) {
        if !self.parts.forbids.contains(Reasons::DISABLED_BY_CENTRE) {
            return;
        }
        self.parts.forbids = self.parts.forbids.without(Reasons::DISABLED_BY_CENTRE);
        self.tell_thread();
        self.write_down(who, "enable");
        self.auto_arm_done &= self.person_decides;
    }

    /// Begins to read a machine file of the centre.
    pub(super) fn read_of_centre(
        &mut self,
        machine: PathBuf,
        confirm: Option<String>,
    ) -> Result<Step, Reply> {
        self.read_other(machine, confirm.clone(), Vec::new(), Whose::Centre(confirm))
    }

    /// Begins to read a machine file that a person has chosen. Where a centre has put one in force, it comes from there alone:
    /// a machine that corrects by another one than its centre believes is a surprise to everybody.
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

    /// Begins to read a machine file. Nothing else of the configuration changes, whatever stands on disk. `differences`: what must
    /// be confirmed besides a large move.
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
        Ok(Step::Reading(Reading::new(whose, told)))
    }

    /// Another machine file than the configured one is in force.
    pub(super) fn took_other(&mut self) {
        if self.last_state.is_armed() {
            self.must_confirm(false);
        } else {
            // What was armed last may be another one: arming will ask, and a confirmation that came with it has answered.
            self.ask_whether_confirmed();
            self.auto_arm_done &= self.person_decides;
            self.tell_thread();
        }
    }
}
