//! The requests about models: their state, a machine file that is received, and the way into force.

use std::{
    net::{IpAddr, SocketAddr},
    time::Duration,
};

use axum::{
    Extension, Json, Router,
    body::{Body, Bytes},
    extract::{DefaultBodyLimit, Query, State},
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
    routing::post,
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use tokio_stream::StreamExt;

use super::{
    door::{UPLOAD, bearer, refuse},
    routes::Shared,
    tokens::{Holder, Role},
};
use crate::{
    documents::{ModelActivate, ModelBack, ModelRequest},
    models::{Answering, LARGEST_FILE, Place},
    request::Reply,
};

/// The largest body of a request that brings no file, bytes.
const MAX_BODY: usize = 16 * 1024;
/// The next part of a file must come within this.
const PART_WITHIN: Duration = Duration::from_secs(30);

/// The requests of an engineer.
pub(super) fn router() -> Router<Shared> {
    Router::new()
        .route(UPLOAD, post(upload))
        .route("/api/model/activate", post(activate))
        .route("/api/model/back", post(back))
        .route("/api/model/discard", post(discard))
        .layer(DefaultBodyLimit::max(MAX_BODY))
}

pub(super) async fn state(State(dashboard): State<Shared>) -> Response {
    Json(dashboard.models.state()).into_response()
}

pub(super) async fn candidate(State(dashboard): State<Shared>) -> Response {
    match dashboard.models.candidate() {
        Some(candidate) => Json(candidate).into_response(),
        None => refuse(StatusCode::NOT_FOUND, "no engineer has sent a machine file"),
    }
}

/// Lets an engineer in.
fn engineer(
    dashboard: &Shared,
    from: IpAddr,
    headers: &HeaderMap,
) -> Result<Holder, Box<Response>> {
    let tokens = &dashboard.door.tokens;
    let checked = tokens.check(from, bearer(headers), Role::Engineer);
    checked.map_err(|denied| Box::new(denied.into_response()))
}

fn told(reply: Reply) -> Response {
    let status = StatusCode::from_u16(reply.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    (status, Json(reply.answer)).into_response()
}

fn answered<T: Serialize>(found: Result<T, Reply>) -> Response {
    match found {
        Ok(document) => Json(document).into_response(),
        Err(reply) => told(reply),
    }
}

/// The body of a request; what is wrong with it is told.
fn decoded<T: DeserializeOwned>(body: &Bytes) -> Result<T, Box<Response>> {
    serde_json::from_slice(body).map_err(|e| {
        let what = format!("the body is wrong: {e}");
        Box::new(refuse(StatusCode::BAD_REQUEST, &what))
    })
}

/// What an engineer asks for, and who that is.
fn asked<T: DeserializeOwned>(
    dashboard: &Shared,
    from: IpAddr,
    headers: &HeaderMap,
    body: &Bytes,
) -> Result<(Holder, T), Box<Response>> {
    let holder = engineer(dashboard, from, headers)?;
    Ok((holder, decoded(body)?))
}

/// The query of an upload.
#[derive(Deserialize)]
struct Upload {
    kind: String,
    name: String,
}

/// Takes a machine file: the body is the file itself.
async fn upload(
    State(dashboard): State<Shared>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
    asked: Result<Query<Upload>, axum::extract::rejection::QueryRejection>,
    body: Body,
) -> Response {
    let holder = match engineer(&dashboard, from.ip(), &headers) {
        Ok(holder) => holder,
        Err(denied) => return *denied,
    };
    let Ok(Query(asked)) = asked else {
        let why = "expected ?kind=machine&name=NAME in UTF-8";
        return refuse(StatusCode::BAD_REQUEST, why);
    };
    match asked.kind.as_str() {
        "machine" => {}
        "measurement" => {
            let why = "measurement files are not taken here: make a machine file of them with `volcomp studio`, which sends it";
            return refuse(StatusCode::BAD_REQUEST, why);
        }
        _ => return refuse(StatusCode::BAD_REQUEST, "expected kind=machine"),
    }
    let models = &dashboard.models;
    // Given back when the file is received, or has failed.
    let _place: Place = match models.place() {
        Ok(place) => place,
        Err(reply) => return told(reply),
    };
    match received(&headers, body).await {
        Ok(bytes) => answered(models.take(&holder.name, &asked.name, bytes)),
        Err(refusal) => *refusal,
    }
}

/// The whole body.
async fn received(headers: &HeaderMap, body: Body) -> Result<Vec<u8>, Box<Response>> {
    let refused = |status, why: &str| Err(Box::new(refuse(status, why)));
    let large = || {
        let mib = LARGEST_FILE / 1024 / 1024;
        let why = format!("the file is larger than {mib} MiB, the most that is taken");
        refused(StatusCode::PAYLOAD_TOO_LARGE, &why)
    };
    let length = headers.get(header::CONTENT_LENGTH);
    let length = length.and_then(|length| length.to_str().ok()?.parse().ok());
    if length.is_some_and(|length: usize| length > LARGEST_FILE) {
        return large();
    }
    let mut bytes = Vec::with_capacity(length.unwrap_or_default());
    let mut stream = body.into_data_stream();
    loop {
        match tokio::time::timeout(PART_WITHIN, stream.next()).await {
            Ok(Some(Ok(part))) if bytes.len() + part.len() > LARGEST_FILE => return large(),
            Ok(Some(Ok(part))) => bytes.extend_from_slice(&part),
            Ok(None) => return Ok(bytes),
            // Cut, or silent: what has come is thrown away.
            Ok(Some(Err(_))) | Err(_) => {
                let count = bytes.len();
                let why = format!(
                    "the file ended in the middle: {count} bytes came, and nothing of it was kept"
                );
                return refused(StatusCode::BAD_REQUEST, &why);
            }
        }
    }
}

async fn discard(
    State(dashboard): State<Shared>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    match asked::<ModelRequest>(&dashboard, from.ip(), &headers, &body) {
        Ok((_, asked)) => answered(dashboard.models.discard(&asked.candidate)),
        Err(refusal) => *refusal,
    }
}

async fn activate(
    State(dashboard): State<Shared>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    match asked::<ModelActivate>(&dashboard, from.ip(), &headers, &body) {
        Ok((holder, asked)) => {
            let models = &dashboard.models;
            let (candidate, hash) = (&asked.candidate, &asked.hash);
            answer_of(models.activate(&holder.name, candidate, hash, asked.confirm)).await
        }
        Err(refusal) => *refusal,
    }
}

async fn back(
    State(dashboard): State<Shared>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    match asked::<ModelBack>(&dashboard, from.ip(), &headers, &body) {
        Ok((holder, asked)) => {
            let models = &dashboard.models;
            answer_of(models.back(&holder.name, asked.hash, asked.confirm)).await
        }
        Err(refusal) => *refusal,
    }
}

async fn answer_of(asked: Result<Answering, Reply>) -> Response {
    told(match asked {
        Err(reply) => reply,
        Ok(answering) => answering.answer().await,
    })
}
