//! The web server of the dashboard: pages, state, events, history, metrics, requests, and uploads of models.

use std::{
    convert::Infallible,
    net::{IpAddr, SocketAddr},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
        mpsc::TrySendError,
    },
    time::Duration,
};

use axum::{
    Extension, Json, Router,
    body::{Body, Bytes},
    extract::{DefaultBodyLimit, FromRequestParts, Query, State, rejection::QueryRejection},
    http::{HeaderMap, StatusCode, header, request::Parts},
    middleware,
    response::{
        IntoResponse, Response,
        sse::{Event, KeepAlive, Sse},
    },
    routing::{get, post},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use tokio::{
    net::TcpListener,
    sync::{Semaphore, oneshot},
    time::MissedTickBehavior,
};
use tokio_stream::{StreamExt, wrappers::IntervalStream};
use tracing::Instrument;
use volcomp_kinematics::State as AxisState;
use volcomp_runtime::{DisarmSwitch, Model};
use volcomp_vocabulary::{AxisName, Displacement, PerAxis};

use crate::{
    audit::{MAX_LAST, last_records},
    documents::{
        Confirmation, DemoState, DisturbRequest, ErrorMap, EventLog, LogEvent, MapAxis,
        ModelActivate, ModelBack, ModelRequest, Status,
    },
    error::GatewayError,
    history::MAX_SPAN_S,
    interop::quantities::{Quantity, length},
    metrics,
    models::{MAX_FILE_BYTES, Models, PendingReply, UploadSlot},
    published::Published,
    request::{Operation, Reply, RequestSender, ServiceRequest},
    simulate::Demo,
};
use access::{UPLOAD_PATH, answer, bearer, check_request, page, refuse, require_view, token};

mod access;

pub use access::{AccessControl, Denied, Holder, Role, Tokens};
pub use volcomp_web::{Tls, serve, tls};

/// Opens the socket of a dashboard.
///
/// # Errors
/// The address cannot be bound.
pub fn listen(address: SocketAddr) -> Result<std::net::TcpListener, GatewayError> {
    std::net::TcpListener::bind(address)
        .and_then(|listener| listener.set_nonblocking(true).map(|()| listener))
        .map_err(|e| match e.kind() {
            std::io::ErrorKind::AddrInUse => GatewayError::failed(format!(
                "dashboard {address}: another program listens there, such as another gateway: stop it, or state another address with --listen"
            )),
            _ => GatewayError::system(format!("dashboard {address}"), e),
        })
}

pub(crate) fn runtime<F>(
    listener: std::net::TcpListener,
    serve: impl FnOnce(TcpListener) -> F,
) -> Result<tokio::runtime::Runtime, GatewayError>
where
    F: Future<Output = ()> + Send + 'static,
{
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .max_blocking_threads(1)
        .thread_name("volcomp-http")
        .thread_stack_size(512 * 1024)
        .enable_io()
        .enable_time()
        .build()
        .map_err(|e| GatewayError::system("dashboard", e))?;
    let guard = runtime.enter();
    let listener =
        TcpListener::from_std(listener).map_err(|e| GatewayError::system("dashboard", e))?;
    drop(guard);
    runtime.spawn(serve(listener).in_current_span());
    Ok(runtime)
}

/// Maximum size of a request body, bytes.
const MAX_BODY: usize = 64 * 1024;
const EVENT_EVERY: Duration = Duration::from_millis(100);

const MAX_STREAMS: usize = 16;

const HTML: &str = "text/html; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SVG: &str = "image/svg+xml";

const PAGES: [(&str, &str, &str); 11] = [
    ("/", HTML, include_str!("../../web/index.html")),
    ("/common.js", JS, include_str!("../../web/common.js")),
    ("/app.js", JS, include_str!("../../web/app.js")),
    ("/history.js", JS, include_str!("../../web/history.js")),
    ("/plot.js", JS, volcomp_web::PLOT_JS),
    ("/style.css", CSS, include_str!("../../web/style.css")),
    ("/model", HTML, include_str!("../../web/model.html")),
    ("/model.js", JS, include_str!("../../web/model.js")),
    ("/curves.js", JS, include_str!("../../web/curves.js")),
    ("/model.css", CSS, include_str!("../../web/model.css")),
    ("/icon.svg", SVG, include_str!("../../web/icon.svg")),
];

/// State shared by the routes.
pub struct Dashboard {
    /// The stored models and the uploaded candidate.
    pub models: Models,
    /// State, history and model published by the service.
    pub published: Published,
    pub quantities: Vec<Quantity>,
    /// Queue of requests to the service.
    pub requests: RequestSender,
    /// Disarms without waiting for the service.
    pub switch: DisarmSwitch,
    /// Tokens, and host names by which browsers may reach the dashboard.
    pub access: Arc<AccessControl>,
    /// Number of open event streams.
    pub streams: AtomicUsize,
    /// Disturbances of the built-in simulation; `None` on a configured machine.
    pub demo: Option<Arc<Demo>>,
    pub audit_dir: PathBuf,
    /// Permit for reading the audit log, held by one request at a time.
    pub log_reader: Arc<Semaphore>,
}

type Shared = Arc<Dashboard>;

struct StreamSlot(Arc<Dashboard>);

impl StreamSlot {
    fn take(dashboard: &Arc<Dashboard>) -> Option<Self> {
        let more = |open| (open < MAX_STREAMS).then_some(open + 1);
        let taken = dashboard.streams.fetch_update(Ordering::AcqRel, Ordering::Acquire, more);
        taken.ok().map(|_| Self(Arc::clone(dashboard)))
    }
}

impl Drop for StreamSlot {
    fn drop(&mut self) {
        self.0.streams.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Name of a token with at least the role of an operator; other requests are refused.
struct Operator(String);

/// Name of a token with the role of an engineer, who may upload and activate models; other requests are refused.
struct Engineer(String);

impl FromRequestParts<Shared> for Operator {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, shared: &Shared) -> Result<Self, Response> {
        holder(parts, shared, Role::Operate).map(Self)
    }
}

impl FromRequestParts<Shared> for Engineer {
    type Rejection = Response;

    async fn from_request_parts(parts: &mut Parts, shared: &Shared) -> Result<Self, Response> {
        holder(parts, shared, Role::Engineer).map(Self)
    }
}

#[expect(clippy::result_large_err, reason = "an answer of HTTP")]
fn holder(parts: &Parts, shared: &Shared, needed: Role) -> Result<String, Response> {
    // The server sets the address on every request; if it is missing, assume a remote one.
    let from = parts.extensions.get::<SocketAddr>();
    let from = from.map_or(IpAddr::from([0; 4]), SocketAddr::ip);
    let checked = (shared.access).check(from, bearer(&parts.headers), needed);
    checked.map(|holder| holder.name).map_err(IntoResponse::into_response)
}

/// Routes for pages, reading and operating.
pub fn router(dashboard: Shared) -> Router {
    let read = Router::new()
        .route("/api/state", get(state))
        .route("/api/events", get(events))
        .route("/api/history", get(history))
        .route("/api/log", get(log))
        .route("/api/map", get(error_map))
        .route("/api/model", get(model_state))
        .route("/api/model/candidate", get(model_candidate))
        .route("/metrics", get(prometheus))
        .layer(middleware::from_fn_with_state(Arc::clone(&dashboard.access), require_view));
    let operate = Router::new()
        .route("/api/arm", post(arm))
        .route("/api/disarm", post(disarm))
        .route("/api/acknowledge", post(acknowledge))
        .route("/api/reload", post(reload))
        .route("/api/disturb", post(disturb))
        .route("/api/token", get(token).with_state(Arc::clone(&dashboard.access)));
    let pages = PAGES.iter().fold(Router::new(), |router, &(path, kind, text)| {
        router.route(path, get(async move || page(kind, text)))
    });
    read.merge(operate)
        .merge(pages)
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .merge(model_routes())
        .layer(middleware::from_fn_with_state(Arc::clone(&dashboard.access), check_request))
        .with_state(dashboard)
}

async fn state(State(dashboard): State<Shared>) -> Response {
    Json(latest(&dashboard)).into_response()
}

fn latest(dashboard: &Dashboard) -> Status {
    let mut status = dashboard.published.latest();
    status.operable = dashboard.access.is_operable();
    status.demo = dashboard.demo.as_ref().map(|demo| DemoState {
        token: dashboard.access.demo_token().map(str::to_owned),
        disturbances: demo.active(),
    });
    status
}

#[derive(Deserialize)]
struct HistoryQuery {
    span_s: Option<u32>,
}

async fn history(
    State(dashboard): State<Shared>,
    query: Result<Query<HistoryQuery>, QueryRejection>,
) -> Response {
    let published = &dashboard.published;
    match query {
        Ok(Query(HistoryQuery { span_s: None })) => Json(published.history()).into_response(),
        Ok(Query(HistoryQuery { span_s: Some(span) })) if (1..=MAX_SPAN_S).contains(&span) => {
            Json(published.history_over(span)).into_response()
        }
        _ => {
            let expected = format!("expected no query, or ?span_s=N with 1 to {MAX_SPAN_S} s");
            refuse(StatusCode::BAD_REQUEST, &expected)
        }
    }
}

/// Default number of events in a response.
const LOG_EVENTS: usize = 50;
/// Timeout for waiting until another request has read the log, and for reading it, each.
const LOG_TIMEOUT: Duration = Duration::from_secs(2);

#[derive(Deserialize)]
struct LogQuery {
    count: Option<usize>,
}

/// Reads the log on a blocking thread, for one request at a time.
async fn log(
    State(dashboard): State<Shared>,
    query: Result<Query<LogQuery>, QueryRejection>,
) -> Response {
    let Ok(Query(LogQuery { count })) = query else {
        let expected = format!("expected no query, or ?count=N with at most {MAX_LAST}");
        return refuse(StatusCode::BAD_REQUEST, &expected);
    };
    let waits = "the disk of the audit log does not answer";
    let permit = Arc::clone(&dashboard.log_reader).acquire_owned();
    let Ok(Ok(permit)) = tokio::time::timeout(LOG_TIMEOUT, permit).await else {
        return refuse(StatusCode::SERVICE_UNAVAILABLE, waits);
    };
    let dir = dashboard.audit_dir.clone();
    let reading = tokio::task::spawn_blocking(move || {
        // The permit is held until the disk has responded, even if the client has disconnected.
        let _permit = permit;
        last_records(&dir, count.unwrap_or(LOG_EVENTS))
    });
    match tokio::time::timeout(LOG_TIMEOUT, reading).await {
        Ok(Ok(Ok(records))) => {
            let events = records.iter().map(LogEvent::from).collect();
            Json(EventLog { events }).into_response()
        }
        Ok(Ok(Err(e))) => {
            let why = format!("audit log: {e}");
            refuse(StatusCode::INTERNAL_SERVER_ERROR, &why)
        }
        _ => refuse(StatusCode::SERVICE_UNAVAILABLE, waits),
    }
}

/// Begins or ends a disturbance of the built-in simulation.
async fn disturb(State(dashboard): State<Shared>, _: Operator, body: Bytes) -> Response {
    let Some(demo) = &dashboard.demo else {
        return refuse(StatusCode::NOT_FOUND, "only the built-in simulation can be disturbed");
    };
    match decoded::<DisturbRequest>(&body) {
        Ok(request) => {
            demo.disturb(request.what, request.on);
            Json(latest(&dashboard)).into_response()
        }
        Err(refusal) => *refusal,
    }
}

async fn prometheus(State(dashboard): State<Shared>) -> Response {
    let text = metrics::text(&dashboard.published.latest(), &dashboard.quantities);
    let kind = "text/plain; version=0.0.4; charset=utf-8";
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

async fn error_map(State(dashboard): State<Shared>) -> Response {
    let published = &dashboard.published;
    Json(error_map_of(&published.model(), &published.latest())).into_response()
}

async fn events(State(dashboard): State<Shared>) -> Response {
    let Some(slot) = StreamSlot::take(&dashboard) else {
        return refuse(
            StatusCode::SERVICE_UNAVAILABLE,
            &format!("{MAX_STREAMS} event streams are open already"),
        );
    };
    let mut ticks = tokio::time::interval(EVENT_EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let stream = IntervalStream::new(ticks).filter_map(move |_| {
        // The closure keeps the slot for the lifetime of the stream.
        let _ = &slot;
        let state = latest(&dashboard);
        let event = Event::default().event("state").json_data(state).ok()?;
        Some(Ok::<_, Infallible>(event))
    });
    Sse::new(stream).keep_alive(KeepAlive::new().interval(Duration::from_secs(10))).into_response()
}

async fn arm(dashboard: State<Shared>, operator: Operator, body: Bytes) -> Response {
    operate(dashboard, operator, &body, Operation::Arm).await
}

async fn disarm(
    State(dashboard): State<Shared>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
) -> Response {
    match dashboard.access.authorize_disarm(from.ip(), &headers) {
        Ok(who) => request(&dashboard, who, Operation::Disarm).await,
        Err(denied) => denied.into_response(),
    }
}

async fn acknowledge(dashboard: State<Shared>, operator: Operator, body: Bytes) -> Response {
    operate(dashboard, operator, &body, |_| Operation::Acknowledge).await
}

async fn reload(dashboard: State<Shared>, operator: Operator, body: Bytes) -> Response {
    operate(dashboard, operator, &body, Operation::Reload).await
}

/// Forwards a request of an operator to the service. The body may contain the hash that confirms a model.
async fn operate(
    State(dashboard): State<Shared>,
    Operator(who): Operator,
    body: &Bytes,
    operation: impl FnOnce(Option<String>) -> Operation,
) -> Response {
    let confirm = if body.is_empty() {
        None
    } else {
        let Ok(Confirmation { confirm }) = serde_json::from_slice(body) else {
            let expected = "expected no body, or {\"confirm\": HASH}";
            return refuse(StatusCode::BAD_REQUEST, expected);
        };
        confirm
    };
    request(&dashboard, who, operation(confirm)).await
}

async fn request(dashboard: &Dashboard, who: String, operation: Operation) -> Response {
    let (reply_to, wait) = oneshot::channel();
    // Creating a disarm request already disarms, even if the queue is full.
    let message = ServiceRequest::new(operation, who, Some(reply_to), &dashboard.switch);
    match dashboard.requests.try_send(message) {
        Ok(()) => {}
        Err(TrySendError::Full(_)) => {
            return refuse(StatusCode::SERVICE_UNAVAILABLE, "too many requests wait");
        }
        Err(TrySendError::Disconnected(_)) => {
            return refuse(StatusCode::SERVICE_UNAVAILABLE, "the gateway is stopping");
        }
    }
    match wait.await {
        Ok(reply) => answer(reply),
        Err(_) => refuse(StatusCode::SERVICE_UNAVAILABLE, "the gateway is stopping"),
    }
}

/// Maximum size of a request body without a file, bytes.
const MAX_MODEL_BODY: usize = 16 * 1024;
/// Timeout between two received parts of a file.
const PART_TIMEOUT: Duration = Duration::from_secs(30);

fn model_routes() -> Router<Shared> {
    Router::new()
        .route(UPLOAD_PATH, post(upload))
        .route("/api/model/activate", post(activate))
        .route("/api/model/back", post(back))
        .route("/api/model/discard", post(discard))
        .layer(DefaultBodyLimit::max(MAX_MODEL_BODY))
}

async fn model_state(State(dashboard): State<Shared>) -> Response {
    Json(dashboard.models.state()).into_response()
}

async fn model_candidate(State(dashboard): State<Shared>) -> Response {
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

/// Decodes the body of a request; the error response describes the invalid value.
fn decoded<T: DeserializeOwned>(body: &Bytes) -> Result<T, Box<Response>> {
    serde_json::from_slice(body).map_err(|e| {
        let what = format!("the body is wrong: {e}");
        Box::new(refuse(StatusCode::BAD_REQUEST, &what))
    })
}

#[derive(Deserialize)]
struct Upload {
    kind: String,
    name: String,
}

/// The body of the request is the machine file.
async fn upload(
    State(dashboard): State<Shared>,
    Engineer(who): Engineer,
    headers: HeaderMap,
    query: Result<Query<Upload>, QueryRejection>,
    body: Body,
) -> Response {
    let Ok(Query(query)) = query else {
        let why = "expected ?kind=machine&name=NAME in UTF-8";
        return refuse(StatusCode::BAD_REQUEST, why);
    };
    match query.kind.as_str() {
        "machine" => {}
        "measurement" => {
            let why = "measurement files are not accepted: convert them to a machine file with `volcomp studio`, which sends it";
            return refuse(StatusCode::BAD_REQUEST, why);
        }
        _ => return refuse(StatusCode::BAD_REQUEST, "expected kind=machine"),
    }
    let models = &dashboard.models;
    // The slot is released when the file is received or the upload fails.
    let _place: UploadSlot = match models.place() {
        Ok(place) => place,
        Err(reply) => return answer(reply),
    };
    match received(&headers, body).await {
        Ok(bytes) => answered(models.take(&who, &query.name, bytes)),
        Err(refusal) => *refusal,
    }
}

async fn received(headers: &HeaderMap, body: Body) -> Result<Vec<u8>, Box<Response>> {
    let refused = |status, why: &str| Err(Box::new(refuse(status, why)));
    let large = || {
        let mib = MAX_FILE_BYTES / 1024 / 1024;
        let why = format!("the file is larger than the maximum of {mib} MiB");
        refused(StatusCode::PAYLOAD_TOO_LARGE, &why)
    };
    let length = headers.get(header::CONTENT_LENGTH);
    let length = length.and_then(|length| length.to_str().ok()?.parse().ok());
    if length.is_some_and(|length: usize| length > MAX_FILE_BYTES) {
        return large();
    }
    let mut bytes = Vec::with_capacity(length.unwrap_or_default());
    let mut stream = body.into_data_stream();
    loop {
        match tokio::time::timeout(PART_TIMEOUT, stream.next()).await {
            Ok(Some(Ok(part))) if bytes.len() + part.len() > MAX_FILE_BYTES => return large(),
            Ok(Some(Ok(part))) => bytes.extend_from_slice(&part),
            Ok(None) => return Ok(bytes),
            // The client disconnected or timed out: discard the received part.
            Ok(Some(Err(_))) | Err(_) => {
                let count = bytes.len();
                let why = format!("the file is incomplete: {count} bytes received, none kept");
                return refused(StatusCode::BAD_REQUEST, &why);
            }
        }
    }
}

async fn discard(State(dashboard): State<Shared>, _: Engineer, body: Bytes) -> Response {
    match decoded::<ModelRequest>(&body) {
        Ok(query) => answered(dashboard.models.discard(&query.candidate)),
        Err(refusal) => *refusal,
    }
}

async fn activate(
    State(dashboard): State<Shared>,
    Engineer(who): Engineer,
    body: Bytes,
) -> Response {
    let ModelActivate { candidate, hash, confirm } = match decoded(&body) {
        Ok(query) => query,
        Err(refusal) => return *refusal,
    };
    answer_of(dashboard.models.activate(&who, &candidate, &hash, confirm)).await
}

async fn back(State(dashboard): State<Shared>, Engineer(who): Engineer, body: Bytes) -> Response {
    match decoded::<ModelBack>(&body) {
        Ok(query) => answer_of(dashboard.models.back(&who, query.hash, query.confirm)).await,
        Err(refusal) => *refusal,
    }
}

async fn answer_of(query: Result<PendingReply, Reply>) -> Response {
    answer(match query {
        Err(reply) => reply,
        Ok(answering) => answering.answer().await,
    })
}

const NODES: usize = 25;

/// Length of the position error, µm, over the travels of the first two linear axes, with the other axes at their
/// current positions. Empty if there are fewer than two linear axes or the position of an axis is unknown.
fn error_map_of(model: &Model, status: &Status) -> ErrorMap {
    let mut linear: Vec<(AxisName, usize)> = model
        .axes
        .iter()
        .enumerate()
        .filter(|(_, name)| !name.is_rotary())
        .map(|(index, name)| (*name, index))
        .collect();
    linear.sort_unstable();
    let [(_, first), (_, second), ..] = linear[..] else {
        return ErrorMap::default();
    };
    let temperature = |name: &str| {
        let mut sensors = status.temperatures.iter();
        sensors.find(|sensor| sensor.name == name)?.degc
    };
    let model = model.warmed(temperature);
    let mut at = AxisState::default();
    for (q, name) in at.q.iter_mut().zip(&model.axes) {
        let shown = if name.is_rotary() { &status.positions_deg } else { &status.positions_mm };
        // Without the position of every axis there is no map.
        let Some(coordinate) = shown.get(name).copied() else {
            return ErrorMap::default();
        };
        *q = Displacement::from_coordinate(name.kind(), coordinate).mm_or_rad();
    }
    let nodes = |axis: usize| {
        let [low, high] = model.travel[axis].map(Displacement::mm_or_rad);
        (0..NODES).map(move |i| low + (high - low) * i as f64 / (NODES - 1) as f64)
    };
    let error_um = nodes(second)
        .map(|y| {
            nodes(first)
                .map(|x| {
                    let mut state = at;
                    (state.q[first], state.q[second]) = (x, y);
                    let [error, _] = model.errors(&state, &PerAxis::ZERO);
                    (1e4 * length(error.position_mm)).round() / 10.0
                })
                .collect()
        })
        .collect();
    let axis = |index: usize| MapAxis {
        name: model.axes[index],
        travel: model.travel[index].map(Displacement::mm_or_deg),
    };
    ErrorMap { axes: vec![axis(first), axis(second)], error_um }
}
