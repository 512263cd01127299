//! Access control of the dashboard: host names, tokens, timeouts and response headers.

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

/// Timeout of a request, including the response of the service.
const AT_MOST: Duration = Duration::from_secs(10);
/// Path for uploads of machine files, which may be slow.
pub(super) const UPLOAD: &str = "/api/model/upload";
/// Timeout of an upload.
const UPLOAD_AT_MOST: Duration = Duration::from_secs(300);

/// Access control of the dashboard.
pub struct Door {
    /// Tokens and their roles.
    pub tokens: Tokens,
    /// Host names, in addition to addresses, under which browsers may access the dashboard.
    pub hosts: Vec<String>,
    /// Whether reading needs a token because other computers can reach the dashboard.
    pub reading_needs_token: bool,
}

impl Door {
    /// Access control of a configured dashboard.
    pub fn new(config: &DashboardConfig, tokens: Tokens) -> Self {
        Self {
            tokens,
            hosts: config.hosts.clone(),
            reading_needs_token: config.reading_needs_token(),
        }
    }

    /// Authorizes a disarm request and returns its origin for the audit log. Without a token, requests from this
    /// computer are accepted unless a page of another origin sent them.
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

/// Middleware for every request: checks the host, applies the timeout, sets the response headers.
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

/// Middleware: requires a token where reading needs one.
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

/// Returns name and role of the token, so that a wrong token is detected before it is needed.
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

/// Extracts the name of a token that may operate; other requests are refused.
pub(super) struct Operator(pub(super) String);

/// Extracts the name of a token that may upload and activate models; other requests are refused.
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
    // The server sets the address on every request; if it is missing, assume a remote one.
    let from = parts.extensions.get::<SocketAddr>();
    let from = from.map_or(IpAddr::from([0; 4]), SocketAddr::ip);
    let checked = (shared.door.tokens).check(from, bearer(&parts.headers), needed);
    checked
        .map(|holder| holder.name)
        .map_err(IntoResponse::into_response)
}

/// Converts a reply of the service or of the models.
pub(super) fn answer(reply: Reply) -> Response {
    let status = StatusCode::from_u16(reply.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    (status, Json(reply.answer)).into_response()
}

/// The bearer token of a request.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let value = headers.get(header::AUTHORIZATION)?.to_str().ok()?;
    let (scheme, token) = value.split_once(' ')?;
    scheme
        .eq_ignore_ascii_case("bearer")
        .then_some(token.trim())
}

/// A refusal with its reason.
pub(super) fn refuse(status: StatusCode, why: &str) -> Response {
    (status, Json(Refusal::new(why))).into_response()
}

/// A static file of the web interface.
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
