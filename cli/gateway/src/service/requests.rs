//! What a service is asked: arming, disarming, acknowledging, reloading.

use std::{
    path::PathBuf,
    sync::{Arc, PoisonError},
    time::{Duration, Instant},
};

use serde_json::Value;
use serde_json::json;
use volcomp_guard::{Reasons, Request, State};

use super::{Answer, Ask, Asked, Service};
use crate::{
    assemble, audit::replace_file, config::Config, cycle::Replacement, error::GatewayError,
    model::Model, realtime::Order, run::configuration,
};

/// A request has taken effect or not after so long.
const EFFECT: Duration = Duration::from_millis(300);

impl Service {
    pub(super) fn auto_arm(&mut self) {
        if !self.parts.config.auto_arm || self.auto_arm_done || Instant::now() < self.auto_arm_after
        {
            return;
        }
        self.auto_arm_after = Instant::now() + Duration::from_secs(1);
        let report = self.parts.handle.report();
        let against = report.reasons.without(Reasons::DOES_NOT_FORBID);
        if report.cycle > 1
            && report.state == State::Disarmed
            && against.is_empty()
            && self.parts.forbids.is_empty()
            && !self.audit_fails
        {
            let (status, answer) = self.arm("auto_arm", None);
            if status != 200 {
                tracing::warn!("auto_arm: {answer}");
                // A person must look at it.
                self.auto_arm_done = status == 409 && answer.get("model").is_some();
            }
        }
    }

    pub(super) fn answer(&mut self, asked: Asked) {
        let who = &asked.who;
        // From here on a person decides.
        self.auto_arm_done |= !matches!(asked.ask, Ask::Reload(_));
        let answer = match asked.ask {
            Ask::Arm(confirm) => self.arm(who, confirm.as_deref()),
            Ask::Disarm => self.request(who, "disarm", Request::Disarm, |state| !state.is_armed()),
            Ask::Acknowledge => self.request(who, "acknowledge", Request::Acknowledge, |state| {
                !matches!(state, State::Faulted(_))
            }),
            Ask::Reload(confirm) => self.reload(who, confirm.as_deref()),
        };
        if let Some(to) = asked.answer {
            // Whoever asked may have gone.
            let _ = to.send(answer);
        } else {
            tracing::info!("{who}: {}", answer.1);
        }
    }

