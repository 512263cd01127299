use crate::Error;
use axum::{
    Json,
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;
use serde_json::json;

#[derive(Debug)]
pub(super) struct ApiError {
    status: StatusCode,
    why: String,
}

impl ApiError {
    pub(super) fn new(status: StatusCode, why: impl Into<String>) -> Self {
        let why = why.into();
        Self { status, why }
    }

    pub(super) fn wrong(why: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, why)
    }

    pub(super) fn missing(why: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, why)
    }

    pub(super) fn conflict(why: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, why)
    }

    /// An internal failure; the details go to the log, not to the response.
    pub(super) fn inside(why: impl std::fmt::Display) -> Self {
        tracing::error!("page: {why}");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal error: see the log of the centre")
    }
}

impl From<Error> for ApiError {
    fn from(error: Error) -> Self {
        match error {
            Error::Conflict(_)
            | Error::NotConfirmed(_)
            | Error::Misfit(_)
            | Error::NoWayBack { .. } => Self::conflict(error.to_string()),
            Error::Missing { .. } => Self::missing(error.to_string()),
            error => Self::inside(error),
        }
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        (self.status, Json(json!({ "error": self.why }))).into_response()
    }
}

pub(super) type ApiResult = Result<Response, ApiError>;

pub(super) fn document(document: &impl Serialize) -> ApiResult {
    let bytes = serde_json::to_vec(document).map_err(ApiError::inside)?;
    Ok(json_bytes(bytes))
}

pub(super) fn json_bytes(bytes: impl Into<axum::body::Body>) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], bytes.into()).into_response()
}

pub(super) fn done() -> ApiResult {
    document(&json!({ "done": true }))
}

pub(super) fn read<T: serde::de::DeserializeOwned>(body: &[u8]) -> Result<T, ApiError> {
    serde_json::from_slice(body).map_err(|error| ApiError::wrong(format!("request body: {error}")))
}
