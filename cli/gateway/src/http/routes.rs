//! The routes of the dashboard.

use std::{
    convert::Infallible,
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
        mpsc::TrySendError,
    },
    time::Duration,
};

use axum::{
    Extension, Json, Router,
    body::Bytes,
    extract::{DefaultBodyLimit, State},
    http::{HeaderMap, StatusCode, header},
    middleware,
    response::{
        IntoResponse, Response,
        sse::{Event, KeepAlive, Sse},
    },
    routing::{get, post},
};
use tokio::{sync::oneshot, time::MissedTickBehavior};
use tokio_stream::{StreamExt, wrappers::IntervalStream};
use volcomp_runtime::DisarmSwitch;

use super::{
    door::{self, Door, Operator, refuse},
    map, model,
    tokens::Role,
};

use crate::{
    documents::{Confirmation, Status},
    interop::quantities::Quantity,
    metrics,
    models::Models,
    published::Published,
    request::{Ask, Asked, Asks},
};

/// Maximum size of a request body, bytes.
const MAX_BODY: usize = 64 * 1024;
/// Interval between two events of a stream.
const EVENT_EVERY: Duration = Duration::from_millis(100);

/// Maximum number of concurrent event streams.
const MAX_STREAMS: usize = 16;

const HTML: &str = "text/html; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SVG: &str = "image/svg+xml";

/// Static files of the web interface: path, content type and content.
const PAGES: [(&str, &str, &str); 9] = [
    ("/", HTML, include_str!("../../web/index.html")),
    ("/app.js", JS, include_str!("../../web/app.js")),
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
    /// The kept models and the candidate.
    pub models: Models,
    /// State, history and model published by the service.
    pub published: Published,
    /// Quantities of the gateway.
    pub quantities: Vec<Quantity>,
    /// Queue of requests to the service.
    pub asks: Asks,
    /// Disarms without waiting for the service.
    pub switch: DisarmSwitch,
    /// Access control.
    pub door: Arc<Door>,
    /// Number of open event streams.
    pub streams: AtomicUsize,
}

/// The state passed to every handler.
pub(super) type Shared = Arc<Dashboard>;

/// A slot among the event streams, released on drop.
struct StreamSlot(Arc<Dashboard>);

impl StreamSlot {
    fn take(dashboard: &Arc<Dashboard>) -> Option<Self> {
        let more = |open| (open < MAX_STREAMS).then_some(open + 1);
        let taken = dashboard
            .streams
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, more);
        taken.ok().map(|_| Self(Arc::clone(dashboard)))
    }
}

impl Drop for StreamSlot {
    fn drop(&mut self) {
        self.0.streams.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Routes for pages, reading and operating.
pub fn router(dashboard: Shared) -> Router {
    let read = Router::new()
        .route("/api/state", get(state))
        .route("/api/events", get(events))
        .route("/api/history", get(history))
        .route("/api/map", get(error_map))
        .route("/api/model", get(model::state))
        .route("/api/model/candidate", get(model::candidate))
        .route("/metrics", get(prometheus))
        .layer(middleware::from_fn_with_state(
            Arc::clone(&dashboard.door),
            door::may_view,
        ));
    let operate = Router::new()
        .route("/api/arm", post(arm))
        .route("/api/disarm", post(disarm))
        .route("/api/acknowledge", post(acknowledge))
        .route("/api/reload", post(reload))
        .route(
            "/api/token",
            get(door::token).with_state(Arc::clone(&dashboard.door)),
        );
    let pages = PAGES
        .iter()
        .fold(Router::new(), |router, &(path, kind, text)| {
            router.route(path, get(async move || door::page(kind, text)))
        });
    read.merge(operate)
        .merge(pages)
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .merge(model::router())
        .layer(middleware::from_fn_with_state(
            Arc::clone(&dashboard.door),
            door::every_request,
        ))
        .with_state(dashboard)
}

async fn state(State(dashboard): State<Shared>) -> Response {
    Json(latest(&dashboard)).into_response()
}

/// The current state, with the token information of the dashboard.
fn latest(dashboard: &Dashboard) -> Status {
    let mut status = dashboard.published.latest();
    let mut holders = dashboard.door.tokens.holders();
    status.operable = holders.any(|holder| holder.role >= Role::Operate);
    status
}

async fn history(State(dashboard): State<Shared>) -> Response {
    Json(dashboard.published.history()).into_response()
}

async fn prometheus(State(dashboard): State<Shared>) -> Response {
    let text = metrics::text(&dashboard.published.latest(), &dashboard.quantities);
    let kind = "text/plain; version=0.0.4; charset=utf-8";
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

async fn error_map(State(dashboard): State<Shared>) -> Response {
    let published = &dashboard.published;
    Json(map::map(&published.model(), &published.latest())).into_response()
}

/// Streams the state.
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
        // Keeps the slot for the lifetime of the stream.
        let _ = &slot;
        let state = latest(&dashboard);
        let event = Event::default().event("state").json_data(state).ok()?;
        Some(Ok::<_, Infallible>(event))
    });
    Sse::new(stream)
        .keep_alive(KeepAlive::new().interval(Duration::from_secs(10)))
        .into_response()
}

async fn arm(dashboard: State<Shared>, operator: Operator, body: Bytes) -> Response {
    operate(dashboard, operator, &body, Ask::Arm).await
}

async fn disarm(
    State(dashboard): State<Shared>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
) -> Response {
    match dashboard.door.who_disarms(from.ip(), &headers) {
        Ok(who) => request(&dashboard, who, Ask::Disarm).await,
        Err(denied) => denied.into_response(),
    }
}

async fn acknowledge(dashboard: State<Shared>, operator: Operator, body: Bytes) -> Response {
    operate(dashboard, operator, &body, |_| Ask::Acknowledge).await
}

async fn reload(dashboard: State<Shared>, operator: Operator, body: Bytes) -> Response {
    operate(dashboard, operator, &body, Ask::Reload).await
}

/// Forwards a request of an operator to the service; the body may confirm a model.
async fn operate(
    State(dashboard): State<Shared>,
    Operator(who): Operator,
    body: &Bytes,
    ask: impl FnOnce(Option<String>) -> Ask,
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
    request(&dashboard, who, ask(confirm)).await
}

/// Sends a request to the service and waits for the response.
async fn request(dashboard: &Dashboard, who: String, ask: Ask) -> Response {
    let (answer, wait) = oneshot::channel();
    // Creating the request already orders the disarm, even if the queue is full.
    let asked = Asked::new(ask, who, Some(answer), &dashboard.switch);
    match dashboard.asks.try_send(asked) {
        Ok(()) => {}
        Err(TrySendError::Full(_)) => {
            return refuse(StatusCode::SERVICE_UNAVAILABLE, "too many requests wait");
        }
        Err(TrySendError::Disconnected(_)) => {
            return refuse(StatusCode::SERVICE_UNAVAILABLE, "the gateway is stopping");
        }
    }
    match wait.await {
        Ok(reply) => door::answer(reply),
        Err(_) => refuse(StatusCode::SERVICE_UNAVAILABLE, "the gateway is stopping"),
    }
}
