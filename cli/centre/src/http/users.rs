//! Login and logout, passwords and user management.

use std::{net::SocketAddr, sync::Arc};

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, State},
    http::{HeaderMap, HeaderValue, StatusCode, header},
};
use serde::Deserialize;
use serde_json::json;

use super::{
    access,
    response::{ApiError, ApiResult, document, done, read},
    state::{PageState, Shared, in_place},
};
use crate::users::{
    BootTime, Password, Refusal, Role, Session, Token, User, UserName, hash, is_right,
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
    let shown = cookie(&page, token.text())?;
    let begun = page.query(move |store| store.begin_session(&token, &session, &compared));
    if !begun.await? {
        return Err(wrong_password(&page, from, &name).await);
    }
    let mut response = who_is(&user, &page)?;
    response.headers_mut().insert(header::SET_COOKIE, shown);
    Ok(response)
}

fn cookie(page: &PageState, token: &str) -> Result<HeaderValue, ApiError> {
    let text = access::cookie(page.settings.secure, token);
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
    if let Some(token) = access::token(&headers, page.settings.secure) {
        page.query(move |store| store.end_session(&token, &user.name)).await?;
    }
    let mut response = done()?;
    response.headers_mut().insert(header::SET_COOKIE, cookie(&page, "")?);
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
