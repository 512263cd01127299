//! Who is let in: host names, tokens, time, and the headers of every answer.

use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use axum::{
    Extension, Json,
    extract::{FromRequestParts, Request, State},
    http::{HeaderMap, StatusCode, header, request::Parts},
    middleware::Next,
    response::{IntoResponse, Response},
};

use volcomp_web::{headers, hosts, is_of_another_page};

use super::{
    routes::Shared,
    tokens::{Denied, Role, Tokens},
};
use crate::{
    config::DashboardConfig,
    documents::{Refusal, TokenPlan},
    request::Reply,
};

/// A request must be answered after so long, by the service too.
const AT_MOST: Duration = Duration::from_secs(10);
/// The path of requests that bring a machine file, over a slow line perhaps.
pub(super) const UPLOAD: &str = "/api/model/upload";
/// Timeout of receiving a machine file.
const UPLOAD_AT_MOST: Duration = Duration::from_secs(300);

/// Who is let in.
pub struct Door {
    /// Who may do what.
    pub tokens: Tokens,
    /// Host names, besides addresses, under which browsers may ask.
    pub hosts: Vec<String>,
    /// Whether reading needs a token, since others can reach it.
    pub reading_needs_token: bool,
}

impl Door {
    /// The door of a configured dashboard, with its tokens.
    pub fn new(config: &DashboardConfig, tokens: Tokens) -> Self {
        Self {
            tokens,
            hosts: config.hosts.clone(),
            reading_needs_token: config.reading_needs_token(),
        }
    }

    /// Who disarms: whoever may operate, and without a token somebody at this computer, but no page of another origin in their browser.
    pub(super) fn who_disarms(&self, from: IpAddr, headers: &HeaderMap) -> Result<String, Denied> {
        if from.to_canonical().is_loopback() && !headers.contains_key(header::AUTHORIZATION) {
            if is_of_another_page(headers) {
                return Err(Denied::AnotherPage);
            }
            return Ok("somebody at this computer".to_owned());
        }
        let holder = self.tokens.check(from, bearer(headers), Role::Operate)?;
        Ok(holder.name)
    }
}

/// Host, time, and the headers of every answer.
pub(super) async fn every_request(
    State(door): State<Arc<Door>>,
    request: Request,
    next: Next,
) -> Response {
    let host = request
        .headers()
        .get(header::HOST)
        .and_then(|host| host.to_str().ok());
    let mut response = match host {
        Some(host) if hosts::is_known(host, &door.hosts) => {
            let at_most = if request.uri().path() == UPLOAD {
                UPLOAD_AT_MOST
            } else {
                AT_MOST
            };
            match tokio::time::timeout(at_most, next.run(request)).await {
                Ok(response) => response,
                Err(_) => refuse(StatusCode::REQUEST_TIMEOUT, "the request took too long"),
            }
        }
        Some(_) => refuse(
            StatusCode::MISDIRECTED_REQUEST,
            "this name is not configured: add it to [dashboard] hosts",
        ),
        None => refuse(StatusCode::BAD_REQUEST, "no Host header"),
    };
    headers::put(response.headers_mut());
    response
}

/// Where reading needs a token, it is asked for.
pub(super) async fn may_view(
    State(door): State<Arc<Door>>,
    Extension(from): Extension<SocketAddr>,
    request: Request,
    next: Next,
) -> Response {
    if door.reading_needs_token
        && let Err(denied) = door
            .tokens
            .check(from.ip(), bearer(request.headers()), Role::View)
    {
        return denied.into_response();
    }
    next.run(request).await
}

/// Whose token this is and what it allows, so that a wrong one is found before it is needed.
pub(super) async fn token(
    State(door): State<Arc<Door>>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
) -> Response {
    match door.tokens.check(from.ip(), bearer(&headers), Role::View) {
        Ok(holder) => Json(TokenPlan {
            name: holder.name,
            role: holder.role.name().to_owned(),
        })
        .into_response(),
        Err(denied) => denied.into_response(),
    }
}

/// Who may operate, by the name of the token: others are refused.
pub(super) struct Operator(pub(super) String);

/// Who may bring a new model, by the name of the token: others are refused.
pub(super) struct Engineer(pub(super) String);

impl FromRequestParts<Shared> for Operator {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, shared: &Shared) -> Result<Self, Response> {
        holder(parts, shared, Role::Operate).map(Self)
    }
}

impl FromRequestParts<Shared> for Engineer {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, shared: &Shared) -> Result<Self, Response> {
        holder(parts, shared, Role::Engineer).map(Self)
    }
}

#[expect(clippy::result_large_err, reason = "an answer of HTTP")]
fn holder(parts: &Parts, shared: &Shared, needed: Role) -> Result<String, Response> {
    // The server knows from where every request comes.
    let from = parts.extensions.get::<SocketAddr>();
    let from = from.map_or(IpAddr::from([0; 4]), SocketAddr::ip);
    let checked = (shared.door.tokens).check(from, bearer(&parts.headers), needed);
    checked
        .map(|holder| holder.name)
        .map_err(IntoResponse::into_response)
}

/// The answer of the service, or of the models.
pub(super) fn answer(reply: Reply) -> Response {
    let status = StatusCode::from_u16(reply.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    (status, Json(reply.answer)).into_response()
}

/// The token of a request.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let value = headers.get(header::AUTHORIZATION)?.to_str().ok()?;
    let (scheme, token) = value.split_once(' ')?;
    scheme
        .eq_ignore_ascii_case("bearer")
        .then_some(token.trim())
}

/// A refusal in words.
pub(super) fn refuse(status: StatusCode, why: &str) -> Response {
    (status, Json(Refusal::new(why))).into_response()
}

/// A file of a page.
pub(super) fn page(kind: &'static str, text: &'static str) -> Response {
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

impl IntoResponse for Denied {
    fn into_response(self) -> Response {
        match self {
            Self::NoneConfigured => refuse(StatusCode::NOT_FOUND, "no token is configured"),
            Self::Unknown => refuse(StatusCode::UNAUTHORIZED, "a valid token is needed"),
            Self::AnotherPage => refuse(
                StatusCode::FORBIDDEN,
                "a page of another origin may not disarm",
            ),
            Self::Role => refuse(StatusCode::FORBIDDEN, "this token does not allow it"),
            Self::TooMany => refuse(
                StatusCode::TOO_MANY_REQUESTS,
                "too many wrong tokens: wait a minute",
            ),
        }
    }
}
