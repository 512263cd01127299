//! A simulated machine with its gateway, as far as the centre sees it: it takes signed models, corrects by them, and tells its
//! condition. What it really is differs a little from its model, and it warms up.

use std::{collections::BTreeMap, time::Duration};

use serde_json::json;
use tokio::time::{Instant, MissedTickBehavior};
use volcomp_fleet::{
    Acknowledgement, Condition, Desired, Envelope, Kind, LinkSettings, MachineLink, ModelRef,
    Outcome, Trust, VerifyingKey,
};
use volcomp_model::{
    Machine as Model, Temperatures, corrected,
    kinematics::{Form, State},
    quantised,
};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use super::DemoError;
use crate::{clock::now_s, models::NoModel, records::Machine, users::Token};

/// The correction ramps in within this time, s.
const RAMP_S: f64 = 5.0;
/// The machine is worse than its model says by this share.
const WORSE: f64 = 1.08;

pub(super) struct Simulated {
    machine: Machine,
    /// The machine as it is, whose error is a little larger.
    truth: Model,
    trust: Trust,
    instance: String,
    number: u64,
    begun: Instant,
    /// The model in force, its version, and since when.
    running: Option<(Model, u64, Instant)>,
    cycles: u64,
}

impl Simulated {
    pub(super) fn new(
        machine: &Machine,
        truth: &str,
        trusted: VerifyingKey,
    ) -> Result<Self, DemoError> {
        let truth = Model::parse(truth, "built-in").map_err(NoModel::from)?;
        let drawn = Token::draw().map_err(|e| DemoError::Key(e.to_string()))?;
        Ok(Self {
            machine: machine.clone(),
            truth,
            trust: Trust {
                keys: vec![trusted],
                machine: machine.identity.machine.clone(),
                serial: machine.serial.clone(),
                axes: machine.axes.clone(),
                highest: 0,
            },
            instance: drawn.text().chars().take(16).collect(),
            number: 0,
            begun: Instant::now(),
            running: None,
            cycles: 0,
        })
    }

