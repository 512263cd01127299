//! Requests about models: their state, uploads and activation.

use std::time::Duration;

use axum::{
    Json, Router,
    body::{Body, Bytes},
    extract::{DefaultBodyLimit, Query, State},
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
    routing::post,
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use tokio_stream::StreamExt;

use super::{
    door::{Engineer, UPLOAD, answer, refuse},
    routes::Shared,
};
use crate::{
    documents::{ModelActivate, ModelBack, ModelRequest},
    models::{Answering, LARGEST_FILE, Place},
    request::Reply,
};

/// Maximum size of a request body without a file, bytes.
const MAX_BODY: usize = 16 * 1024;
/// Timeout between two parts of a file.
const PART_WITHIN: Duration = Duration::from_secs(30);

/// Routes for engineers.
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

fn answered<T: Serialize>(found: Result<T, Reply>) -> Response {
    match found {
        Ok(document) => Json(document).into_response(),
        Err(reply) => answer(reply),
    }
}

/// Decodes the body of a request; the error response states what is wrong.
fn decoded<T: DeserializeOwned>(body: &Bytes) -> Result<T, Box<Response>> {
    serde_json::from_slice(body).map_err(|e| {
        let what = format!("the body is wrong: {e}");
        Box::new(refuse(StatusCode::BAD_REQUEST, &what))
    })
}

/// Query parameters of an upload.
#[derive(Deserialize)]
struct Upload {
    kind: String,
    name: String,
}

/// Receives a machine file, which is the body of the request.
async fn upload(
    State(dashboard): State<Shared>,
    Engineer(who): Engineer,
    headers: HeaderMap,
    asked: Result<Query<Upload>, axum::extract::rejection::QueryRejection>,
    body: Body,
) -> Response {
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
    // Released when the file is received or the upload fails.
    let _place: Place = match models.place() {
        Ok(place) => place,
        Err(reply) => return answer(reply),
    };
    match received(&headers, body).await {
        Ok(bytes) => answered(models.take(&who, &asked.name, bytes)),
        Err(refusal) => *refusal,
    }
}

/// Reads the complete body.
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
            // Disconnected or timed out: discard the received part.
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

async fn discard(State(dashboard): State<Shared>, _: Engineer, body: Bytes) -> Response {
    match decoded::<ModelRequest>(&body) {
        Ok(asked) => answered(dashboard.models.discard(&asked.candidate)),
        Err(refusal) => *refusal,
    }
}

async fn activate(
    State(dashboard): State<Shared>,
    Engineer(who): Engineer,
    body: Bytes,
) -> Response {
    let ModelActivate {
        candidate,
        hash,
        confirm,
    } = match decoded(&body) {
        Ok(asked) => asked,
        Err(refusal) => return *refusal,
    };
    answer_of(dashboard.models.activate(&who, &candidate, &hash, confirm)).await
}

async fn back(State(dashboard): State<Shared>, Engineer(who): Engineer, body: Bytes) -> Response {
    match decoded::<ModelBack>(&body) {
        Ok(asked) => answer_of(dashboard.models.back(&who, asked.hash, asked.confirm)).await,
        Err(refusal) => *refusal,
    }
}

async fn answer_of(asked: Result<Answering, Reply>) -> Response {
    answer(match asked {
        Err(reply) => reply,
        Ok(answering) => answering.answer().await,
    })
}
