//! The requests about models: how it stands, files that are uploaded, answers to questions, and the way into force.

use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
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
use tokio::sync::{mpsc, oneshot};
use tokio_stream::StreamExt;

use super::{
    door::{UPLOAD, bearer, refuse},
    routes::Shared,
    tokens::{Holder, Role},
};
use crate::{
    documents::{ModelActivate, ModelAnswers, ModelBack, ModelRequest, ModelTakeOff},
    models::{Answering, Place, UploadError, UploadKind},
    request::Reply,
};

/// The largest body of a request that brings no file, bytes: two hundred files have many questions.
const MAX_BODY: usize = 1024 * 1024;
/// The next part of a file must come within this.
const PART_WITHIN: Duration = Duration::from_secs(30);
/// So many parts of a file wait for the disk.
const PARTS: usize = 4;

/// The requests of an engineer.
pub(super) fn router() -> Router<Shared> {
    Router::new()
        .route(UPLOAD, post(upload))
        .route("/api/model/draft", post(draft))
        .route("/api/model/answers", post(answers))
        .route("/api/model/activate", post(activate))
        .route("/api/model/back", post(back))
        .route("/api/model/discard", post(discard))
        .route("/api/model/take-off", post(take_off))
        .layer(DefaultBodyLimit::max(MAX_BODY))
}

pub(super) async fn state(State(dashboard): State<Shared>) -> Response {
    Json(dashboard.models.state()).into_response()
}

pub(super) async fn candidate(State(dashboard): State<Shared>) -> Response {
    match dashboard.models.candidate() {
        Some(candidate) => Json(candidate).into_response(),
        None => refuse(StatusCode::NOT_FOUND, "nobody is making a model"),
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

/// What the address of an upload says.
#[derive(Deserialize)]
struct Upload {
    kind: String,
    name: String,
    candidate: Option<String>,
}

/// Takes one file: its body is the file itself.
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
        return refuse(
            StatusCode::BAD_REQUEST,
            "expected ?kind=machine or measurement, &name=NAME in UTF-8, and &candidate=ID from the second file on",
        );
    };
    let kind = match asked.kind.as_str() {
        "machine" => UploadKind::Machine,
        "measurement" => UploadKind::Measurement,
        _ => {
            return refuse(
                StatusCode::BAD_REQUEST,
                "expected kind=machine or kind=measurement",
            );
        }
    };
    let length = headers
        .get(header::CONTENT_LENGTH)
        .and_then(|length| length.to_str().ok()?.parse().ok());
    let models = &dashboard.models;
    let id = asked.candidate.as_deref();
    let place = match models.begin_file(&holder.name, kind, &asked.name, id, length) {
        Ok(place) => Arc::new(place),
        Err(reply) => return told(reply),
    };
    match received(&dashboard, &place, body).await {
        Ok(bytes) => answered(models.file_done(&place, bytes)),
        Err(error) => told(models.file_failed(&place, &error)),
    }
}

/// A part of a file for the thread that writes it.
enum Part {
    Bytes(Bytes),
    End,
}

/// Brings a body onto the disk: its size.
async fn received(dashboard: &Shared, place: &Arc<Place>, body: Body) -> Result<u64, UploadError> {
    let (parts, coming) = mpsc::channel(PARTS);
    let (tell, written) = oneshot::channel();
    let place = Arc::clone(place);
    dashboard.models.write(move || {
        let done = write(&place, coming);
        // Before it is told: whoever asked gives the place back with the answer.
        drop(place);
        // Whoever asked may have gone.
        let _ = tell.send(done);
    })?;
    let mut stream = body.into_data_stream();
    // A disk that refuses ends the channel, and its reason comes below.
    loop {
        let part = match tokio::time::timeout(PART_WITHIN, stream.next()).await {
            Ok(Some(Ok(bytes))) => Part::Bytes(bytes),
            Ok(None) => Part::End,
            // Cut, or silent: what has come is thrown away.
            Ok(Some(Err(_))) | Err(_) => break,
        };
        let is_end = matches!(part, Part::End);
        if parts.send(part).await.is_err() || is_end {
            break;
        }
    }
    drop(parts);
    let gone = || std::io::Error::other("the thread that writes has ended");
    written.await.unwrap_or_else(|_| Err(gone().into()))
}

/// Writes the parts of a file as they come.
fn write(place: &Place, mut parts: mpsc::Receiver<Part>) -> Result<u64, UploadError> {
    let mut file = place.open()?;
    loop {
        match parts.blocking_recv() {
            Some(Part::Bytes(bytes)) => file.write(&bytes)?,
            Some(Part::End) => return file.done(),
            None => {
                return Err(UploadError::Cut {
                    bytes: file.bytes(),
                });
            }
        }
    }
}

async fn draft(
    State(dashboard): State<Shared>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    match asked::<ModelRequest>(&dashboard, from.ip(), &headers, &body) {
        Ok((_, asked)) => answered(dashboard.models.draft(&asked.candidate)),
        Err(refusal) => *refusal,
    }
}

async fn answers(
    State(dashboard): State<Shared>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    match asked::<ModelAnswers>(&dashboard, from.ip(), &headers, &body) {
        Ok((_, asked)) => answered(dashboard.models.answer(&asked.candidate, asked.answers)),
        Err(refusal) => *refusal,
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

async fn take_off(
    State(dashboard): State<Shared>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    match asked::<ModelTakeOff>(&dashboard, from.ip(), &headers, &body) {
        Ok((_, asked)) => answered(dashboard.models.take_off(&asked.candidate, &asked.name)),
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
