//! Commands that send requests to a running gateway: `status`, and `arm`, `disarm` and `acknowledge`, the buttons of
//! the dashboard.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

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
    documents::{
        Answer, ByAxis, Confirmation, PathState, ProvenName, Question, SchemeName, Settled,
        StateName, Status,
    },
    error::GatewayError,
    interop::quantities::length,
};

/// Options that reach a running gateway.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct RunningArguments {
    /// The configuration with which it runs
    #[arg(long)]
    config: Option<PathBuf>,
    /// The address and port of its dashboard
    #[arg(long)]
    listen: Option<SocketAddr>,
    /// File with a token: the last word of its first line
    #[arg(long)]
    token_file: Option<PathBuf>,
}

impl RunningArguments {
    /// Address and certificate of the dashboard.
    ///
    /// # Errors
    /// The configuration is invalid.
    pub fn dashboard(&self) -> Result<DashboardConfig, GatewayError> {
        let mut dashboard = match &self.config {
            Some(path) => {
                DashboardConfig::read(path).map_err(|e| GatewayError::running_without(&e))?
            }
            None => DashboardConfig::default(),
        };
        if let Some(listen) = self.listen {
            dashboard.listen = listen;
        }
        Ok(dashboard)
    }

    /// The token. The file holds a single token, or lines in the format of the gateway's token file.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn token(&self) -> Result<Option<String>, GatewayError> {
        let Some(path) = &self.token_file else {
            return Ok(None);
        };
        let text = std::fs::read_to_string(path)
            .map_err(|source| GatewayError::Read { file: path.display().to_string(), source })?;
        let lines = text.lines();
        let mut lines = lines.map(|line| line.split('#').next().unwrap_or_default());
        let token = lines.find_map(|line| line.split_whitespace().last());
        Ok(token.map(str::to_owned))
    }
}

/// Response of a gateway.
#[derive(Clone, Debug)]
pub struct Response {
    /// Address of the gateway, used in messages.
    pub address: SocketAddr,
    /// HTTP status; 0 if the response is not HTTP.
    pub status: u16,
    pub body: String,
}

impl Response {
    /// What a refused call lacks: the option that states a token.
    pub fn needs_token(&self, token: Option<&str>) -> &'static str {
        if self.status == 401 && token.is_none() { ": state it with --token-file FILE" } else { "" }
    }
}

/// Sends a request, such as `GET /api/state`, to the gateway of a dashboard configuration.
///
/// # Errors
/// The gateway cannot be reached, or does not respond within `within`.
pub fn exchange(
    dashboard: &DashboardConfig,
    token: Option<&str>,
    request: &str,
    body: &str,
    within: Duration,
) -> Result<Response, GatewayError> {
    let mut address = dashboard.listen;
    if address.ip().is_unspecified() {
        address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
    }
    let failed = |e: std::io::Error| GatewayError::system(format!("gateway at {address}"), e);
    let stream = Connection::open(&address, within).map_err(failed)?;
    let authorization =
        token.map_or(String::new(), |token| format!("Authorization: Bearer {token}\r\n"));
    let request = format!(
        "{request} HTTP/1.1\r\nHost: {address}\r\n{authorization}Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
        body.len()
    );
    let text = match &dashboard.tls_certificate {
        None => client::exchange(stream, &request),
        Some(certificate) => client::exchange(encrypted(stream, address, certificate)?, &request),
    }
    .map_err(failed)?;
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    let status = head.split_whitespace().nth(1);
    Ok(Response {
        address,
        status: status.and_then(|status| status.parse().ok()).unwrap_or(0),
        body: body.trim().to_owned(),
    })
}

fn encrypted(
    stream: Connection,
    address: SocketAddr,
    certificate: &Path,
) -> Result<StreamOwned<ClientConnection, Connection>, GatewayError> {
    let wrong =
        |source: CertificateError| TlsError::Certificate { file: certificate.to_owned(), source };
    let trusted = CertificateDer::from_pem_file(certificate).map_err(|e| wrong(e.into()))?;
    let config = client::trusting(trusted).map_err(wrong)?;
    let name = ServerName::from(address.ip());
    Ok(client::encrypted(stream, config, name).map_err(|e| wrong(e.into()))?)
}

/// Timeout of a request: the gateway answers within 10 s.
const TIMEOUT: Duration = Duration::from_secs(12);

/// Options of `arm`.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ArmArguments {
    #[command(flatten)]
    running: RunningArguments,
    /// Answer to the question of a changed model or changed limits: the hash that it prints
    #[arg(long, value_name = "HASH")]
    confirm: Option<String>,
}

/// Arms a running gateway, and returns its state.
///
/// # Errors
/// The gateway does not answer, refuses, or asks for a confirmation.
pub fn arm(arguments: &ArmArguments) -> Result<String, GatewayError> {
    let (dashboard, token) = (arguments.running.dashboard()?, arguments.running.token()?);
    let body = arguments.confirm.clone().map(|confirm| {
        let confirm = Some(confirm);
        serde_json::to_string(&Confirmation { confirm }).unwrap_or_default()
    });
    send(&dashboard, token.as_deref(), "arm", &body.unwrap_or_default())
}

