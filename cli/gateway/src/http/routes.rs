//! The routes of the dashboard and their answers.

use std::{
    convert::Infallible,
    net::{IpAddr, SocketAddr},
    sync::{Arc, mpsc::TrySendError},
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

use super::{
    door::{self, bearer, refuse},
    map, model,
    shared::{Dashboard, MAX_STREAMS, StreamSlot},
    tokens::Role,
};

use crate::{
    documents::{Confirmation, Status},
    metrics,
    request::{Ask, Asked},
};

/// The largest body of a request, bytes.
const MAX_BODY: usize = 64 * 1024;
/// The time between two events of a stream.
const EVENT_EVERY: Duration = Duration::from_millis(100);

pub(super) type Shared = Arc<Dashboard>;

/// The files of the page: path, type and content.
const PAGES: [(&str, &str, &str); 9] = [
    (
        "/",
        "text/html; charset=utf-8",
        include_str!("../../web/index.html"),
    ),
    (
        "/app.js",
        "text/javascript; charset=utf-8",
        include_str!("../../web/app.js"),
    ),
    (
        "/plot.js",
        "text/javascript; charset=utf-8",
        volcomp_web::PLOT_JS,
    ),
    (
        "/style.css",
        "text/css; charset=utf-8",
        include_str!("../../web/style.css"),
    ),
    (
        "/model",
        "text/html; charset=utf-8",
        include_str!("../../web/model.html"),
    ),
    (
        "/model.js",
        "text/javascript; charset=utf-8",
        include_str!("../../web/model.js"),
    ),
    (
        "/curves.js",
        "text/javascript; charset=utf-8",
        include_str!("../../web/curves.js"),
    ),
    (
        "/model.css",
        "text/css; charset=utf-8",
        include_str!("../../web/model.css"),
    ),
    (
        "/icon.svg",
        "image/svg+xml",
        include_str!("../../web/icon.svg"),
    ),
];

/// The routes of pages, reading and operating.
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

/// The state of now, with what the dashboard knows of its tokens.
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

/// The state, again and again.
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
        // Held as long as the stream lives.
        let _ = &slot;
        let state = latest(&dashboard);
        let event = Event::default().event("state").json_data(state).ok()?;
        Some(Ok::<_, Infallible>(event))
    });
    Sse::new(stream)
        .keep_alive(KeepAlive::new().interval(Duration::from_secs(10)))
        .into_response()
}

async fn arm(
    dashboard: State<Shared>,
    from: Extension<SocketAddr>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    operate(dashboard, from.0.ip(), &headers, &body, Ask::Arm).await
}

async fn disarm(
    dashboard: State<Shared>,
    from: Extension<SocketAddr>,
    headers: HeaderMap,
) -> Response {
    match dashboard.door.who_disarms(from.0.ip(), &headers) {
        Ok(who) => request(&dashboard, who, Ask::Disarm).await,
        Err(denied) => denied.into_response(),
    }
}

async fn acknowledge(
    dashboard: State<Shared>,
    from: Extension<SocketAddr>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    operate(dashboard, from.0.ip(), &headers, &body, |_| {
        Ask::Acknowledge
    })
    .await
}

async fn reload(
    dashboard: State<Shared>,
    from: Extension<SocketAddr>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    operate(dashboard, from.0.ip(), &headers, &body, Ask::Reload).await
}

/// Whoever may operate asks the service; the body may confirm a model.
async fn operate(
    State(dashboard): State<Shared>,
    from: IpAddr,
    headers: &HeaderMap,
    body: &Bytes,
    ask: impl FnOnce(Option<String>) -> Ask,
) -> Response {
    let tokens = &dashboard.door.tokens;
    let holder = match tokens.check(from, bearer(headers), Role::Operate) {
        Ok(holder) => holder,
        Err(denied) => return denied.into_response(),
    };
    let confirm = if body.is_empty() {
        None
    } else {
        match serde_json::from_slice::<Confirmation>(body) {
            Ok(confirmation) => confirmation.confirm,
            Err(_) => {
                return refuse(
                    StatusCode::BAD_REQUEST,
                    "expected no body, or {\"confirm\": HASH}",
                );
            }
        }
    };
    request(&dashboard, holder.name, ask(confirm)).await
}

/// Asks the service, and waits for what it answers.
async fn request(dashboard: &Dashboard, who: String, ask: Ask) -> Response {
    let (answer, wait) = oneshot::channel();
    // Disarming is ordered here and now, whatever becomes of the request.
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
        Ok(reply) => {
            let status =
                StatusCode::from_u16(reply.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
            (status, Json(reply.answer)).into_response()
        }
        Err(_) => refuse(StatusCode::SERVICE_UNAVAILABLE, "the gateway is stopping"),
    }
}
