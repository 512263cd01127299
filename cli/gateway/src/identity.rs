//! What an operator confirms: a machine file together with the limits of its correction, the controllers and the thermometers.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use serde_json::Value;
use sha2::{Digest, Sha256};
use volcomp_model::{Fading, Machine};
use volcomp_port::Description;
use volcomp_runtime::{LargestMove, Model};
use volcomp_vocabulary::Um;

use crate::{
    config::Config,
    differences::differences,
    documents::{ConfirmedLimits, LimitChanges, Question},
};

/// Keys of `[guard]` whose changes need confirmation: limits, rates, accelerations, hold and ramp times, thresholds of
/// confirmation, test shifts, and the rotary step.
const CONFIRMED_KEYS: [&str; 17] = [
    "limit_um",
    "slew_um_per_s",
    "accel_um_per_s2",
    "confirm_um",
    "test_shift_um",
    "limit_urad",
    "slew_urad_per_s",
    "accel_urad_per_s2",
    "confirm_urad",
    "test_shift_urad",
    "limit_without_barrier_um",
    "limit_without_barrier_urad",
    ROTARY_STEP,
    "hold_ms",
    "zero_after_ms",
    "ramp_s",
    "stop_s",
];

/// Key of the tool-tip step above which a rotary axis is not corrected. It determines which axes are corrected.
const ROTARY_STEP: &str = "rotary_step_um";

/// Two models are also compared at temperatures shifted by this amount below and above the current ones, K.
const SHIFT_K: f64 = 10.0;

/// End of the key of a controller to which only thermal terms are applied; other controllers have no such entry.
const ONLY_THERMAL: &str = ".terms = [\"thermal\"]";

/// Tables that decide which axes of which control are read and written, and which sensors are read.
const CONFIRMED_TABLES: [&str; 2] = ["controller", "thermometer"];

/// The limits of a configuration, and its controllers and thermometers, by key; empty without `[guard]`. An unlimited
/// acceleration has no entry.
pub(crate) fn limits(config: &Config) -> ConfirmedLimits {
    let Some(guard) = &config.guard else {
        return ConfirmedLimits::new();
    };
    let keys = serde_json::to_value(guard).unwrap_or_default();
    let has_rotary = guard.limit_urad.is_some();
    let mut limits: ConfirmedLimits = CONFIRMED_KEYS
        .into_iter()
        .filter(|key| has_rotary || *key != ROTARY_STEP)
        .filter_map(|key| Some((key.to_owned(), keys.get(key)?.as_f64()?)))
        .collect();
    let effective = config.effective();
    for table in CONFIRMED_TABLES {
        let devices = effective.get(table).and_then(Value::as_array).into_iter().flatten();
        for (index, device) in devices.enumerate() {
            add_values(&mut limits, format!("{table}[{index}]"), device);
        }
    }
    limits
}

/// Adds an entry for each value below a key. A value that is not a number becomes part of the key, with the entry 1.
fn add_values(entries: &mut ConfirmedLimits, key: String, value: &Value) {
    if let Value::Object(table) = value {
        for (name, value) in table {
            add_values(entries, format!("{key}.{name}"), value);
        }
    } else if let Some(number) = value.as_f64() {
        entries.insert(key, number);
    } else {
        entries.insert(format!("{key} = {value}"), 1.0);
    }
}

/// The limits that differ, as old and new value; `None`: that configuration has no such entry.
pub(crate) fn changes(old: &ConfirmedLimits, new: &ConfirmedLimits) -> LimitChanges {
    let keys: BTreeSet<&String> = old.keys().chain(new.keys()).collect();
    keys.into_iter()
        .map(|key| (key.clone(), [old.get(key).copied(), new.get(key).copied()]))
        .filter(|(_, [old, new])| old != new)
        .collect()
}

pub(crate) struct Judge {
    /// Current temperatures by sensor name, °C.
    pub degc: BTreeMap<String, f64>,
    /// The running model, with the current states of its lags.
    pub running: Model,
    /// The controllers: the axes that each one writes, and the steps of their corrections.
    pub controllers: Vec<Description>,
    /// Tool-tip step above which a rotary axis is not corrected.
    pub rotary_step: Um,
    /// Largest change of a linear axis that needs no confirmation, µm.
    pub confirm_um: f64,
    /// Largest change of a rotary axis that needs no confirmation, µrad.
    pub confirm_urad: Option<f64>,
    /// Hash that the operator has confirmed for the new model; `None`: nothing was confirmed.
    pub confirmed: Option<String>,
    /// While armed: the model that an operator confirmed last. Unconfirmed changes of a reload are measured from it, so
    /// that small changes cannot add up.
    pub confirmed_model: Option<Arc<Model>>,
    /// Name of the replaced model in the texts of differences, such as "the active model".
    pub before: &'static str,
}