    pub(super) async fn run(mut self, link: LinkSettings) {
        let Ok(mut link) = MachineLink::connect(&link, &self.machine.identity).await else {
            tracing::error!("demo: {} has no key", self.machine.identity.machine);
            return;
        };
        let mut conditions = tokio::time::interval(Duration::from_secs(1));
        let mut telemetry = tokio::time::interval(Duration::from_secs(5));
        conditions.set_missed_tick_behavior(MissedTickBehavior::Delay);
        telemetry.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let (kind, body) = tokio::select! {
                value = link.next_desired() => (Kind::Ack, self.desired(&value)),
                _ = conditions.tick() => (Kind::Condition, serde_json::to_value(self.condition())),
                _ = telemetry.tick() => (Kind::Telemetry, Ok(self.state())),
            };
            let Ok(body) = body else { continue };
            self.number += 1;
            let envelope = Envelope {
                instance: self.instance.clone(),
                number: self.number,
                uptime_s: self.begun.elapsed().as_secs_f64(),
                wall_s: now_s(),
                version: self.running.as_ref().map_or(0, |(_, version, _)| *version),
                model: self
                    .running
                    .as_ref()
                    .map_or_else(String::new, |(model, ..)| model.checksum()),
                body,
            };
            let id = format!("{}-{}", self.instance, self.number);
            let Ok(bytes) = serde_json::to_vec(&envelope) else {
                continue;
            };
            if let Err(error) = link.publish(kind, &id, bytes.into()).await {
                tracing::debug!("demo: {error}");
            }
        }
    }

    /// Takes a manifest, or refuses it.
    fn desired(&mut self, value: &[u8]) -> serde_json::Result<serde_json::Value> {
        let parsed = Desired::parse(value).map_err(|e| e.to_string());
        let taken = parsed.and_then(|desired| {
            let accepted = self.trust.accept(&desired).map_err(|e| e.to_string())?;
            let text = accepted.model.ok_or("the model is not in the manifest")?;
            let model = Model::parse(&text, "the model").map_err(|e| e.to_string())?;
            Ok((accepted.manifest, model))
        });
        let (version, outcome) = match taken {
            Ok((manifest, model)) => {
                self.trust.highest = manifest.version;
                let begun = Instant::now();
                self.running = manifest.enable.then_some((model, manifest.version, begun));
                (manifest.version, Outcome::Activated)
            }
            Err(why) => (0, Outcome::Refused { why }),
        };
        serde_json::to_value(Acknowledgement {
            version,
            value_sha256: ModelRef::of(value).sha256,
            outcome,
        })
    }

    /// Where the axes stand now: each goes to and fro in a time of its own.
    fn place(&self) -> State {
        let at_s = self.begun.elapsed().as_secs_f64();
        let coordinates: Vec<(AxisName, f64)> = (self.truth.axes().iter().enumerate())
            .map(|(index, axis)| {
                let [low, high] = axis.travel;
                let share = 0.5 + 0.45 * (at_s / (9.0 + 4.0 * index as f64)).sin();
                (axis.name, low + (high - low) * share)
            })
            .collect();
        self.truth.state(&coordinates).unwrap_or_default()
    }

    fn degc(&self) -> BTreeMap<String, Option<f64>> {
        let at_s = self.begun.elapsed().as_secs_f64();
        let warm = |name: &str, rise_k: f64, lag_s: f64| {
            let degc = 20.3 + rise_k * (1.0 - (-at_s / lag_s).exp());
            (name.to_owned(), Some((degc * 100.0).round() / 100.0))
        };
        BTreeMap::from([
            warm("bed", 0.8, 3600.0),
            warm("column", 2.4, 1800.0),
            warm("spindle", 8.0, 600.0),
        ])
    }

    /// The correction that is applied (mm, rad, in machine order), and the length of the error that is left, µm.
    fn corrected(&self, state: &State) -> (volcomp_vocabulary::PerAxis<f64>, f64) {
        let none = Temperatures::new();
        let mut delta = volcomp_vocabulary::PerAxis::ZERO;
        let error_mm = |at: &State| {
            let error = self.truth.error_at(at, Form::Exact, &none);
            error.position_mm * WORSE
        };
        let Some((model, _, since)) = &self.running else {
            return (delta, error_mm(state).norm() * 1e3);
        };
        let correction = model.correction_at(state, &none, &model.correction_options());
        let share = (since.elapsed().as_secs_f64() / RAMP_S).min(1.0);
        for (place, full) in delta.0.iter_mut().zip(correction.delta.0) {
            *place = full * share;
        }
        delta.0 = quantised(model, &delta.0, 1e-3, 1e-6);
        let moved = self.truth.chain().ideal_tip_mm(&corrected(state, &delta.0))
            - self.truth.chain().ideal_tip_mm(state);
        (delta, (error_mm(state) + moved).norm() * 1e3)
    }

    fn condition(&mut self) -> Condition {
        let state = self.place();
        let (delta, left_um) = self.corrected(&state);
        let mut correction_um = BTreeMap::new();
        let mut correction_urad = BTreeMap::new();
        for (axis, value) in self.machine.axes.iter().zip(delta.0) {
            match axis.kind() {
                AxisKind::Linear => correction_um.insert(*axis, value * 1e3),
                AxisKind::Rotary => correction_urad.insert(*axis, value * 1e6),
            };
        }
        let ramping = (self.running.as_ref())
            .is_some_and(|(_, _, since)| since.elapsed().as_secs_f64() < RAMP_S);
        let (name, reasons) = match &self.running {
            None => ("disarmed", vec!["no model was sent yet".to_owned()]),
            Some(_) if ramping => ("arming", Vec::new()),
            Some(_) => ("compensating", Vec::new()),
        };
        self.cycles += 500;
        Condition {
            state: name.to_owned(),
            reasons,
            armed: self.running.is_some(),
            correction_um,
            correction_urad,
            residual_um: Some(left_um),
            temperatures_degc: self.degc(),
            cycle_p99_us: 2010.0 + (self.cycles % 7000) as f64 / 100.0,
            overruns: 0,
            faults: 0,
        }
    }

    /// The whole state, as far as the page shows it.
    fn state(&self) -> serde_json::Value {
        let state = self.place();
        let mut positions_mm = BTreeMap::new();
        let mut positions_deg = BTreeMap::new();
        for (axis, q) in self.machine.axes.iter().zip(state.q.0) {
            let shown = Displacement::new(axis.kind(), q).mm_or_deg();
            match axis.kind() {
                AxisKind::Linear => positions_mm.insert(*axis, shown),
                AxisKind::Rotary => positions_deg.insert(*axis, shown),
            };
        }
        // How many cycles ended within each time, µs.
        let permille = [
            (1950, 2),
            (2000, 600),
            (2050, 370),
            (2100, 20),
            (2200, 7),
            (2500, 1),
        ];
        let histogram: Vec<(u64, u64)> = (permille.iter())
            .map(|&(edge, share)| (edge, self.cycles * share / 1000))
            .collect();
        json!({
            "simulated": true,
            "positions_mm": positions_mm,
            "positions_deg": positions_deg,
            "cycle": { "period_us": 2000.0, "count": self.cycles, "overruns": 0, "p99_us": 2090.0, "histogram_us": histogram },
        })
    }
}
