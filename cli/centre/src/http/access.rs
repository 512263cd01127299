//! Authentication: the session of the cookie, the role that a route requires, and protection against cross-site requests.

use std::{net::SocketAddr, sync::Arc};

use axum::{
    Extension,
    extract::{Request, State},
    http::{HeaderMap, Method, StatusCode, header},
    middleware::Next,
    response::{IntoResponse, Response},
};
use serde_json::json;
use volcomp_web::is_of_another_page;

use super::{response::ApiError, state::PageState};
use crate::users::{BootTime, Refusal, Role, Token, User};

/// Header that the web interface sends with every change. A page of another origin cannot send it without a preflight request, which this program
/// never grants.
pub(super) const OURS: &str = "x-volcomp";

/// Name of the cookie. The `__Host-` prefix under TLS makes the browser accept it only from this host and never over a plain connection.
pub(super) fn cookie_name(secure: bool) -> &'static str {
    if secure { "__Host-volcomp-centre" } else { "volcomp-centre" }
}

/// The `Set-Cookie` header; an empty token deletes the cookie.
pub(super) fn cookie(secure: bool, token: &str) -> String {
    let name = cookie_name(secure);
    let only = if secure { "; Secure" } else { "" };
    let end = if token.is_empty() { "; Max-Age=0" } else { "" };
    format!("{name}={token}; Path=/; HttpOnly; SameSite=Strict{only}{end}")
}

pub(super) fn token(headers: &HeaderMap, secure: bool) -> Option<Token> {
    let name = cookie_name(secure);
    let cookies = headers.get_all(header::COOKIE).iter();
    cookies
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(';'))
        .filter_map(|pair| pair.trim().split_once('='))
        .find(|(key, _)| *key == name)
        .and_then(|(_, value)| Token::parse(value))
}

/// Checks that a change comes from our own web interface, or from a program that sends the header.
fn is_ours(headers: &HeaderMap) -> Result<(), ApiError> {
    let forbidden = |why: &str| ApiError::new(StatusCode::FORBIDDEN, why);
    if headers.get(OURS).is_none_or(|value| value != "1") {
        return Err(forbidden("a change needs the header X-Volcomp: 1"));
    }
    if is_of_another_page(headers) {
        return Err(forbidden("the request comes from a page of another origin"));
    }
    Ok(())
}

/// Authorizes a request for its route. Changes are written to the audit log with the client's address.
pub(super) async fn admit(
    State((page, need)): State<(Arc<PageState>, Option<Role>)>,
    Extension(from): Extension<SocketAddr>,
    mut request: Request,
    next: Next,
) -> Response {
    let changes = request.method() != Method::GET;
    if changes && let Err(refused) = is_ours(request.headers()) {
        page.refused(Refusal::Forbidden, from.ip(), request.uri().path()).await;
        return refused.into_response();
    }
    let Some(role) = need else {
        return next.run(request).await;
    };
    let user = match user(&page, request.headers()).await {
        Ok(Some(user)) => user,
        Ok(None) => {
            return ApiError::new(StatusCode::UNAUTHORIZED, "log in first").into_response();
        }
        Err(refused) => return refused.into_response(),
    };
    if user.role < role {
        page.refused(Refusal::Forbidden, from.ip(), request.uri().path()).await;
        let why = format!("this needs the role {role}, {} is {}", user.name, user.role);
        return ApiError::new(StatusCode::FORBIDDEN, why).into_response();
    }
    let name = user.name.clone();
    let (method, path) = (request.method().clone(), request.uri().path().to_owned());
    request.extensions_mut().insert(user);
    let response = next.run(request).await;
    if changes {
        let details = json!({
            "from": from.ip(),
            "method": method.as_str(),
            "status": response.status().as_u16(),
        });
        page.record(name.as_str(), "request", path, details).await;
    }
    response
}

async fn user(page: &Arc<PageState>, headers: &HeaderMap) -> Result<Option<User>, ApiError> {
    let Some(token) = token(headers, page.settings.secure) else {
        return Ok(None);
    };
    page.query(move |store| store.session(&token, &BootTime::now())).await
}