impl Judge {
    /// Returns the largest change of the correction if `new` replaces `old`, and the question to confirm, if any. The
    /// change is the maximum over:
    /// - the reference temperature, which is used for a sensor without a reading;
    /// - the steady state at the current temperatures and at ±[`SHIFT_K`] from them, because a changed thermal term has
    ///   no effect at the reference temperature;
    /// - the present state, with the lags of the running model;
    /// - if [`ONLY_THERMAL`] changes for a controller, the models as this controller applies them, without errors where
    ///   it applies thermal terms only.
    pub(crate) fn judged(
        &self,
        [old, new]: [&Model; 2],
        limits: LimitChanges,
        to: &ConfirmedLimits,
    ) -> Judgement {
        let degc = |name: &str| self.degc.get(name).copied();
        let steps = match limits.get(ROTARY_STEP) {
            Some(&[before, after]) => [before, after].map(|step| step.map_or(self.rotary_step, Um)),
            None => [self.rotary_step; 2],
        };
        let of = |model: &Model, controller: &Description, step: Um| {
            model.correctors_of(controller, step.to_mm())
        };
        let ways = || {
            let controllers = self.controllers.iter();
            let controllers = controllers.filter(|controller| !controller.axes.is_empty());
            controllers.map(|it| [of(old, it, steps[0]), of(new, it, steps[1])])
        };
        let cold = old.largest_move(new, ways());
        let parsed = Machine::parse(&new.text, &new.name);
        let reference = parsed.map_or(20.0, |new| new.thermal().reference_degc);
        let warm = [-SHIFT_K, 0.0, SHIFT_K].map(|by| {
            let degc = |name: &str| Some(degc(name).unwrap_or(reference) + by);
            old.warmed(degc).largest_move(&new.warmed(degc), ways())
        });
        let [old_now, new_now] = [old, new].map(|model| model.in_place_of(&self.running, degc));
        let worst = warm.into_iter().fold(cold, LargestMove::max);
        let worst = worst.max(old_now.largest_move(&new_now, ways()));
        let worst = match with_terms([old, new], &limits) {
            Some([old, new]) => worst.max(old.largest_move(&new, ways())),
            None => worst,
        };
        let (worst_um, worst_urad) = (worst.linear.to_um().0, worst.rotary.to_urad().0);
        let moves =
            worst_um > self.confirm_um || worst_urad > self.confirm_urad.unwrap_or(f64::INFINITY);
        let hash = hash(new, &limits, to);
        let differences = self.differences([old, new]);
        let is_small = !moves && limits.is_empty() && differences.is_empty();
        let is_confirmed = self.confirmed.as_ref() == Some(&hash);
        // If the new model has other axes, the change is infinite, which JSON cannot represent.
        let finite = |x: f64| x.is_finite().then_some(x);
        // Without limits for rotary axes no rotary axis is corrected, so none can move.
        let worst = [finite(worst_um), self.confirm_urad.and(finite(worst_urad))];
        if is_small || is_confirmed {
            return Judgement { worst, question: None, is_confirmed };
        }
        let question = Question {
            model: hash,
            worst_corner_um: worst[0],
            worst_corner_urad: worst[1],
            confirm_um: self.confirm_um,
            confirm_urad: self.confirm_urad,
            limits,
            differences,
        };
        Judgement { worst, question: Some(question), is_confirmed }
    }

