//! Routes for models and their roll-outs: status, user requests, return to an earlier model, downloads.
//!
//! A model is downloaded as its machine file, exactly as signed, or as compensation tables for a control, as `volcomp
//! export` writes them.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, Query, State},
    http::{HeaderValue, header},
    response::{IntoResponse, Response},
};
use serde::{Deserialize, Serialize};
use serde_json::json;
use volcomp_fleet::MachineId;
use volcomp_model::{Machine, Temperatures};
use volcomp_tables::axis_table::{
    AxisNumbers, ExchangeError, Facts, Format, TableOptions, UnknownFormat, WriteOptions, Written,
    sampled, write,
};
use volcomp_vocabulary::AxisName;

use crate::{
    Error,
    http::{
        machines::named,
        state::{ApiError, ApiResult, PageState, Shared, document, done, json_bytes, read},
    },
    map::error_map,
    models::{ModelDescription, NewModel, fits},
    records::{Model, Origin},
    rollout::{Rollout, Rules, UserRequest},
    store::Store,
    users::User,
    versions::{load_active_version, start_way_back},
};

const MAX_ROLLOUTS: u32 = 20;

#[derive(Serialize)]
struct RolloutView {
    #[serde(flatten)]
    rollout: Rollout,
    /// Machines on which the model of a stopped or aborted roll-out is active now. The user must decide whether they
    /// keep it.
    in_force_on: Vec<MachineId>,
}

pub(super) async fn rollouts(State(page): Shared) -> ApiResult {
    document(&page.query(views).await?)
}

fn views(store: &Store) -> Result<Vec<RolloutView>, Error> {
    let rollouts = store.rollouts(MAX_ROLLOUTS)?;
    let has_broken_off = (rollouts.iter()).any(|rollout| rollout.phase.is_broken_off());
    let in_force =
        if has_broken_off { rollouts_in_force(store, &rollouts)? } else { BTreeMap::new() };
    let views = rollouts.into_iter().map(|rollout| {
        let targets = rollout.targets.iter().map(|target| &target.machine);
        let in_force_on = targets.filter(|name| in_force.get(name) == Some(&rollout.id));
        RolloutView { in_force_on: in_force_on.cloned().collect(), rollout }
    });
    Ok(views.collect())
}

/// For each machine of a stopped or aborted roll-out, the roll-out whose model is active.
fn rollouts_in_force(
    store: &Store,
    rollouts: &[Rollout],
) -> Result<BTreeMap<MachineId, u64>, Error> {
    let (newest, lives) = (store.newest_versions()?, store.live()?);
    let broken_off = (rollouts.iter()).filter(|rollout| rollout.phase.is_broken_off());
    let machines: BTreeSet<&MachineId> = broken_off
        .flat_map(|rollout| rollout.targets.iter().map(|target| &target.machine))
        .collect();
    let mut found = BTreeMap::new();
    for name in machines {
        let version = load_active_version(store, name, newest.get(name), lives.get(name))?;
        if let Some(rollout) = version.and_then(|version| version.rollout) {
            found.insert(name.clone(), rollout);
        }
    }
    Ok(found)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StartRequest {
    /// Checksum of the model, or its first digits.
    model: String,
    machines: Vec<MachineId>,
    /// Canary machines, in addition to those registered as canaries.
    #[serde(default)]
    canaries: Vec<MachineId>,
    /// Roll-out rules [default: those of the configuration].
    #[serde(default)]
    rules: Option<Rules>,
}

pub(super) async fn rules(State(page): Shared) -> ApiResult {
    document(&page.settings.rules)
}

pub(super) async fn start_rollout(
    State(page): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> ApiResult {
    let start: StartRequest = read(&body)?;
    let rules = start.rules.clone();
    let rules = rules.unwrap_or_else(|| page.settings.rules.clone());
    let checked = rules.check();
    checked.map_err(|(key, why)| ApiError::wrong(format!("rules.{key}: {why}")))?;
    let started = page.query(move |store| Ok(begin(store, &start, rules, &user))).await??;
    document(&started)
}

fn begin(
    store: &Store,
    start: &StartRequest,
    rules: Rules,
    user: &User,
) -> Result<Rollout, ApiError> {
    let model =
        store.model(&start.model)?.ok_or_else(|| ApiError::missing("there is no such model"))?;
    if start.machines.is_empty() {
        return Err(ApiError::wrong("machines: expected at least one"));
    }
    let mut chosen: Vec<(MachineId, bool)> = Vec::new();
    for id in &start.machines {
        let machine = store
            .machine(id)?
            .ok_or_else(|| ApiError::missing(format!("there is no machine {id}")))?;
        fits(&model, &machine).map_err(|error| ApiError::conflict(error.to_string()))?;
        if !chosen.iter().any(|(known, _)| known == id) {
            chosen.push((id.clone(), machine.canary || start.canaries.contains(id)));
        }
    }
    Ok(store.begin_rollout(&model.sha256, &chosen, rules, user.name.as_str())?)
}

pub(super) async fn request(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
    body: Bytes,
) -> ApiResult {
    let request: UserRequest = read(&body)?;
    page.query(move |store| store.request_rollout_change(id, &request, user.name.as_str())).await?;
    done()
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KeepRequest {
    machine: MachineId,
}

pub(super) async fn keep(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
    body: Bytes,
) -> ApiResult {
    let KeepRequest { machine } = read(&body)?;
    page.query(move |store| store.keep_model(id, &machine, user.name.as_str())).await?;
    done()
}

pub(super) async fn back(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(name): Path<String>,
) -> ApiResult {
    let machine = named(&name)?;
    let rules = page.settings.rules.clone();
    let (rollout, _) =
        page.query(move |store| start_way_back(store, &machine, rules, user.name.as_str())).await?;
    document(&rollout)
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        issue::Fixture,
        records::Live,
        rollout::{Phase, Step},
    };

    /// A machine activated the model of a roll-out, but its acknowledgement was lost, so the roll-out still waits for
    /// it. The view shows the version that the machine reports, so that the user can decide.
    #[test]
    fn a_machine_that_reports_the_model_is_listed_as_having_it() {
        let fixture = Fixture::new();
        let machines = [(fixture.name().clone(), true)];
        let started = fixture.store.start_rollout(|id| {
            let mut rollout = Rollout::new(id, "ab", &machines, Rules::default(), "anna", 0.0);
            rollout.phase = Phase::Aborted { by: "anna".into() };
            rollout
        });
        let id = started.expect("stored").id;
        fixture.issue(1, id, None);
        let in_force_on = || views(&fixture.store).expect("a store").remove(0).in_force_on;
        assert!(in_force_on().is_empty(), "no message yet");
        let live = Live::new(fixture.name().clone(), 1.0, 1);
        fixture.store.put_live(&[live]).expect("stored");
        assert_eq!(in_force_on(), [fixture.name().clone()]);
        let rollout = fixture.store.rollout(id).expect("a store").expect("there");
        assert_eq!(rollout.targets[0].step, Step::Waiting);
    }
}
