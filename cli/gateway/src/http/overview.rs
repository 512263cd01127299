//! The overview of several machines: a page, and what it shows. Nothing can be operated from here; each machine has a dashboard
//! and tokens of its own.

use std::sync::Arc;

use axum::{
    Json, Router,
    extract::State,
    http::StatusCode,
    middleware,
    response::{IntoResponse, Response},
    routing::get,
};
use tokio::net::TcpListener;

use volcomp_web::Tls;

use super::door::{self, Door, refuse};
use crate::glance::{Places, overview};

/// The files of the page: path, type and content.
const PAGES: [(&str, &str, &str); 5] = [
    (
        "/",
        "text/html; charset=utf-8",
        include_str!("../../web/overview.html"),
    ),
    (
        "/overview.js",
        "text/javascript; charset=utf-8",
        include_str!("../../web/overview.js"),
    ),
    (
        "/style.css",
        "text/css; charset=utf-8",
        include_str!("../../web/style.css"),
    ),
    (
        "/overview.css",
        "text/css; charset=utf-8",
        include_str!("../../web/overview.css"),
    ),
    (
        "/icon.svg",
        "image/svg+xml",
        include_str!("../../web/icon.svg"),
    ),
];

/// What the routes of the overview share.
pub struct Overviewed {
    /// The machines.
    pub places: Places,
    /// Who is let in.
    pub door: Arc<Door>,
}

/// Serves the overview until the runtime ends.
pub async fn serve_overview(listener: TcpListener, tls: Option<Tls>, overviewed: Arc<Overviewed>) {
    volcomp_web::serve(listener, tls, router(overviewed)).await;
}

fn router(overviewed: Arc<Overviewed>) -> Router {
    let door = Arc::clone(&overviewed.door);
    let read =
        Router::new()
            .route("/api/machines", get(machines))
            .layer(middleware::from_fn_with_state(
                Arc::clone(&door),
                door::may_view,
            ));
    let others = Router::new()
        .route("/api/token", get(door::token).with_state(Arc::clone(&door)))
        .route("/api/state", get(no_state));
    let pages = PAGES
        .iter()
        .fold(Router::new(), |router, &(path, kind, text)| {
            router.route(path, get(async move || door::page(kind, text)))
        });
    read.merge(others)
        .merge(pages)
        .layer(middleware::from_fn_with_state(door, door::every_request))
        .with_state(overviewed)
}

async fn machines(State(overviewed): State<Arc<Overviewed>>) -> Response {
    Json(overview(&overviewed.places)).into_response()
}

/// For whoever takes it for the dashboard of a machine.
async fn no_state() -> Response {
    refuse(
        StatusCode::NOT_FOUND,
        "several machines: all of them are told by /api/machines, each by the dashboard of its own",
    )
}