/// Acknowledges the faults of a running gateway, and returns its state.
///
/// # Errors
/// The gateway does not answer, or refuses.
pub fn acknowledge(running: &RunningArguments) -> Result<String, GatewayError> {
    let (dashboard, token) = (running.dashboard()?, running.token()?);
    send(&dashboard, token.as_deref(), "acknowledge", "")
}

/// Disarms a running gateway, and returns its state.
///
/// # Errors
/// The gateway does not answer, or refuses.
pub fn disarm(running: &RunningArguments) -> Result<String, GatewayError> {
    let (dashboard, token) = (running.dashboard()?, running.token());
    let refused = match &token {
        Ok(Some(token)) => match send(&dashboard, Some(token), "disarm", "") {
            Ok(state) => return Ok(state),
            Err(refused) => Some(refused),
        },
        _ => None,
    };
    // On the gateway's own computer disarming needs no token, so retry without one if the given token is unreadable or
    // does not permit disarming.
    match (send(&dashboard, None, "disarm", ""), refused, token) {
        (Err(_), Some(refused), _) => Err(refused),
        (Err(error), None, Err(unread)) => Err(GatewayError::failed(format!("{error}; {unread}"))),
        (answer, ..) => answer,
    }
}

fn send(
    dashboard: &DashboardConfig,
    token: Option<&str>,
    verb: &str,
    body: &str,
) -> Result<String, GatewayError> {
    let request = format!("POST /api/{verb}");
    let response = exchange(dashboard, token, &request, body, TIMEOUT)?;
    let refused = |why: &str| {
        let address = response.address;
        let hint = response.needs_token(token);
        GatewayError::failed(format!("gateway at {address}: {verb} is refused: {why}{hint}"))
    };
    let reasons = |settled: &Settled| settled.reasons.join(", ");
    match (response.status, serde_json::from_str(&response.body)) {
        (200, Ok(Answer::Settled(settled))) => {
            let because = match reasons(&settled) {
                reasons if reasons.is_empty() => reasons,
                reasons => format!("{:<18}{reasons}\n", reasons_title(settled.state)),
            };
            let state = settled.state.name();
            Ok(format!("state             {state}\n{because}"))
        }
        (_, Ok(Answer::Question(question))) => Err(GatewayError::failed(text(verb, &question))),
        (_, Ok(Answer::Settled(settled))) => {
            let error = settled.error.clone().unwrap_or_default();
            Err(refused(&format!("{error} ({})", reasons(&settled))))
        }
        (_, Ok(Answer::Refusal(refusal))) => Err(refused(&refusal.error)),
        (status, _) => Err(refused(&format!("it answers {status}: {}", response.body))),
    }
}

/// The confirmation question, as in the dashboard, and the command that answers it.
fn text(verb: &str, question: &Question) -> String {
    let mut lines = vec![format!("{verb} must be confirmed:")];
    lines.extend(question.differences.iter().cloned());
    match question.worst_corner_um {
        None => lines.push(
            "The machine has other axes than before: the change of the correction is unknown."
                .to_owned(),
        ),
        Some(um) => {
            let urad =
                question.worst_corner_urad.map(|worst| (worst, question.confirm_urad, "µrad"));
            let moves = [(um, Some(question.confirm_um), "µm")].into_iter().chain(urad);
            for (worst, least, unit) in moves {
                let allowed = least.map_or(String::new(), |least| {
                    format!(" (allowed without confirmation: {least} {unit})")
                });
                lines.push(format!(
                    "At the worst point of the work space the correction changes by {worst:.1} {unit}{allowed}."
                ));
            }
        }
    }
    for (key, [old, new]) in &question.limits {
        let value =
            |limit: &Option<f64>| limit.map_or("none".to_owned(), |value| value.to_string());
        lines.push(format!("{key}: {} → {}", value(old), value(new)));
    }
    lines.push(format!("Use it? To confirm, repeat with --confirm {}", question.model));
    lines.join("\n")
}

/// Timeout for the request as a whole.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(3);

/// Requests the state from the gateway of a dashboard configuration. `token` is necessary if reading requires a token.
///
/// # Errors
/// The gateway does not respond, or its response is not a state.
pub fn request_status(
    dashboard: &DashboardConfig,
    token: Option<&str>,
) -> Result<Status, GatewayError> {
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
pub fn status_text(status: &Status) -> String {
    let mut lines = Vec::new();
    let mut add = |title: &str, text: String| {
        if !text.is_empty() {
            // Names come from files and devices. Their control characters would act on the terminal.
            lines.push(format!("{title:<18}{}", text.replace(char::is_control, " ")));
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
fn reasons_title(state: StateName) -> &'static str {
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
    without.zip(with).map_or(String::new(), |(without, with)| {
        format!(
            "{:.1} without correction, {:.1} with it (by the model)",
            length(without),
            length(with)
        )
    })
}
