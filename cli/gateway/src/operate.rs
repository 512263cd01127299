//! `arm`, `disarm` and `acknowledge`: the buttons of the dashboard as commands.

use std::time::Duration;

use crate::{
    client::{RunningArguments, exchange},
    config::DashboardConfig,
    documents::{Answer, Confirmation, Question, Settled},
    error::GatewayError,
    status::reasons_title,
};

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
