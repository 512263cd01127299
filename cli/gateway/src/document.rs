//! What `GET /api/state` answers.

use std::time::Duration;

use serde_json::{Map, Value, json};
use volcomp_port::Description;

use crate::{
    model::Model,
    report::{Report, SENSOR_TEXTS},
    simulate::Truth,
    times::{Stretch, Times},
};

/// What stays the same while a gateway runs.
pub(crate) struct Facts<'a> {
    /// The model.
    pub model: &'a Model,
    /// The controllers in order.
    pub controllers: &'a [Description],
    /// Names of the temperatures.
    pub sensors: &'a [String],
    /// What a simulated machine really misses.
    pub truth: Option<&'a Truth>,
    /// Whether it arms itself.
    pub auto_arm: bool,
    /// Time of a cycle.
    pub cycle: Duration,
}

/// The document.
pub(crate) fn document(facts: &Facts<'_>, report: &Report, times: &Times) -> Value {
    let model = facts.model;
    let mut state = json!({
        "state": report.state.name(),
        "reasons": report.reasons.texts().collect::<Vec<_>>(),
        "armed": report.state.is_armed(),
        "auto_arm": facts.auto_arm,
        "simulated": facts.truth.is_some(),
        "machine": { "name": model.name, "hash": model.hash, "axes": model.axes.iter().map(ToString::to_string).collect::<Vec<_>>() },
        "controller": facts.controllers.get(report.active).map(|controller| json!({
            "device": controller.device,
            "channel": controller.channel,
            "number": report.active,
        })),
        "temperatures": temperatures(facts, report),
        "error_um": report.error[..3].iter().map(|mm| round(mm * 1e3)).collect::<Vec<_>>(),
        "error_urad": report.error[3..].iter().map(|rad| round(rad * 1e6)).collect::<Vec<_>>(),
        "held_back": report.held_back,
        "faults": report.faults,
        "uptime_s": round(report.now.as_secs_f64()),
        "cycle": cycle(facts, report, times),
    });
    let known = |index: usize| report.known >> index & 1 == 1;
    put(
        &mut state,
        "positions",
        model,
        &report.positions[..],
        known,
        ["mm", "deg"],
        [1.0, 180.0 / std::f64::consts::PI],
    );
    put(
        &mut state,
        "correction",
        model,
        &report.correction[..],
        |_| true,
        ["um", "urad"],
        [1e3, 1e6],
    );
    put(
        &mut state,
        "wanted",
        model,
        &report.wanted[..],
        known,
        ["um", "urad"],
        [1e3, 1e6],
    );
    if let Some(truth) = facts.truth {
        let degc: Vec<f64> = report
            .sensors
            .iter()
            .take(facts.sensors.len())
            .map(|sensor| sensor.degc.unwrap_or(20.0))
            .collect();
        let micrometres = |v: volcomp_kinematics::nalgebra::Vector3<f64>| {
            v.iter().map(|mm| round(mm * 1e3)).collect::<Vec<_>>()
        };
        state["true_error_um"] = json!(micrometres(truth.error(&report.positions, &degc)));
        state["residual_um"] = json!(micrometres(truth.residual(
            &report.positions,
            &report.correction,
            &degc
        )));
    }
    state
}

/// Linear axes under one key, rotary ones under the other.
fn put(
    state: &mut Value,
    name: &str,
    model: &Model,
    values: &[f64],
    known: impl Fn(usize) -> bool,
    units: [&str; 2],
    factors: [f64; 2],
) {
    for (kind, (unit, factor)) in units.into_iter().zip(factors).enumerate() {
        let of_kind = model
            .axes
            .iter()
            .enumerate()
            .filter(|(index, name)| usize::from(name.is_rotary()) == kind && known(*index));
        let values: Map<String, Value> = of_kind
            .map(|(index, name)| (name.to_string(), json!(round(values[index] * factor))))
            .collect();
        if kind == 0 || !values.is_empty() {
            state[format!("{name}_{unit}")] = Value::Object(values);
        }
    }
}

fn temperatures(facts: &Facts<'_>, report: &Report) -> Vec<Value> {
    let pairs = facts.sensors.iter().zip(&report.sensors);
    pairs
        .map(|(name, sensor)| {
            let quality = if sensor.degc.is_some() { "good" } else { "bad" };
            let flaw = usize::from(sensor.flaw);
            let reason = (flaw > 0).then(|| SENSOR_TEXTS.get(flaw).copied().unwrap_or("bad"));
            json!({ "name": name, "degc": sensor.degc.map(round), "quality": quality, "reason": reason })
        })
        .collect()
}

fn cycle(facts: &Facts<'_>, report: &Report, times: &Times) -> Value {
    let three = |stretch: &Stretch| [0.5, 0.99, 1.0].map(|q| round(stretch.quantile_us(q)));
    let [p50, p99, most] = three(&times.whole);
    let named = |stretch: &Stretch| {
        let [p50, p99, most] = three(stretch);
        json!({ "p50_us": p50, "p99_us": p99, "max_us": most })
    };
    json!({
        "count": report.cycle,
        "period_us": round(facts.cycle.as_secs_f64() * 1e6),
        "p50_us": p50, "p99_us": p99, "max_us": most,
        "overruns": report.overruns,
        "own": named(&times.own),
        "wake": named(&times.wake),
        "exchange": named(&times.exchange),
        "histogram_us": times.whole.bins_us(),
    })
}

/// Three digits behind the point; a number that is none becomes null.
fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
