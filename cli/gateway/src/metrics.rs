//! The state as Prometheus text.

use std::fmt::Write;

use crate::{
    documents::{ByAxis, PathState, ProvenName, SchemeName, StateName, Status, StretchTimes},
    interop::quantities,
};

/// The lines of one metric: labels and value.
type Lines = Vec<(String, f64)>;

/// All metrics of a state, on a gateway with so many controllers.
pub(crate) fn text(status: &Status, controllers: usize) -> String {
    let mut out = String::new();
    let one = |value: f64| vec![(String::new(), value)];
    let cycle = &status.cycle;
    for (name, help, value) in [
        ("cycles_total", "Cycles so far", cycle.count),
        ("overruns_total", "Periods missed so far", cycle.overruns),
        (
            "faults_total",
            "Exchanges with controllers that failed so far",
            status.faults,
        ),
        (
            "held_back_total",
            "Cycles so far in which slew or acceleration limits held the correction back",
            status.held_back,
        ),
    ] {
        metric(&mut out, name, "counter", help, &one(value as f64));
    }
    for (name, help, lines) in gauges(status, controllers)
        .into_iter()
        .chain(of_paths(status))
    {
        metric(&mut out, name, "gauge", help, &lines);
    }
    for (name, help, times) in [
        (
            "cycle_seconds",
            "Time of a whole cycle over the last some thousand cycles",
            StretchTimes {
                p50_us: cycle.p50_us,
                p99_us: cycle.p99_us,
                max_us: cycle.max_us,
            },
        ),
        (
            "own_seconds",
            "CPU time of a cycle without exchanges",
            cycle.own,
        ),
        (
            "wake_seconds",
            "From the deadline to the first instruction of a cycle",
            cycle.wake,
        ),
        (
            "exchange_seconds",
            "Exchanges with controllers in a cycle",
            cycle.exchange,
        ),
    ] {
        metric(&mut out, name, "gauge", help, &quantiles(&times));
    }
    out
}

/// Name, help and lines of what has a value of its own at each state.
fn gauges(status: &Status, controllers: usize) -> Vec<(&'static str, &'static str, Lines)> {
    let one = |value: f64| vec![(String::new(), value)];
    let known = |values: &ByAxis| {
        if status.correction_known {
            axes(values)
        } else {
            Lines::new()
        }
    };
    let active = status.controller.as_ref();
    let active = active.map_or(f64::NAN, |controller| controller.number as f64);
    vec![
        (
            "state",
            "1 for the state of the gateway, 0 for the others",
            states(status),
        ),
        ("reason", "1 for each reason of the state", reasons(status)),
        (
            "age_seconds",
            "Age of what is told here",
            one(status.age_ms * 1e-3),
        ),
        (
            "active_controller",
            "Place of the controller that corrects, from 0",
            one(active),
        ),
        (
            "controllers",
            "Number of configured controllers",
            one(controllers as f64),
        ),
        (
            "position_mm",
            "Position of a linear axis without correction, mm",
            axes(&status.positions_mm),
        ),
        (
            "position_deg",
            "Position of a rotary axis without correction, deg",
            axes(&status.positions_deg),
        ),
        (
            "correction_um",
            "Correction of a linear axis, µm; missing while it is not known",
            known(&status.correction_um),
        ),
        (
            "correction_urad",
            "Correction of a rotary axis, µrad; missing while it is not known",
            known(&status.correction_urad),
        ),
        (
            "sent_um",
            "Correction of a linear axis that was sent last, µm",
            axes(&status.sent_um),
        ),
        (
            "sent_urad",
            "Correction of a rotary axis that was sent last, µrad",
            axes(&status.sent_urad),
        ),
        (
            "error_um",
            "Length of the model's position error of the tool tip, µm",
            errors(status.error_um, status.residual_um),
        ),
        (
            "axis_error_urad",
            "Length of the model's direction error of the tool axis, µrad",
            errors(status.error_axis_urad, status.residual_axis_urad),
        ),
        (
            "temperature_degc",
            "Temperature of a sensor that is used, °C",
            temperatures(status),
        ),
    ]
}

