//! Requests the state of a running gateway.

use std::time::Duration;

use crate::{
    client::exchange,
    config::DashboardConfig,
    documents::{ByAxis, PathState, ProvenName, SchemeName, StateName, Status},
    error::GatewayError,
};

/// Timeout for the request as a whole.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(3);

/// Requests the state from the gateway of a dashboard configuration. `token` is necessary if reading requires a token.
///
/// # Errors
/// The gateway does not respond, or its response is not a state.
pub fn request(dashboard: &DashboardConfig, token: Option<&str>) -> Result<Status, GatewayError> {
    let response = exchange(dashboard, token, "GET /api/state", "", REQUEST_TIMEOUT)?;
    let address = response.address;
    if response.status != 200 {
        return Err(GatewayError::failed(format!(
            "gateway at {address}: it answers {}: {}{}",
            response.status,
            response.body,
            response.needs_token(token)
        )));
    }
    serde_json::from_str(&response.body).map_err(|e| {
        GatewayError::failed(format!("gateway at {address}: its response is not a state: {e}"))
    })
}

/// Formats a state as lines of text.
pub fn text(status: &Status) -> String {
    let mut lines = Vec::new();
    let mut add = |title: &str, text: String| {
        if !text.is_empty() {
            lines.push(format!("{title:<18}{text}"));
        }
    };
    let controller = status.controller.as_ref();
    add("state", status.state.name().to_owned());
    add(reasons_title(status.state), status.reasons.join(", "));
    if is_gone(status) {
        add("check", GONE.to_owned());
    }
    add("machine", status.machine.name.clone());
    add("controller", controller.map_or(String::new(), |controller| controller.device.clone()));
    for path in &status.controllers {
        let mut title = format!("path {}", path.number + 1);
        for line in health(path, status.state == StateName::Compensating) {
            add(&std::mem::take(&mut title), line);
        }
    }
    add("position, mm", by_axis(&status.positions_mm, 3));
    add("position, deg", by_axis(&status.positions_deg, 4));
    if status.correction_known {
        add("correction, µm", by_axis(&status.correction_um, 1));
        add("correction, µrad", by_axis(&status.correction_urad, 1));
    } else {
        add("correction", "unknown: not confirmed by the control".to_owned());
        add("  confirmed, µm", by_axis(&status.correction_um, 1));
        add("  confirmed, µrad", by_axis(&status.correction_urad, 1));
    }
    for (what, title) in [
        (ProvenName::Contained, "positions contain the correction"),
        (ProvenName::NotContained, "positions do not contain it"),
        (ProvenName::NotProven, "not proven"),
    ] {
        let axes = status.proven.iter().filter(|(_, proven)| **proven == what);
        let names: Vec<String> = axes.map(|(name, _)| name.to_string()).collect();
        if !names.is_empty() {
            add("test shift", format!("{title}: {}", names.join(" ")));
        }
    }
    add("tip error, µm", pair(status.error_um, status.residual_um));
    add("axis error, µrad", pair(status.error_axis_urad, status.residual_axis_urad));
    for sensor in &status.temperatures {
        let degc = sensor.degc.map_or("-".to_owned(), |degc| format!("{degc:.1} °C"));
        let why = sensor.reason.as_ref().map_or(String::new(), |why| format!(" ({why})"));
        add("temperature", format!("{} {degc}{why}", sensor.name));
    }
    let cycle = &status.cycle;
    add(
        "cycles",
        format!(
            "{}, 50 % within {:.0} µs, 99 % within {:.0} µs, {} overruns",
            cycle.count, cycle.p50_us, cycle.p99_us, cycle.overruns
        ),
    );
    lines.join("\n") + "\n"
}

/// The word before the reasons: while compensating they explain no state.
pub(crate) fn reasons_title(state: StateName) -> &'static str {
    if state == StateName::Compensating { "notes" } else { "because" }
}

/// What to check if the active control no longer responds.
const GONE: &str = "the cable and the control, which ramps to zero if it has a barrier";

/// True if the correction is unknown because the active controller does not respond.
fn is_gone(status: &Status) -> bool {
    let mut active = status.controllers.iter().filter(|path| path.active);
    active.any(|path| path.holds_correction.is_none() && path.answered_ms.is_some())
}

fn health(path: &PathState, corrects: bool) -> Vec<String> {
    let barrier = match path.scheme {
        SchemeName::Barrier => "barrier",
        SchemeName::Plain => "no barrier",
        SchemeName::NoReadBack => "no barrier, cannot be read back",
    };
    let holds = match path.holds_correction {
        Some(true) => "holds a correction".to_owned(),
        Some(false) => "holds no correction".to_owned(),
        None if path.confirmed_ms.is_none() => "correction unknown, never confirmed".to_owned(),
        None => format!("correction unknown, {}", since("last confirmed", path.confirmed_ms)),
    };
    let ages = [
        ("answered", path.answered_ms),
        ("positions", path.positions_ms),
        ("confirmed", path.confirmed_ms),
    ];
    let ages = ages.map(|(what, ms)| since(what, ms));
    let role = match (path.active, corrects) {
        (true, true) => "corrects",
        (true, false) => "in use",
        (false, _) => "standby",
    };
    vec![format!("{role}, {}", path.device), format!("{barrier}; {holds}"), ages.join(", ")]
}

fn since(what: &str, ms: Option<f64>) -> String {
    ms.map_or(format!("{what} never"), |ms| match ms {
        ms if ms < 1e4 => format!("{what} {ms:.0} ms ago"),
        ms => format!("{what} {:.0} s ago", ms * 1e-3),
    })
}

fn by_axis(values: &ByAxis, digits: usize) -> String {
    let words: Vec<String> =
        values.iter().map(|(name, value)| format!("{name} {value:.digits$}")).collect();
    words.join("  ")
}

fn pair(without: Option<[f64; 3]>, with: Option<[f64; 3]>) -> String {
    let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    without.zip(with).map_or(String::new(), |(without, with)| {
        format!(
            "{:.1} without correction, {:.1} with it (by the model)",
            length(without),
            length(with)
        )
    })
}
