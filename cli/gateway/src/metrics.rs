//! Prometheus text.

use std::fmt::Write;

use serde_json::Value;
use volcomp_port::Description;

use crate::{
    report::Report,
    times::{Stretch, Times},
};

const STATES: [&str; 6] = [
    "disarmed",
    "arming",
    "compensating",
    "holding",
    "ramping-out",
    "faulted",
];

/// Lines of a metric: labels and value.
type Lines = Vec<(String, f64)>;

/// All metrics.
pub(crate) fn text(
    state: &Value,
    report: &Report,
    times: &Times,
    controllers: &[Description],
) -> String {
    let mut out = String::new();
    let one = |value: f64| vec![(String::new(), value)];
    for (name, help, value) in [
        ("cycles_total", "Cycles so far", report.cycle as f64),
        ("overruns_total", "Periods missed", report.overruns as f64),
        (
            "faults_total",
            "Exchanges with controllers that failed",
            report.faults as f64,
        ),
        (
            "held_back_total",
            "Cycles in which slew or acceleration held the correction back",
            report.held_back as f64,
        ),
    ] {
        metric(&mut out, name, "counter", help, &one(value));
    }
    for (name, help, lines) in [
        ("state", "1 for the state of the guard", states(report)),
        ("reason", "1 for each reason of the state", reasons(state)),
        (
            "active_controller",
            "Place of the controller that corrects",
            one(report.active as f64),
        ),
        (
            "controllers",
            "Controllers configured",
            one(controllers.len() as f64),
        ),
        (
            "position_mm",
            "Position of a linear axis without correction",
            axes(state, "positions_mm"),
        ),
        (
            "position_deg",
            "Position of a rotary axis without correction",
            axes(state, "positions_deg"),
        ),
        (
            "correction_um",
            "Correction of a linear axis",
            axes(state, "correction_um"),
        ),
        (
            "correction_urad",
            "Correction of a rotary axis",
            axes(state, "correction_urad"),
        ),
        (
            "temperature_degc",
            "Temperature of a sensor that is used",
            temperatures(state),
        ),
        (
            "cycle_seconds",
            "Time of a whole cycle, last stretch",
            quantiles(&times.whole),
        ),
        (
            "own_seconds",
            "CPU time of a cycle without exchanges, last stretch",
            quantiles(&times.own),
        ),
        (
            "wake_seconds",
            "From the deadline to waking, last stretch",
            quantiles(&times.wake),
        ),
        (
            "exchange_seconds",
            "Exchanges with controllers, last stretch",
            quantiles(&times.exchange),
        ),
    ] {
        metric(&mut out, name, "gauge", help, &lines);
    }
    out
}

fn metric(out: &mut String, name: &str, kind: &str, help: &str, lines: &[(String, f64)]) {
    // Writing to a string never fails.
    let _ = writeln!(
        out,
        "# HELP volcomp_{name} {help}\n# TYPE volcomp_{name} {kind}"
    );
    for (labels, value) in lines {
        let _ = writeln!(out, "volcomp_{name}{labels} {value}");
    }
}

fn states(report: &Report) -> Lines {
    let is = |name: &str| f64::from(u8::from(report.state.name() == name));
    STATES
        .iter()
        .map(|name| (format!("{{state=\"{name}\"}}"), is(name)))
        .collect()
}

fn reasons(state: &Value) -> Lines {
    let reasons = state["reasons"].as_array().into_iter().flatten();
    // JSON strings are quoted as labels are.
    reasons
        .map(|reason| (format!("{{reason={reason}}}"), 1.0))
        .collect()
}

fn axes(state: &Value, key: &str) -> Lines {
    let values = state[key].as_object().into_iter().flatten();
    let line =
        |(name, value): (&String, &Value)| Some((format!("{{axis=\"{name}\"}}"), value.as_f64()?));
    values.filter_map(line).collect()
}

fn temperatures(state: &Value) -> Lines {
    let list = state["temperatures"].as_array().into_iter().flatten();
    list.filter_map(|t| Some((format!("{{sensor={}}}", t["name"]), t["degc"].as_f64()?)))
        .collect()
}

fn quantiles(stretch: &Stretch) -> Lines {
    let line = |q: f64| {
        (
            format!("{{quantile=\"{q}\"}}"),
            stretch.quantile_us(q) * 1e-6,
        )
    };
    [0.5, 0.99, 1.0].map(line).to_vec()
}
