//! Routes for login, passwords and user management, and the authentication of every request.
//!
//! A request is authenticated by the session of its cookie and the role that its route requires. Cross-site requests
//! are rejected.

use std::{net::SocketAddr, sync::Arc};

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, Request, State},
    http::{HeaderMap, HeaderValue, Method, StatusCode, header},
    middleware::Next,
    response::{IntoResponse, Response},
};
use serde::Deserialize;
use serde_json::json;
use volcomp_web::is_of_another_page;

use crate::{
    http::state::{ApiError, ApiResult, PageState, Shared, document, done, in_place, read},
    users::{BootTime, Password, Refusal, Role, Session, Token, User, UserName, hash, is_right},
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Login {
    name: String,
    password: String,
}

/// Returns the logged-in user and the notice above the web interface (empty: none).
fn who_is(user: &User, page: &PageState) -> ApiResult {
    let notice = &page.settings.notice;
    document(&json!({ "name": user.name, "role": user.role, "notice": notice }))
}

/// Records a wrong password in the audit log, and returns the response.
async fn wrong_password(page: &Arc<PageState>, from: SocketAddr, tried: &str) -> ApiError {
    page.refused(Refusal::Login, from.ip(), tried).await;
    let why = "the name or the password is wrong";
    ApiError::new(StatusCode::UNAUTHORIZED, why)
}

/// Verifies the password of a user who may log in. Returns the user and the compared hash; the caller must check in its
/// transaction that the user still has this hash. Attempts after wrong passwords are delayed; rejected attempts are
/// written to the audit log.
async fn verify_password(
    page: &Arc<PageState>,
    from: SocketAddr,
    name: &str,
    password: String,
) -> Result<(User, String), ApiError> {
    let tried: String = name.chars().take(64).collect();
    let known: Option<UserName> = name.parse().ok();
    let user = match known {
        Some(known) => page.query(move |store| store.user(&known)).await?,
        None => None,
    };
    let stored = user.as_ref().map(|(_, stored)| stored.clone());
    let mut place = page.password_place().await;
    // The comparison and its count continue if the client disconnects: otherwise a client could start any number of
    // comparisons.
    let page = Arc::clone(page);
    let compared = tokio::spawn(async move {
        // The attempt is registered while this task holds its permit, so that concurrent attempts are counted one after
        // the other.
        let Some(attempt) = page.throttle.attempt(from.ip(), &tried) else {
            drop(place);
            page.refused(Refusal::Throttled, from.ip(), &tried).await;
            let why =
                "too many concurrent attempts after wrong passwords: try again in a few seconds";
            return Err(ApiError::new(StatusCode::TOO_MANY_REQUESTS, why));
        };
        if !attempt.delay().is_zero() {
            // Release the permit so that others can log in meanwhile.
            drop(place);
            tokio::time::sleep(attempt.delay()).await;
            place = page.password_place().await;
        }
        let right = match Password::entered(password) {
            Ok(password) => {
                let compared =
                    tokio::task::spawn_blocking(move || is_right(&password, stored.as_deref()));
                compared.await.unwrap_or(false)
            }
            Err(_) => false,
        };
        match user {
            Some((user, compared)) if right && !user.disabled => Ok((user, compared)),
            _ => {
                page.throttle.wrong(from.ip(), &tried);
                drop(place);
                Err(wrong_password(&page, from, &tried).await)
            }
        }
    });
    compared.await.map_err(ApiError::inside)?
}

pub(super) async fn login(
    State(page): Shared,
    Extension(from): Extension<SocketAddr>,
    body: Bytes,
) -> ApiResult {
    let Login { name, password } = read(&body)?;
    let (user, compared) = verify_password(&page, from, &name, password).await?;
    let token = Token::generate().map_err(ApiError::inside)?;
    let now = BootTime::now();
    let session = Session {
        user: user.name.clone(),
        since: now.clone(),
        used: now,
        from: from.ip().to_string(),
    };
    let shown = cookie_header(&page, token.text())?;
    let begun = page.query(move |store| store.begin_session(&token, &session, &compared));
    if !begun.await? {
        return Err(wrong_password(&page, from, &name).await);
    }
    let mut response = who_is(&user, &page)?;
    response.headers_mut().insert(header::SET_COOKIE, shown);
    Ok(response)
}

fn cookie_header(page: &PageState, token: &str) -> Result<HeaderValue, ApiError> {
    let text = cookie(page.settings.secure, token);
    HeaderValue::from_str(&text).map_err(ApiError::inside)
}

pub(super) async fn me(State(page): Shared, Extension(user): Extension<User>) -> ApiResult {
    who_is(&user, &page)
}

pub(super) async fn logout(
    State(page): Shared,
    Extension(user): Extension<User>,
    headers: HeaderMap,
) -> ApiResult {
    if let Some(token) = token(&headers, page.settings.secure) {
        page.query(move |store| store.end_session(&token, &user.name)).await?;
    }
    let mut response = done()?;
    response.headers_mut().insert(header::SET_COOKIE, cookie_header(&page, "")?);
    Ok(response)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NewPassword {
    old: String,
    new: String,
}

async fn hashed(page: &Arc<PageState>, password: String) -> Result<String, ApiError> {
    let password = Password::chosen(password).map_err(|e| ApiError::wrong(e.to_string()))?;
    let place = page.password_place().await;
    let made = in_place(place, move || hash(&password)).await;
    made.map_err(|_| ApiError::inside("hashing a password was cancelled"))?
        .map_err(ApiError::inside)
}

pub(super) async fn password(
    State(page): Shared,
    Extension(from): Extension<SocketAddr>,
    Extension(user): Extension<User>,
    body: Bytes,
) -> ApiResult {
    let NewPassword { old, new } = read(&body)?;
    let name = user.name;
    let (_, compared) = verify_password(&page, from, name.as_str(), old).await?;
    let hash = hashed(&page, new).await?;
    let (of, address) = (name.clone(), from.ip().to_string());
    let replaced = page.query(move |store| store.replace_password(&of, &compared, &hash, &address));
    if !replaced.await? {
        return Err(wrong_password(&page, from, name.as_str()).await);
    }
    done()
}

pub(super) async fn users(State(page): Shared) -> ApiResult {
    document(&page.query(crate::store::Store::users).await?)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NewUser {
    name: UserName,
    role: Role,
    password: String,
}

pub(super) async fn add_user(
    State(page): Shared,
    Extension(from): Extension<SocketAddr>,
    Extension(admin): Extension<User>,
    body: Bytes,
) -> ApiResult {
    let NewUser { name, role, password } = read(&body)?;
    let hash = hashed(&page, password).await?;
    let from = from.ip().to_string();
    page.query(move |store| store.add_user(&name, role, &hash, admin.name.as_str(), &from)).await?;
    done()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ChangedUser {
    role: Role,
    disabled: bool,
    #[serde(default)]
    password: Option<String>,
}

fn named(name: &str) -> Result<UserName, ApiError> {
    name.parse().map_err(|_| ApiError::missing("there is no such user"))
}

pub(super) async fn change_user(
    State(page): Shared,
    Extension(from): Extension<SocketAddr>,
    Extension(admin): Extension<User>,
    Path(name): Path<String>,
    body: Bytes,
) -> ApiResult {
    let name = named(&name)?;
    let ChangedUser { role, disabled, password } = read(&body)?;
    let hash = match password {
        Some(password) => Some(hashed(&page, password).await?),
        None => None,
    };
    let from = from.ip().to_string();
    page.query(move |store| {
        let by = admin.name.as_str();
        store.change_user(&name, role, disabled, by, &from)?;
        match hash {
            Some(hash) => store.set_password(&name, &hash, by, &from),
            None => Ok(()),
        }
    })
    .await?;
    done()
}

pub(super) async fn remove_user(
    State(page): Shared,
    Extension(from): Extension<SocketAddr>,
    Extension(admin): Extension<User>,
    Path(name): Path<String>,
) -> ApiResult {
    let name = named(&name)?;
    let from = from.ip().to_string();
    page.query(move |store| store.remove_user(&name, admin.name.as_str(), &from)).await?;
    done()
}

/// Header that the web interface sends with every change. A page of another origin cannot send it without a preflight request, which this program
/// never grants.
const OURS: &str = "x-volcomp";

/// Name of the cookie. The `__Host-` prefix under TLS makes the browser accept it only from this host and never over a plain connection.
fn cookie_name(secure: bool) -> &'static str {
    if secure { "__Host-volcomp-centre" } else { "volcomp-centre" }
}

/// The `Set-Cookie` header; an empty token deletes the cookie.
fn cookie(secure: bool, token: &str) -> String {
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