    /// Logs a request, sends it, and waits for its effect.
    fn request(
        &mut self,
        who: &str,
        what: &str,
        request: Request,
        done: impl Fn(State) -> bool,
    ) -> Answer {
        let before = *self.parts.handle.report();
        let may = self.log(who, what, &json!({ "state": before.state.name() }));
        // A full disk forbids arming, never disarming.
        if !may && request == Request::Arm {
            return (
                409,
                json!({ "state": before.state.name(), "reasons": ["audit log cannot be written"] }),
            );
        }
        if !self.parts.handle.send(Order::Request(request)) {
            return (
                503,
                json!({ "error": "the control thread takes no orders" }),
            );
        }
        let end = Instant::now() + EFFECT.max(self.parts.config.cycle * 5);
        loop {
            let report = *self.parts.handle.report();
            // Two cycles: the order may have come in the middle of one.
            let seen = report.cycle > before.cycle + 2;
            if seen && done(report.state) || Instant::now() > end {
                let status = if done(report.state) { 200 } else { 409 };
                let reasons: Vec<&str> = (report.reasons | self.parts.forbids).texts().collect();
                return (
                    status,
                    json!({ "state": report.state.name(), "reasons": reasons }),
                );
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn confirmed_path(&self) -> PathBuf {
        self.parts.config.audit_dir.join("confirmed-machine.toml")
    }

    /// What a change from `old` must be confirmed for; `None`: nothing, or it is.
    /// Judged cold, and at the temperatures of now.
    fn needs_confirmation(
        &mut self,
        old: &Model,
        new: &Model,
        confirm: Option<&str>,
    ) -> Option<Value> {
        let report = *self.parts.handle.report();
        let guard = self.parts.config.guard.as_ref()?;
        let degc = |name: &str| {
            let place = self
                .parts
                .sensors
                .iter()
                .position(|sensor| sensor == name)?;
            report.sensors.get(place)?.degc
        };
        let cold = old.worst_corner(new);
        let warm = old.warmed(degc).worst_corner(&new.warmed(degc));
        let [worst_mm, worst_rad] = [cold[0].max(warm[0]), cold[1].max(warm[1])];
        let (worst_um, worst_urad) = (worst_mm * 1e3, worst_rad * 1e6);
        let rotary = guard
            .rotary
            .as_ref()
            .map_or(f64::INFINITY, |rotary| rotary.confirm);
        let moves = worst_um > guard.linear.confirm || worst_urad > rotary;
        if !moves || confirm == Some(new.hash.as_str()) {
            return None;
        }
        // An infinite number is none in JSON: machines with other axes.
        Some(
            json!({ "model": new.hash, "worst_corner_um": worst_um, "worst_corner_urad": worst_urad, "confirm_um": guard.linear.confirm }),
        )
    }

    fn arm(&mut self, who: &str, confirm: Option<&str>) -> Answer {
        let fading = self
            .parts
            .config
            .guard
            .as_ref()
            .map(|guard| guard.fading)
            .unwrap_or_default();
        let path = self.confirmed_path();
        // The model that was armed last, unless there was none.
        if let Ok(old) = Model::read(&path, fading)
            && old.hash != self.parts.model.hash
            && let Some(needed) =
                self.needs_confirmation(&old, &Arc::clone(&self.parts.model), confirm)
        {
            return (409, needed);
        }
        if let Err(e) = replace_file(&path, &self.parts.model.text) {
            tracing::error!("{}: {e}", path.display());
            return (
                409,
                json!({ "state": self.last_state.name(), "reasons": ["audit log cannot be written"] }),
            );
        }
        self.request(who, "arm", Request::Arm, |state| state != State::Disarmed)
    }

    /// Reads everything again. What cannot change while it runs is said.
    fn reload(&mut self, who: &str, confirm: Option<&str>) -> Answer {
        match self.try_reload(who, confirm) {
            Ok(answer) => answer,
            Err(e) => {
                self.log(who, "reload refused", &json!(e.to_string()));
                tracing::warn!("reload: {e}");
                (422, json!({ "error": e.to_string() }))
            }
        }
    }

    fn try_reload(&mut self, who: &str, confirm: Option<&str>) -> Result<Answer, GatewayError> {
        if self.parts.options.config.is_none() {
            let what = "the built-in configuration cannot be read again";
            return Err(GatewayError::Unfit(what.to_owned()));
        }
        let config = configuration(&self.parts.options)?;
        self.can_change_to(&config)?;
        let guard = config
            .guard
            .as_ref()
            .ok_or_else(|| GatewayError::Unfit("[guard] is missing".to_owned()))?;
        let limits = assemble::reloaded_limits(&config, guard, &self.parts.controllers)?;
        let model = Model::read(&config.machine, guard.fading)?;
        if model.axes != self.parts.model.axes {
            return Err(GatewayError::Unfit(format!(
                "{}: other axes than before: restart the gateway for that",
                config.machine.display()
            )));
        }
        if let Some(needed) =
            self.needs_confirmation(&Arc::clone(&self.parts.model), &model, confirm)
        {
            tracing::warn!("reload needs a confirmation: {needed}");
            return Ok((409, needed));
        }
        let details = json!({ "from": self.parts.model.hash, "to": model.hash });
        if !self.log(who, "reload", &details) {
            return Ok((409, json!({ "reasons": ["audit log cannot be written"] })));
        }
        for (index, limits) in limits.into_iter().enumerate() {
            self.parts
                .handle
                .send(Order::Limits(index, Box::new(limits)));
        }
        if model.hash != self.parts.model.hash {
            if self.last_state.is_armed() {
                // The confirmed one is now this.
                let _ = replace_file(&self.confirmed_path(), &model.text);
            }
            let copy = Arc::new(model.clone());
            self.parts
                .handle
                .send(Order::Model(Box::new(Replacement::new(
                    Box::new(model),
                    &self.parts.sensors,
                ))));
            *self
                .publisher
                .model
                .lock()
                .unwrap_or_else(PoisonError::into_inner) = Arc::clone(&copy);
            self.parts.model = copy;
        }
        self.parts.forbids = self.parts.forbids.without(Reasons::NO_LIMITS);
        self.parts.config = config;
        self.tell_thread();
        Ok((200, json!({ "model": self.parts.model.hash })))
    }

    /// Whether everything that stays as it is while the gateway runs is as it was.
    fn can_change_to(&self, config: &Config) -> Result<(), GatewayError> {
        let old = &self.parts.config;
        let fixed = |config: &Config| {
            config.guard.as_ref().map(|guard| {
                let temperature = (
                    guard.max_degc_per_min,
                    guard.range_degc,
                    guard.temperature_stale,
                    guard.fading,
                );
                (guard.hand_back, temperature)
            })
        };
        let same = [
            (config.controllers == old.controllers, "[[controller]]"),
            (config.thermometers == old.thermometers, "[[thermometer]]"),
            (config.cycle == old.cycle, "cycle_ms"),
            (config.dashboard == old.dashboard, "[dashboard]"),
            (config.audit_dir == old.audit_dir, "[audit]"),
            (config.realtime == old.realtime, "[realtime]"),
            (
                old.guard.is_none() || fixed(config) == fixed(old),
                "[guard] hand_back_s or a key of temperatures",
            ),
        ];
        match same.iter().find(|(same, _)| !same) {
            Some((_, what)) => Err(GatewayError::Unfit(format!(
                "{what} changed: restart the gateway for that"
            ))),
            None => Ok(()),
        }
    }
}