/// Name, help and lines of what is known of the ways to the control.
fn of_paths(status: &Status) -> Vec<(&'static str, &'static str, Lines)> {
    vec![
        (
            "path_answered_seconds",
            "Time since a controller answered last; +Inf: never",
            ages(status, |path| path.answered_ms),
        ),
        (
            "path_positions_seconds",
            "Age of the positions of a controller; +Inf: it told none",
            ages(status, |path| path.positions_ms),
        ),
        (
            "path_confirmed_seconds",
            "Time since the correction of a controller was confirmed last; +Inf: never",
            ages(status, |path| path.confirmed_ms),
        ),
        (
            "path_holds_correction",
            "1 where a controller applies a correction other than zero, 0 where none; NaN: not known",
            paths(status, |path| {
                path.holds_correction.map_or(f64::NAN, number)
            }),
        ),
        (
            "no_barrier",
            "1 where a late or foreign write is not told from one that is meant now, for want of a barrier",
            paths(status, |path| number(path.scheme != SchemeName::Barrier)),
        ),
        (
            "proven",
            "1 where a test shift showed whether the position of an axis contains the correction",
            proven(status),
        ),
        (
            "correction_known",
            "1 where the correction that is applied was confirmed in time",
            vec![(String::new(), number(status.correction_known))],
        ),
    ]
}

fn metric(out: &mut String, name: &str, kind: &str, help: &str, lines: &[(String, f64)]) {
    // Writing to a string never fails.
    let _ = writeln!(
        out,
        "# HELP volcomp_{name} {help}\n# TYPE volcomp_{name} {kind}"
    );
    for (labels, value) in lines {
        let _ = if value.is_infinite() {
            writeln!(out, "volcomp_{name}{labels} +Inf")
        } else {
            writeln!(out, "volcomp_{name}{labels} {value}")
        };
    }
}

fn number(yes: bool) -> f64 {
    f64::from(u8::from(yes))
}

/// A value of every controller, by its place.
fn paths(status: &Status, value: impl Fn(&PathState) -> f64) -> Lines {
    let paths = status.controllers.iter();
    paths
        .map(|path| (labels(&[("path", &path.number.to_string())]), value(path)))
        .collect()
}

/// An age of every controller, s.
fn ages(status: &Status, ms: impl Fn(&PathState) -> Option<f64>) -> Lines {
    paths(status, |path| {
        ms(path).map_or(f64::INFINITY, |ms| ms * 1e-3)
    })
}

fn proven(status: &Status) -> Lines {
    let axes = status.proven.iter();
    axes.map(|(name, proven)| {
        let label = labels(&[("axis", &name.to_string())]);
        (label, number(*proven != ProvenName::NotProven))
    })
    .collect()
}

fn states(status: &Status) -> Lines {
    StateName::ALL
        .into_iter()
        .map(|state| {
            let is = f64::from(u8::from(state == status.state));
            (labels(&[("state", state.name())]), is)
        })
        .collect()
}

fn reasons(status: &Status) -> Lines {
    // The time of a silence is no label: it would make a new series with every value.
    let reasons = quantities::reasons(status).into_iter();
    reasons
        .map(|reason| (labels(&[("reason", reason)]), 1.0))
        .collect()
}

fn axes(values: &ByAxis) -> Lines {
    values
        .iter()
        .map(|(name, value)| (labels(&[("axis", &name.to_string())]), *value))
        .collect()
}

fn errors(without: Option<[f64; 3]>, with: Option<[f64; 3]>) -> Lines {
    [("without", without), ("with", with)]
        .into_iter()
        .filter_map(|(correction, error)| {
            let length = quantities::length(error?);
            Some((labels(&[("correction", correction)]), length))
        })
        .collect()
}

fn temperatures(status: &Status) -> Lines {
    status
        .temperatures
        .iter()
        .filter_map(|sensor| Some((labels(&[("sensor", &sensor.name)]), sensor.degc?)))
        .collect()
}

fn quantiles(times: &StretchTimes) -> Lines {
    [
        ("0.5", times.p50_us),
        ("0.99", times.p99_us),
        ("1", times.max_us),
    ]
    .map(|(quantile, us)| (labels(&[("quantile", quantile)]), us * 1e-6))
    .to_vec()
}

/// Labels in braces, with what the text format reserves escaped.
fn labels(pairs: &[(&str, &str)]) -> String {
    let pairs: Vec<String> = pairs
        .iter()
        .map(|(name, value)| {
            let value = value
                .replace('\\', "\\\\")
                .replace('"', "\\\"")
                .replace('\n', "\\n");
            format!("{name}=\"{value}\"")
        })
        .collect();
    format!("{{{}}}", pairs.join(","))
}
