//! The state in the Prometheus text format: the table of quantities and the cycle times.

use std::fmt::Write;

use crate::{
    documents::{StateName, Status, StretchTimes},
    interop::quantities::{self, Kind, Part, Quantity, Unit, Value},
};

struct Metric {
    name: String,
    help: &'static str,
    kind: &'static str,
    lines: Vec<(String, f64)>,
}

/// Formats all metrics of a state.
pub fn text(status: &Status, quantities: &[Quantity]) -> String {
    let mut metrics = vec![
        Metric {
            name: "state".to_owned(),
            help: "1 for the state of the gateway, 0 for the others",
            kind: "gauge",
            lines: states(status),
        },
        Metric {
            name: "reason".to_owned(),
            help: "1 for each reason of the state",
            kind: "gauge",
            lines: reasons(status),
        },
        Metric {
            name: "cycles_total".to_owned(),
            help: "Cycles so far",
            kind: "counter",
            lines: vec![(String::new(), status.cycle.count as f64)],
        },
    ];
    for quantity in quantities.iter().filter(|own| own.kind != Kind::Text) {
        let name = name(quantity);
        let metric = metrics.iter_mut().position(|metric| metric.name == name);
        let metric = metric.unwrap_or_else(|| {
            metrics.push(Metric {
                name,
                help: quantity.help,
                kind: match quantity.kind {
                    Kind::Count => "counter",
                    _ => "gauge",
                },
                lines: Vec::new(),
            });
            metrics.len() - 1
        });
        if let Some(value) = value(quantity, status) {
            metrics[metric].lines.push((labels_of(quantity), value));
        }
    }
    metrics.extend(times(status));
    let mut out = String::new();
    for metric in metrics {
        write_metric(&mut out, &metric);
    }
    out
}

fn name(quantity: &Quantity) -> String {
    let part = match quantity.part {
        Part::Tool => "tool_",
        Part::Controller(_) => "path_",
        Part::Gateway | Part::Axis(_) | Part::Sensor(_) => "",
    };
    let unit = match quantity.kind {
        Kind::Number(Unit::Mm) => "_mm",
        Kind::Number(Unit::Deg) => "_deg",
        Kind::Number(Unit::Um) => "_um",
        Kind::Number(Unit::Urad) => "_urad",
        Kind::Number(Unit::Degc) => "_degc",
        Kind::Number(Unit::Ms) => "_seconds",
        Kind::Count => "_total",
        Kind::Whole | Kind::Truth | Kind::Text => "",
    };
    format!("{part}{}{unit}", quantity.row)
}

fn labels_of(quantity: &Quantity) -> String {
    let label = match quantity.part {
        Part::Axis(_) => "axis",
        Part::Sensor(_) => "sensor",
        Part::Controller(_) => "path",
        Part::Gateway | Part::Tool => return String::new(),
    };
    labels(label, &quantity.of)
}

/// Value of a metric, times in s; `None` if the status has no sample of the quantity.
fn value(quantity: &Quantity, status: &Status) -> Option<f64> {
    let reading = quantity.read(status);
    match (reading.current(), quantity.kind) {
        (Some(Value::Number(ms)), Kind::Number(Unit::Ms)) => Some(ms * 1e-3),
        (Some(Value::Number(number)), _) => Some(*number),
        (Some(Value::Whole(number)), _) => Some(*number as f64),
        (Some(Value::Truth(yes)), _) => Some(f64::from(u8::from(*yes))),
        // Infinity means "never", so that an alarm on a maximum age is raised.
        (None, Kind::Number(Unit::Ms)) => Some(f64::INFINITY),
        (None, Kind::Truth | Kind::Whole) => Some(f64::NAN),
        (None | Some(Value::Text(_)), _) => None,
    }
}

fn times(status: &Status) -> [Metric; 4] {
    let cycle = &status.cycle;
    let whole = StretchTimes { p50_us: cycle.p50_us, p99_us: cycle.p99_us, max_us: cycle.max_us };
    [
        ("cycle_seconds", "Time of a whole cycle over the last some thousand cycles", whole),
        ("own_seconds", "CPU time of a cycle without exchanges", cycle.own),
        ("wake_seconds", "From the deadline to the first instruction of a cycle", cycle.wake),
        ("exchange_seconds", "Exchanges with controllers in a cycle", cycle.exchange),
    ]
    .map(|(name, help, times)| Metric {
        name: name.to_owned(),
        help,
        kind: "gauge",
        lines: [("0.5", times.p50_us), ("0.99", times.p99_us), ("1", times.max_us)]
            .map(|(quantile, us)| (labels("quantile", quantile), us * 1e-6))
            .to_vec(),
    })
}

fn write_metric(out: &mut String, metric: &Metric) {
    let Metric { name, help, kind, lines } = metric;
    // Writing to a string never fails.
    let _ = writeln!(out, "# HELP volcomp_{name} {help}\n# TYPE volcomp_{name} {kind}");
    for (labels, value) in lines {
        let _ = if value.is_infinite() {
            writeln!(out, "volcomp_{name}{labels} +Inf")
        } else {
            writeln!(out, "volcomp_{name}{labels} {value}")
        };
    }
}

fn states(status: &Status) -> Vec<(String, f64)> {
    let states = StateName::ALL.into_iter();
    states
        .map(|state| {
            let is = f64::from(u8::from(state == status.state));
            (labels("state", state.name()), is)
        })
        .collect()
}

fn reasons(status: &Status) -> Vec<(String, f64)> {
    // `quantities::reasons` omits the duration of a silence, which would create a new series for every value.
    let reasons = quantities::reasons(status).into_iter();
    reasons.map(|reason| (labels("reason", reason), 1.0)).collect()
}

/// A label in braces, escaped for the Prometheus text format.
fn labels(name: &str, value: &str) -> String {
    let value = value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
    format!("{{{name}=\"{value}\"}}")
}