    /// Signs that `new` belongs to another machine, one sentence each. They need confirmation, however small the
    /// change.
    fn differences(&self, [old, new]: [&Model; 2]) -> Vec<String> {
        match [old, new].map(|model| Machine::parse(&model.text, &model.name)) {
            [Ok(old), Ok(new)] => differences(&new, &old, self.before).to_confirm,
            // The texts of models are written from parsed machines, so this does not occur. The change of the
            // correction is judged anyway.
            _ => Vec::new(),
        }
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Judgement {
    /// Largest change of the correction, µm and µrad; `None`: infinite, or the rotary axes are not corrected.
    pub(crate) worst: [Option<f64>; 2],
    pub(crate) question: Option<Question>,
    /// True if an operator confirmed this change by its hash.
    pub(crate) is_confirmed: bool,
}

/// The old and the new model as applied by a controller whose `terms` change. A model under which the controller
/// applies thermal terms only has no errors. `None` if no controller's `terms` change.
fn with_terms(models: [&Model; 2], changes: &LimitChanges) -> Option<[Model; 2]> {
    let mut changes = changes.iter();
    let (_, only_thermal) = changes.find(|(key, _)| key.ends_with(ONLY_THERMAL))?;
    let [old, new] = [0, 1].map(|at| {
        if only_thermal[at].is_none() {
            return Some(models[at].clone());
        }
        let mut machine = Machine::parse(&models[at].text, &models[at].name).ok()?;
        machine.clear_errors();
        Model::new(&machine, Fading::default()).ok()
    });
    Some([old?, new?])
}

/// Hash that confirms a change: of the machine file, and also of the new limits if limits change.
fn hash(model: &Model, changes: &LimitChanges, limits: &ConfirmedLimits) -> String {
    if changes.is_empty() {
        return model.hash.clone();
    }
    let mut digest = Sha256::new().chain_update(&model.hash);
    for (key, value) in limits {
        digest.update(format!("\n{key} = {value}"));
    }
    format!("sha256:{}", volcomp_model::hexadecimal(&digest.finalize()))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;
    use volcomp_port::{Axis, Heartbeat, ShownStates};

    use volcomp_vocabulary::{AxisName, Displacement};

    use super::*;
    use crate::{config::GuardTable, differences::ACTIVE};

    fn model() -> Model {
        model_with("")
    }

    fn model_with(thermal: &str) -> Model {
        let text = "structure = \"w X' b Y Z A t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 600.0]\n[axes.Z]\ntravel = [-500.0, 0.0]\n[axes.A]\ntravel = [0.0, 90.0]\n[tool]\ntip = [0.0, 0.0, -100.0]\n[errors]\nEAA = 200.0\n";
        let machine = Machine::parse(&format!("{text}{thermal}"), "m").expect("valid");
        Model::new(&machine, Fading::default()).expect("compiles")
    }

    fn controller() -> Description {
        let axis = |name: AxisName| Axis {
            name,
            includes_correction: false,
            resolution: Displacement::from_micro(name.kind(), 1.0),
            largest: None,
        };
        Description {
            device: "control".to_owned(),
            channel: "one".to_owned(),
            axes: [AxisName::X, AxisName::Y, AxisName::Z, AxisName::A].map(axis).to_vec(),
            reads: Vec::new(),
            heartbeat: Heartbeat::Watched,
            barrier: false,
            tells_applied: true,
            shown: ShownStates::ALL,
            sees_other_gateways: true,
            shortest_cycle: Duration::from_millis(1),
        }
    }

    fn settings(rotary_step_um: f64) -> Config {
        let guard = GuardTable {
            limit_um: 100.0,
            slew_um_per_s: 500.0,
            limit_urad: Some(300.0),
            slew_urad_per_s: Some(500.0),
            rotary_step_um,
            ..GuardTable::default()
        };
        Config { guard: Some(guard), ..Config::default() }
    }

    fn judge_at(degc: BTreeMap<String, f64>) -> Judge {
        Judge {
            degc,
            running: model(),
            controllers: vec![controller()],
            rotary_step: Um(0.01),
            confirm_um: 5.0,
            confirm_urad: Some(5.0),
            confirmed: None,
            confirmed_model: None,
            before: ACTIVE,
        }
    }

    /// Closed form: at the reference temperature a changed expansion coefficient has no effect; at 10 K from it the
    /// correction at X = 800 mm changes by 8 µm. While the sensor is silent the change is the same.
    #[test]
    fn another_expansion_is_a_question_at_the_reference_temperature() {
        let [old, new] = [11.5, 12.5].map(|k| {
            model_with(&format!(
                "[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale\"\num_per_m_k = {k}\n"
            ))
        });
        let to = limits(&settings(0.01));
        let read = BTreeMap::from([("scale".to_owned(), 20.0)]);
        let silent = BTreeMap::new();
        for judge in [read, silent].map(judge_at) {
            let judged = |models| judge.judged(models, LimitChanges::new(), &to).question;
            assert_eq!(judged([&old, &old]), None);
            let um = judged([&old, &new]).and_then(|question| question.worst_corner_um);
            assert!(um.is_some_and(|um| (um - 8.0).abs() < 0.1), "{um:?}");
        }
    }

    /// Half a step of A moves the tip by 0.05 µm. With a lower limit A is no longer corrected, and the axes move.
    #[test]
    fn another_rotary_step_is_a_question_with_its_move() {
        let [old, new] = [10.0, 0.01].map(|step| limits(&settings(step)));
        let judge = judge_at(BTreeMap::new());
        let judged = |to| judge.judged([&model(); 2], changes(&old, to), to).question;
        assert_eq!(judged(&old), None);
        let question = judged(&new).expect("A falls out of the correction");
        assert_eq!(question.limits["rotary_step_um"], [Some(10.0), Some(0.01)]);
        let urad = question.worst_corner_urad.expect("the same axes");
        assert!(urad > 199.0, "{urad}");
    }
}
