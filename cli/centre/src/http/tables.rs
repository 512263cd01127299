//! Downloads of a model: its machine file exactly as signed, and its compensation tables for a control, as `volcomp export` writes them.

use std::sync::Arc;

use axum::{
    extract::{Path, Query, State},
    http::{HeaderValue, header},
    response::{IntoResponse, Response},
};
use serde::Deserialize;
use serde_json::json;
use volcomp_model::{Machine, Temperatures};
use volcomp_tables::axis_table::{
    AxisNumbers, ExchangeError, Facts, Format, TableOptions, UnknownFormat, WriteOptions, Written,
    sampled, write,
};
use volcomp_vocabulary::AxisName;

use super::{
    models::found,
    response::{ApiError, ApiResult, document},
    state::{PageState, Shared},
};
use crate::records::Model;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TableQuery {
    #[serde(default)]
    format: String,
    #[serde(default)]
    step_mm: Option<f64>,
    #[serde(default)]
    step_deg: Option<f64>,
}

pub(super) async fn formats() -> ApiResult {
    let formats =
        Format::ALL.map(|format| json!({ "format": format.name(), "trust": format.trust() }));
    document(&formats.as_slice())
}

pub(super) async fn file(State(page): Shared, Path(checksum): Path<String>) -> ApiResult {
    let (model, text) = found(&page, checksum).await?;
    attachment(&file_name(&model), "application/toml", text)
}

pub(super) async fn tables(
    State(page): Shared,
    Path(checksum): Path<String>,
    Query(query): Query<TableQuery>,
) -> ApiResult {
    let (format, at, written) = made(&page, checksum, query).await?;
    let files: Vec<&str> = (written.files.iter()).map(|file| file.name.as_str()).collect();
    document(&json!({
        "format": format.name(),
        "files": files,
        // Positions of the axes that a table does not cover, mm and deg.
        "at": at,
        "sign": format.sign(),
        "trust": format.trust(),
        // Settings that the files do not contain and that must be made at the control.
        "notes": written.notes,
    }))
}

pub(super) async fn table(
    State(page): Shared,
    Path((checksum, name)): Path<(String, String)>,
    Query(query): Query<TableQuery>,
) -> ApiResult {
    let (_, _, written) = made(&page, checksum, query).await?;
    let mut files = written.files.into_iter();
    let file = files
        .find(|file| file.name == name)
        .ok_or_else(|| ApiError::missing("the format has no such file"))?;
    attachment(&name, "text/plain; charset=utf-8", file.text)
}

/// Exports the tables of a format. Returns the format, the positions at which the other axes are
/// held (mm, deg), and the files.
async fn made(
    page: &Arc<PageState>,
    checksum: String,
    query: TableQuery,
) -> Result<(Format, Vec<(AxisName, f64)>, Written), ApiError> {
    let format: Format = (query.format.parse())
        .map_err(|error: UnknownFormat| ApiError::wrong(format!("format: {error}")))?;
    let (_, text) = found(page, checksum).await?;
    page.work(move || {
        let machine = Machine::parse(&text, "the model").map_err(ApiError::inside)?;
        let usual = TableOptions::default();
        let options = TableOptions {
            step_mm: query.step_mm.unwrap_or(usual.step_mm),
            step_deg: query.step_deg.unwrap_or(usual.step_deg),
            ..usual
        };
        let written = || {
            let at = options.reference(&machine)?;
            let content = sampled(&machine, &Temperatures::new(), &options, format)?;
            let write_options = WriteOptions {
                facts: Facts::of(&machine, at.clone(), String::new()),
                axes: AxisNumbers::of_machine(&machine),
                encoder: 0,
                detection_unit: 0.001,
            };
            Ok((format, at, write(format, &content, &write_options)?))
        };
        written().map_err(|error| refused(&error))
    })
    .await?
}

/// Rejection of an export, naming the fields of the web interface.
fn refused(error: &ExchangeError) -> ApiError {
    let ExchangeError::InvalidOption { what, found, expected } = error else {
        return ApiError::wrong(error.to_string());
    };
    let field = match what.as_str() {
        "--step" => "Step along linear axes",
        "--step-deg" => "Step along rotary axes",
        other => other,
    };
    ApiError::wrong(format!("{field}: found {found}, expected {expected}"))
}

/// File name for a model; characters of its name that could form a path are replaced.
fn file_name(model: &Model) -> String {
    let kept = |letter: char| letter.is_ascii_alphanumeric() || letter == '-';
    let name: String = (model.name.chars().take(40))
        .map(|letter| if kept(letter) { letter } else { '-' })
        .collect();
    let name = name.trim_matches('-');
    let name = if name.is_empty() { "model" } else { name };
    format!("{name}-{}.toml", model.sha256.get(..10).unwrap_or_default())
}

fn attachment(name: &str, kind: &'static str, text: String) -> ApiResult {
    let disposition = HeaderValue::from_str(&format!("attachment; filename=\"{name}\""))
        .map_err(ApiError::inside)?;
    let head = [
        (header::CONTENT_TYPE, HeaderValue::from_static(kind)),
        (header::CONTENT_DISPOSITION, disposition),
    ];
    let response: Response = (head, text).into_response();
    Ok(response)
}
