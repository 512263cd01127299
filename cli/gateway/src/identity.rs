//! The content that an operator confirms: a machine file with the limits of its correction, the controllers and the
//! thermometers.
//!
//! Differences between two models can show that the new model belongs to another machine.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use serde_json::Value;
use sha2::{Digest, Sha256};
use volcomp_model::{Axis, Fading, Machine};
use volcomp_port::Description;
use volcomp_runtime::{LargestMove, Model};
use volcomp_vocabulary::{AxisName, Um};

use crate::{
    config::Config,
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

/// Signs that a model belongs to another machine, one sentence each. Error curves are not compared here.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Differences {
    /// Why the new model cannot be activated on this machine; `None` if there is no such reason.
    pub refusal: Option<String>,
    /// Differences that an operator must confirm, however small the change of the correction.
    pub to_confirm: Vec<String>,
}

/// Compares a model with the model that it replaces. `before` is the name of the replaced model in the sentences, such
/// as "the active model". A different structure needs confirmation but is not refused, because the earlier model may
/// have been wrong (GUARD rule 13 covers structures as well).
pub(crate) fn differences(new: &Machine, in_force: &Machine, before: &str) -> Differences {
    let letters = |machine: &Machine| {
        let mut letters: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
        letters.sort_unstable();
        letters
    };
    let (axes, axes_in_force) = (letters(new), letters(in_force));
    let refusal = (axes != axes_in_force).then(|| {
        format!(
            "This model has the axes {}, {before} has {}: it belongs to another machine and cannot be activated here.",
            listed(&axes),
            listed(&axes_in_force)
        )
    });
    let mut to_confirm = Vec::new();
    if new.name != in_force.name {
        to_confirm.push(format!(
            "This model is of {}, {before} is of {}.",
            called(&new.name),
            called(&in_force.name)
        ));
    }
    let structures = [new, in_force].map(|machine| machine.chain().structure().to_string());
    let [structure, in_force_structure] = &structures;
    if structure != in_force_structure {
        to_confirm.push(format!(
            "The structure is {structure} in this model, {in_force_structure} in {before}."
        ));
    }
    for axis in new.axes() {
        let same = |other: &&Axis| other.name == axis.name;
        if let Some(other) = in_force.axes().iter().find(same)
            && other.travel != axis.travel
        {
            to_confirm.push(format!(
                "{} travels {} in this model, {} in {before}.",
                axis.name,
                travel(axis),
                travel(other)
            ));
        }
    }
    Differences { refusal, to_confirm }
}

/// Name of the replaced model in the sentences, for a reload or an activation.
pub(crate) const ACTIVE: &str = "the active model";

fn called(name: &str) -> String {
    match name {
        "" => "a machine without a name".to_owned(),
        name => format!("“{name}”"),
    }
}

fn travel(axis: &Axis) -> String {
    let [low, high] = axis.travel.map(|end| end.to_string().replace('-', "−"));
    format!("from {low} to {high} {}", axis.name.kind().coordinate_unit())
}

/// The names as text: "X, Y and Z".
fn listed(axes: &[AxisName]) -> String {
    let names: Vec<String> = axes.iter().map(ToString::to_string).collect();
    match &names[..] {
        [] => "none".to_owned(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;
    use volcomp_port::{Axis, Heartbeat, ShownStates};
    use volcomp_vocabulary::{AxisName, Displacement};

    use super::*;
    use crate::config::GuardTable;

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

    fn machine(text: &str) -> Machine {
        Machine::parse(text, "m").expect("right")
    }

    const SMALL: &str = "name = \"gantry-3000\"\nstructure = \"w b X Y t\"\naxes.X.travel = [0.0, 3000.0]\naxes.Y.travel = [-1.5, 400.0]\n[errors]\nEXX = 3.0\n";

    #[test]
    fn other_errors_alone_are_no_difference() {
        let other = machine(&SMALL.replace("3.0\n", "9.0\n"));
        let found = differences(&other, &machine(SMALL), ACTIVE);
        assert_eq!(found, Differences::default());
    }

    #[test]
    fn each_difference_is_a_sentence() {
        let other = SMALL
            .replace("gantry-3000", "gantry-8000")
            .replace("w b X Y t", "w X' b Y t")
            .replace("3000.0", "8000.0");
        let found = differences(&machine(&other), &machine(SMALL), ACTIVE);
        assert_eq!(found.refusal, None);
        assert_eq!(
            found.to_confirm,
            [
                "This model is of “gantry-8000”, the active model is of “gantry-3000”.",
                "The structure is w X' b Y t in this model, w b X Y t in the active model.",
                "X travels from 0 to 8000 mm in this model, from 0 to 3000 mm in the active model.",
            ]
        );
    }

    #[test]
    fn other_axes_are_another_machine() {
        let more = SMALL
            .replace("X Y t", "X Y Z t")
            .replace("axes.Y", "axes.Z.travel = [0.0, 1.0]\naxes.Y");
        let found = differences(&machine(&more), &machine(SMALL), ACTIVE);
        let refusal = found.refusal.expect("a reason");
        assert!(
            refusal.contains("the axes X, Y and Z, the active model has X and Y:"),
            "{refusal}"
        );
    }
}
