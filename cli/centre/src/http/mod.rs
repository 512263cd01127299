//! The web interface and its HTTP API: the routes with the role that each requires, and the checks common to all
//! requests.
//!
//! All data are read from and written to the store; the running centre acts on the stored state.

use std::{sync::Arc, time::Duration};

use axum::{
    Router,
    extract::{DefaultBodyLimit, Request, State},
    http::header,
    middleware::{Next, from_fn_with_state},
    response::{IntoResponse, Response},
    routing::{MethodRouter, get, post},
};
use volcomp_web::{headers, hosts};

use crate::users::Role;
use state::ApiError;

mod machines;
mod rollouts;
mod state;
mod users;

pub use state::{PageSettings, PageState};

/// Maximum size of a request body, bytes.
const MAX_BODY: usize = 2 * 1024 * 1024;
const REQUEST_TIMEOUT: Duration = Duration::from_secs(60);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Route {
    /// `GET` or `POST`.
    pub method: &'static str,
    /// The path, with names in braces.
    pub path: &'static str,
    /// Lowest role that may use the route; `None`: no login is required.
    pub need: Option<Role>,
}

type Handler = fn() -> MethodRouter<Arc<PageState>>;

macro_rules! routes {
    ($($method:literal $path:literal $need:expr => $handler:expr;)*) => {
        /// Every route of the API; the files of the web interface are separate.
        pub const ROUTES: &[Route] = &[$(Route { method: $method, path: $path, need: $need }),*];
        const HANDLERS: &[Handler] = &[$(|| $handler),*];
    };
}

const ALL: Option<Role> = None;
const VIEWER: Option<Role> = Some(Role::Viewer);
const ENGINEER: Option<Role> = Some(Role::Engineer);
const ADMIN: Option<Role> = Some(Role::Admin);

routes! {
    "POST" "/api/login" ALL => post(users::login);
    "GET" "/api/me" VIEWER => get(users::me);
    "POST" "/api/logout" VIEWER => post(users::logout);
    "POST" "/api/password" VIEWER => post(users::password);
    "GET" "/api/overview" VIEWER => get(machines::overview);
    "GET" "/api/machines/{machine}" VIEWER => get(machines::machine);
    "GET" "/api/machines/{machine}/history" VIEWER => get(machines::history);
    "GET" "/api/models" VIEWER => get(rollouts::models);
    "GET" "/api/models/{model}" VIEWER => get(rollouts::model);
    "GET" "/api/models/{model}/map" VIEWER => get(rollouts::map);
    "GET" "/api/models/{model}/file" VIEWER => get(rollouts::file);
    "GET" "/api/models/{model}/tables" VIEWER => get(rollouts::tables);
    "GET" "/api/models/{model}/tables/{file}" VIEWER => get(rollouts::table);
    "GET" "/api/formats" VIEWER => get(rollouts::formats);
    "GET" "/api/rollouts" VIEWER => get(rollouts::rollouts);
    "GET" "/api/rules" VIEWER => get(rollouts::rules);
    "GET" "/api/alarms" VIEWER => get(machines::alarms);
    "POST" "/api/machines" ENGINEER => post(machines::put_machine);
    "POST" "/api/machines/{machine}/remove" ENGINEER => post(machines::remove_machine);
    "POST" "/api/models" ENGINEER => post(rollouts::add);
    "POST" "/api/rollouts" ENGINEER => post(rollouts::start_rollout);
    "POST" "/api/rollouts/{rollout}" ENGINEER => post(rollouts::request);
    "POST" "/api/rollouts/{rollout}/keep" ENGINEER => post(rollouts::keep);
    "POST" "/api/machines/{machine}/back" ENGINEER => post(rollouts::back);
    "POST" "/api/alarms/{alarm}/seen" ENGINEER => post(machines::acknowledge_alarm);
    "GET" "/api/discovery" ENGINEER => get(machines::latest);
    "POST" "/api/discovery" ENGINEER => post(machines::search);
    "GET" "/api/audit" ADMIN => get(machines::audit);
    "GET" "/api/users" ADMIN => get(users::users);
    "POST" "/api/users" ADMIN => post(users::add_user);
    "POST" "/api/users/{user}" ADMIN => post(users::change_user);
    "POST" "/api/users/{user}/remove" ADMIN => post(users::remove_user);
}

/// Files of the web interface: path, content type and content.
const PAGES: [(&str, &str, &str); 11] = [
    ("/", HTML, include_str!("../../web/index.html")),
    ("/style.css", CSS, include_str!("../../web/style.css")),
    ("/plot.js", JAVASCRIPT, volcomp_web::PLOT_JS),
    ("/common.js", JAVASCRIPT, include_str!("../../web/common.js")),
    ("/shop.js", JAVASCRIPT, include_str!("../../web/shop.js")),
    ("/machine.js", JAVASCRIPT, include_str!("../../web/machine.js")),
    ("/models.js", JAVASCRIPT, include_str!("../../web/models.js")),
    ("/rollouts.js", JAVASCRIPT, include_str!("../../web/rollouts.js")),
    ("/office.js", JAVASCRIPT, include_str!("../../web/office.js")),
    ("/app.js", JAVASCRIPT, include_str!("../../web/app.js")),
    ("/icon.svg", "image/svg+xml", include_str!("../../web/icon.svg")),
];
const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

pub fn router(page: &Arc<PageState>) -> Router {
    let mut router = Router::new();
    for (route, handler) in ROUTES.iter().zip(HANDLERS) {
        let state = (Arc::clone(page), route.need);
        let handler = handler().route_layer(from_fn_with_state(state, users::admit));
        router = router.route(route.path, handler);
    }
    for &(path, kind, text) in &PAGES {
        router = router.route(path, get(move || file(kind, text)));
    }
    router
        .fallback(nothing)
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(from_fn_with_state(Arc::clone(page), every_request))
        .with_state(Arc::clone(page))
}

#[expect(clippy::unused_async, reason = "handlers are asynchronous")]
async fn file(kind: &'static str, text: &'static str) -> Response {
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

async fn nothing() -> ApiError {
    ApiError::missing("there is no such page")
}

async fn every_request(
    State(page): State<Arc<PageState>>,
    request: Request,
    next: Next,
) -> Response {
    let unknown = "this host name is not configured: add it to `hosts` of [page]";
    let known = &page.settings.hosts;
    let passed = hosts::pass(request, next, known, unknown, REQUEST_TIMEOUT).await;
    let mut response =
        passed.unwrap_or_else(|(status, why)| ApiError::new(status, why).into_response());
    headers::put(response.headers_mut());
    response
}
