use std::sync::Arc;

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, State},
};
use serde::Deserialize;
use serde_json::json;
use volcomp_model::Machine;

use super::{
    response::{ApiError, ApiResult, document, json_bytes, read},
    state::{PageState, Shared},
};
use crate::{
    map::error_map,
    models::{ModelDescription, NewModel},
    records::{Model, Origin},
    store::Store,
    users::User,
};

pub(super) async fn models(State(page): Shared) -> ApiResult {
    document(&page.query(Store::models).await?)
}

pub(super) async fn found(
    page: &Arc<PageState>,
    checksum: String,
) -> Result<(Model, String), ApiError> {
    let found = page.query(move |store| {
        let Some(model) = store.model(&checksum)? else {
            return Ok(None);
        };
        let text = store.model_text(&model.sha256)?;
        Ok(text.map(|text| (model, text)))
    });
    found.await?.ok_or_else(|| ApiError::missing("there is no such model"))
}

pub(super) async fn model(State(page): Shared, Path(checksum): Path<String>) -> ApiResult {
    let (model, text) = found(&page, checksum).await?;
    let described = page
        .work(move || {
            Machine::parse(&text, "the model").map(|machine| ModelDescription::new(&machine, &text))
        })
        .await?
        .map_err(ApiError::inside)?;
    document(&json!({ "model": model, "described": described }))
}

pub(super) async fn map(State(page): Shared, Path(checksum): Path<String>) -> ApiResult {
    let (model, text) = found(&page, checksum).await?;
    if let Some(kept) = page.kept_map(&model.sha256) {
        return Ok(json_bytes(kept));
    }
    let map = page
        .work(move || Machine::parse(&text, "the model").and_then(|machine| error_map(&machine)))
        .await?
        .map_err(ApiError::inside)?;
    let bytes: Bytes = serde_json::to_vec(&map).map_err(ApiError::inside)?.into();
    page.keep_map(&model.sha256, bytes.clone());
    Ok(json_bytes(bytes))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NewModelRequest {
    text: String,
    /// Day of the measurements, `2026-11-25`; empty if unknown.
    #[serde(default)]
    measured: String,
    #[serde(default)]
    file: String,
}

pub(super) async fn add(
    State(page): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> ApiResult {
    let NewModelRequest { text, measured, file: name } = read(&body)?;
    if name.chars().count() > 1000 {
        return Err(ApiError::wrong("file: expected at most 1000 characters"));
    }
    let by = user.name.to_string();
    let made = page.work(move || {
        NewModel::of_text(text, "the machine file", Origin::File { name }, &by)?
            .with_day_and_note(&measured)
    });
    let NewModel { model, text } =
        (made.await?).map_err(|error| ApiError::wrong(error.to_string()))?;
    let answer = model.clone();
    let added = page.query(move |store| store.add_model(&model, &text)).await?;
    // `added` is false if the store already had the model.
    document(&json!({ "model": answer, "added": added }))
}
