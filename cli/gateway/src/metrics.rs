//! Prometheus text.

use std::fmt::Write;

use serde_json::Value;
use volcomp_port::Description;

use crate::{
    report::Report,
    times::{Stretch, Times},
};

const STATES: [&str; 6] = ["disarmed", "arming", "compensating", "holding", "ramping-out", "faulted"];

/// All metrics.
pub(crate) fn text(state: &Value, report: &Report, times: &Times, controllers: &[Description]) -> String {
    let mut out = String::new();
    let mut metric = |name: &str, kind: &str, help: &str, lines: &[(String, f64)]| {
        // Writing to a string never fails.
        let _ = writeln!(out, "# HELP volcomp_{name} {help}\n# TYPE volcomp_{name} {kind}");
        for (labels, value) in lines {
            let _ = writeln!(out, "volcomp_{name}{labels} {value}");
        }
    };
    let one = |value: f64| vec![(String::new(), value)];
    let states = STATES.map(|name| (format!("{{state=\"{name}\"}}"), f64::from(u8::from(report.state.name() == name))));
    metric("state", "gauge", "1 for the state of the guard", &states);
    metric("cycles_total", "counter", "Cycles so far", &one(report.cycle as f64));
    metric("overruns_total", "counter", "Periods missed", &one(report.overruns as f64));
    metric("faults_total", "counter", "Exchanges with controllers that failed", &one(report.faults as f64));
    metric("held_back_total", "counter", "Cycles in which slew or acceleration held the correction back", &one(report.held_back as f64));
    metric("active_controller", "gauge", "Place of the controller that corrects", &one(report.active as f64));
    metric("controllers", "gauge", "Controllers configured", &one(controllers.len() as f64));
    let of = |key: &str, label: &str| -> Vec<(String, f64)> {
        let values = state[key].as_object().into_iter().flatten();
        values.filter_map(|(name, value)| Some((format!("{{{label}=\"{name}\"}}"), value.as_f64()?))).collect()
    };
    metric("position_mm", "gauge", "Position of a linear axis without correction", &of("positions_mm", "axis"));
    metric("position_deg", "gauge", "Position of a rotary axis without correction", &of("positions_deg", "axis"));
    metric("correction_um", "gauge", "Correction of a linear axis", &of("correction_um", "axis"));
    metric("correction_urad", "gauge", "Correction of a rotary axis", &of("correction_urad", "axis"));
    let temperatures = state["temperatures"].as_array().into_iter().flatten();
    let degc: Vec<(String, f64)> = temperatures.filter_map(|t| Some((format!("{{sensor={}}}", t["name"]), t["degc"].as_f64()?))).collect();
    metric("temperature_degc", "gauge", "Temperature of a sensor that is used", &degc);
    let reasons = state["reasons"].as_array().into_iter().flatten();
    let reasons: Vec<(String, f64)> = reasons.map(|reason| (format!("{{reason={reason}}}"), 1.0)).collect();
    metric("reason", "gauge", "1 for each reason of the state", &reasons);
    let quantiles = |stretch: &Stretch| {
        [0.5, 0.99, 1.0].map(|q| (format!("{{quantile=\"{q}\"}}"), stretch.quantile_us(q) * 1e-6)).to_vec()
    };
    metric("cycle_seconds", "gauge", "Time of a whole cycle, last stretch", &quantiles(&times.whole));
    metric("own_seconds", "gauge", "CPU time of a cycle without exchanges, last stretch", &quantiles(&times.own));
    metric("wake_seconds", "gauge", "From the deadline to waking, last stretch", &quantiles(&times.wake));
    metric("exchange_seconds", "gauge", "Exchanges with controllers, last stretch", &quantiles(&times.exchange));
    out
}
