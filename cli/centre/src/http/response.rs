//! Responses: JSON documents and error messages.

use crate::Error;
use axum::{
    Json,
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;
use serde_json::json;

/// A rejected request.
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

    /// The request is invalid.
    pub(super) fn wrong(why: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, why)
    }

    /// The resource does not exist.
    pub(super) fn missing(why: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, why)
    }

    /// The request conflicts with the stored state.
    pub(super) fn conflict(why: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, why)
    }

    /// An internal failure; the details go to the log, not to the response.
    pub(super) fn inside(why: impl std::fmt::Display) -> Self {
        tracing::error!("page: {why}");
        Self::new(
            StatusCode::INTERNAL_SERVER_ERROR,
            "internal error: see the log of the centre",
        )
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

/// A document that is already serialized.
pub(super) fn json_bytes(bytes: impl Into<axum::body::Body>) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], bytes.into()).into_response()
}

pub(super) fn done() -> ApiResult {
    document(&json!({ "done": true }))
}

/// Parses the JSON body of a request.
pub(super) fn read<T: serde::de::DeserializeOwned>(body: &[u8]) -> Result<T, ApiError> {
    serde_json::from_slice(body).map_err(|error| ApiError::wrong(format!("request body: {error}")))
}
