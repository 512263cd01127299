//! Requests the state of a running gateway.

use std::{net::SocketAddr, path::Path, time::Duration};

use tokio_rustls::rustls::{
    ClientConnection, StreamOwned,
    pki_types::{CertificateDer, ServerName, pem::PemObject},
};
use volcomp_web::{
    CertificateError, TlsError,
    client::{self, Connection},
};

use crate::{
    config::DashboardConfig,
    documents::{ByAxis, PathState, ProvenName, SchemeName, StateName, Status},
    error::GatewayError,
};

/// Timeout for the request as a whole.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(3);

/// Requests the state from the gateway of a dashboard configuration. `token` is required where reading needs one.
///
/// # Errors
/// No response, or the response is not the state of a gateway.
pub fn request(dashboard: &DashboardConfig, token: Option<&str>) -> Result<Status, GatewayError> {
    let mut address = dashboard.listen;
    if address.ip().is_unspecified() {
        address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
    }
    let failed = |e: std::io::Error| GatewayError::system(format!("gateway at {address}"), e);
    let stream = Connection::open(&address, REQUEST_TIMEOUT).map_err(failed)?;
    let authorization = token.map_or(String::new(), |token| {
        format!("Authorization: Bearer {token}\r\n")
    });
    let request = format!(
        "GET /api/state HTTP/1.1\r\nHost: {address}\r\n{authorization}Connection: close\r\n\r\n"
    );
    let text = match &dashboard.tls_certificate {
        None => client::exchange(stream, &request),
        Some(certificate) => client::exchange(encrypted(stream, address, certificate)?, &request),
    }
    .map_err(failed)?;
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    let status = head.split_whitespace().nth(1).unwrap_or_default();
    if status != "200" {
        return Err(GatewayError::failed(format!(
            "gateway at {address}: it answers {status}: {}",
            body.trim()
        )));
    }
    serde_json::from_str(body.trim()).map_err(|e| {
        GatewayError::failed(format!(
            "gateway at {address}: its response is not a state: {e}"
        ))
    })
}

fn encrypted(
    stream: Connection,
    address: SocketAddr,
    certificate: &Path,
) -> Result<StreamOwned<ClientConnection, Connection>, GatewayError> {
    let wrong = |source: CertificateError| TlsError::Certificate {
        file: certificate.to_owned(),
        source,
    };
    let trusted = CertificateDer::from_pem_file(certificate).map_err(|e| wrong(e.into()))?;
    let config = client::trusting(trusted).map_err(wrong)?;
    let name = ServerName::from(address.ip());
    Ok(client::encrypted(stream, config, name).map_err(|e| wrong(e.into()))?)
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
    add("because", status.reasons.join(", "));
    if is_gone(status) {
        add("check", GONE.to_owned());
    }
    add("machine", status.machine.name.clone());
    add(
        "controller",
        controller.map_or(String::new(), |controller| controller.device.clone()),
    );
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
        add(
            "correction",
            "unknown: not confirmed by the control".to_owned(),
        );
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
    add(
        "axis error, µrad",
        pair(status.error_axis_urad, status.residual_axis_urad),
    );
    for sensor in &status.temperatures {
        let degc = sensor
            .degc
            .map_or("-".to_owned(), |degc| format!("{degc:.1} °C"));
        let why = sensor
            .reason
            .as_ref()
            .map_or(String::new(), |why| format!(" ({why})"));
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

/// What to check if the active control no longer responds.
const GONE: &str = "the cable and the control, which ramps to zero if it has a barrier";

/// Whether the correction is unknown because the active controller does not respond.
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
        None => format!(
            "correction unknown, {}",
            since("last confirmed", path.confirmed_ms)
        ),
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
    vec![
        format!("{role}, {}", path.device),
        format!("{barrier}; {holds}"),
        ages.join(", "),
    ]
}

fn since(what: &str, ms: Option<f64>) -> String {
    ms.map_or(format!("{what} never"), |ms| match ms {
        ms if ms < 1e4 => format!("{what} {ms:.0} ms ago"),
        ms => format!("{what} {:.0} s ago", ms * 1e-3),
    })
}

fn by_axis(values: &ByAxis, digits: usize) -> String {
    let words: Vec<String> = values
        .iter()
        .map(|(name, value)| format!("{name} {value:.digits$}"))
        .collect();
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
