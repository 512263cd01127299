//! Who asks: the session of the cookie, the role that a route needs, and whether a change was meant by our own page.

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

use super::{answer::Refused, state::PageState};
use crate::users::{Moment, Refusal, Role, Token, User};

/// The header that our page sends with every change: a page of somebody else cannot send it without being asked for permission
/// first, which this program never gives.
pub(super) const OURS: &str = "x-volcomp";

/// The name of the cookie. With TLS the browser takes it from this host alone, and never over a plain connection.
pub(super) fn cookie_name(secure: bool) -> &'static str {
    if secure {
        "__Host-volcomp-centre"
    } else {
        "volcomp-centre"
    }
}

/// The cookie that a browser is told to keep; an empty token ends it.
pub(super) fn cookie(secure: bool, token: &str) -> String {
    let name = cookie_name(secure);
    let only = if secure { "; Secure" } else { "" };
    let end = if token.is_empty() { "; Max-Age=0" } else { "" };
    format!("{name}={token}; Path=/; HttpOnly; SameSite=Strict{only}{end}")
}

/// The token of the cookie.
pub(super) fn token(headers: &HeaderMap, secure: bool) -> Option<Token> {
    let name = cookie_name(secure);
    let cookies = headers.get_all(header::COOKIE).iter();
    cookies
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(';'))
        .filter_map(|pair| pair.trim().split_once('='))
        .find(|(key, _)| *key == name)
        .and_then(|(_, value)| Token::shown(value))
}

/// Whether a change comes from our own page, or from a program that says so.
fn is_ours(headers: &HeaderMap) -> Result<(), Refused> {
    let forbidden = |why: &str| Refused::new(StatusCode::FORBIDDEN, why);
    if headers.get(OURS).is_none_or(|value| value != "1") {
        return Err(forbidden("a change needs the header X-Volcomp: 1"));
    }
    if is_of_another_page(headers) {
        return Err(forbidden("the request comes from a page of another origin"));
    }
    Ok(())
}

/// Lets a request through to its route, or not; what somebody changes is written into the audit log, with the address from which
/// the request came.
pub(super) async fn admit(
    State((page, need)): State<(Arc<PageState>, Option<Role>)>,
    Extension(from): Extension<SocketAddr>,
    mut request: Request,
    next: Next,
) -> Response {
    let changes = request.method() != Method::GET;
    if changes && let Err(refused) = is_ours(request.headers()) {
        page.refused(Refusal::Forbidden, from.ip(), request.uri().path())
            .await;
        return refused.into_response();
    }
    let Some(role) = need else {
        return next.run(request).await;
    };
    let user = match user(&page, request.headers()).await {
        Ok(Some(user)) => user,
        Ok(None) => {
            return Refused::new(StatusCode::UNAUTHORIZED, "log in first").into_response();
        }
        Err(refused) => return refused.into_response(),
    };
    if user.role < role {
        page.refused(Refusal::Forbidden, from.ip(), request.uri().path())
            .await;
        let why = format!("this needs the role {role}, {} is {}", user.name, user.role);
        return Refused::new(StatusCode::FORBIDDEN, why).into_response();
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

async fn user(page: &Arc<PageState>, headers: &HeaderMap) -> Result<Option<User>, Refused> {
    let Some(token) = token(headers, page.settings.secure) else {
        return Ok(None);
    };
    page.ask(move |store| store.session(&token, &Moment::now()))
        .await
}
