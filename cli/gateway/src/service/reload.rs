//! Configuration and machine file read again while the gateway runs.

use std::sync::Arc;

use volcomp_guard::Reasons;
use volcomp_runtime::{Order, Replacement};

use super::{
    Service,
    requests::{no_log, refused},
};
use crate::{
    audit::replace_file,
    config::Config,
    documents::{Answer, Event, Reloaded},
    error::{FixedKey, GatewayError, ReloadError},
    plan::Plan,
    request::Reply,
};

impl Service {
    /// Reads everything again. What cannot change while the gateway runs is named and refused.
    pub(super) fn reload(&mut self, who: &str, confirm: Option<&str>) -> Reply {
        let reply = self.reloaded(who, confirm);
        // The built-in configuration has no files that could differ from it.
        let refused = reply.status != 200 && self.parts.options.config.is_some();
        let told = self.tells.without(Reasons::NOT_RELOADED);
        self.tells = told | Reasons::NOT_RELOADED.when(refused);
        self.tell_thread();
        reply
    }

    fn reloaded(&mut self, who: &str, confirm: Option<&str>) -> Reply {
        match self.try_reload(who, confirm) {
            Ok(reply) => reply,
            Err(e) => {
                self.log(who, "reload refused", Event::Refused(e.to_string()));
                tracing::warn!("reload: {e}");
                refused(422, e.to_string())
            }
        }
    }

    fn try_reload(&mut self, who: &str, confirm: Option<&str>) -> Result<Reply, GatewayError> {
        if self.parts.options.config.is_none() {
            return Err(ReloadError::BuiltIn.into());
        }
        let config = self.parts.options.configuration()?;
        if config.guard.is_none() {
            let file = config.file;
            return Err(ReloadError::NoGuard { file }.into());
        }
        self.can_change_to(&config)?;
        let plan = Plan::new(config)?;
        if plan.model.axes != self.parts.model.axes {
            let machine = plan.config.machine;
            return Err(ReloadError::OtherAxes { machine }.into());
        }
        if let Some(question) = self.question(&Arc::clone(&self.parts.model), &plan.model, confirm)
        {
            tracing::warn!("reload: model {} must be confirmed", question.model);
            return Ok(Reply {
                status: 409,
                answer: Answer::Question(question),
            });
        }
        // Limits and model are taken together or not at all.
        if self.parts.handle.room() <= plan.limits().len() {
            return Ok(refused(503, "the control thread takes no orders"));
        }
        let event = Event::Reload {
            from: self.parts.model.hash.clone(),
            to: plan.model.hash.clone(),
        };
        if !self.log(who, "reload", event) {
            return Ok(no_log(self.last_state));
        }
        self.take(plan);
        Ok(Reply {
            status: 200,
            answer: Answer::Reloaded(Reloaded {
                model: self.parts.model.hash.clone(),
            }),
        })
    }

    /// Limits and model of a plan from now on.
    fn take(&mut self, plan: Plan) {
        for (index, limits) in plan.limits().into_iter().enumerate() {
            // There is room for all of them: only this thread sends.
            let _ = self
                .parts
                .handle
                .send(Order::Limits(index, Box::new(limits)));
        }
        let Plan { config, model, .. } = plan;
        if model.hash != self.parts.model.hash {
            if self.last_state.is_armed() {
                // The model that was confirmed last is now this one.
                let _ = replace_file(&self.confirmed_path(), &model.text);
            }
            let copy = Arc::new(model.clone());
            let replacement = Replacement::new(Box::new(model), &self.parts.sensors);
            let _ = self.parts.handle.send(Order::Model(Box::new(replacement)));
            self.publisher.set_model(Arc::clone(&copy));
            self.parts.model = copy;
        }
        self.parts.forbids = self.parts.forbids.without(Reasons::NO_LIMITS);
        self.parts.config = config;
        self.tell_thread();
    }

    /// Whether everything that stays as it is while the gateway runs is as it was.
    fn can_change_to(&self, config: &Config) -> Result<(), ReloadError> {
        let old = &self.parts.config;
        let fixed = |config: &Config| {
            let guard = config.guard.as_ref();
            guard.map(|guard| (guard.hand_back, guard.temperatures, guard.fading))
        };
        let guard = old.guard.is_none() || fixed(config) == fixed(old);
        let same = [
            (config.controllers == old.controllers, FixedKey::Controller),
            (
                config.thermometers == old.thermometers,
                FixedKey::Thermometer,
            ),
            (config.cycle == old.cycle, FixedKey::CycleMs),
            (config.dashboard == old.dashboard, FixedKey::Dashboard),
            (config.audit_dir == old.audit_dir, FixedKey::Audit),
            (config.realtime == old.realtime, FixedKey::Realtime),
            (guard, FixedKey::GuardTimes),
        ];
        match same.into_iter().find(|(same, _)| !same) {
            Some((_, key)) => Err(ReloadError::Changed {
                file: config.file.clone(),
                key,
            }),
            None => Ok(()),
        }
    }
}
