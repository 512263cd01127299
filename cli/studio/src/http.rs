//! The web page and its HTTP API, on this computer only.
//!
//! Every path begins with a random token that only the printed address contains, so pages of other sites cannot know
//! it. Requests with a foreign Host or Origin are rejected as well. Requests run one after the other, so that two
//! windows cannot write at the same time.

use std::{
    net::{SocketAddr, TcpListener},
    sync::{Arc, Mutex, PoisonError},
};

use axum::{
    Json, Router,
    body::Bytes,
    extract::{DefaultBodyLimit, Query, Request, State as Shared},
    http::{HeaderValue, Method, StatusCode, header},
    middleware::{Next, from_fn},
    response::{IntoResponse, Response},
    routing::{get, post},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::json;
use volcomp_web::{headers, hosts, is_of_another_page};

use crate::{
    error::{Interrupt, StudioError},
    folder::{Folder, MACHINE, MAX_FILE_BYTES, REPORT, State, name_of_upload},
    outputs::TableRequest,
    questions::TypedAnswer,
    send::Target,
    undo::{Change, ChangeName},
};

const MAX_PROGRAM_BYTES: usize = 64 * 1024 * 1024;

/// Policy for the report, which contains its styles and its script. As a sandboxed document it cannot send requests to
/// the studio.
const REPORT_POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'; sandbox allow-scripts allow-modals";

/// The studio for a folder, ready to serve.
pub struct Studio {
    listener: TcpListener,
    address: SocketAddr,
    token: String,
    folder: Folder,
}

impl Studio {
    /// Listens at a loopback address. Port 0 selects a free port.
    ///
    /// # Errors
    /// The address is not a loopback address, or is in use.
    pub fn listen(folder: Folder, address: SocketAddr) -> Result<Self, StudioError> {
        if !address.ip().is_loopback() {
            return Err(StudioError::Request {
                key: "--listen",
                why: format!(
                    "found {address}, expected an address of this computer such as 127.0.0.1:0"
                ),
            });
        }
        let system = |source| StudioError::System { what: "the page's address", source };
        let listener = TcpListener::bind(address).map_err(system)?;
        listener.set_nonblocking(true).map_err(system)?;
        let address = listener.local_addr().map_err(system)?;
        let mut random = [0_u8; 16];
        getrandom::fill(&mut random).map_err(|e| StudioError::System {
            what: "random numbers",
            source: std::io::Error::other(e),
        })?;
        let token = format!("{:032x}", u128::from_be_bytes(random));
        Ok(Self { listener, address, token, folder })
    }

    /// The address at which the server listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// URL of the web page, with the token.
    pub fn url(&self) -> String {
        format!("http://{}/{}/", self.address, self.token)
    }

    /// Serves until the process ends.
    ///
    /// # Errors
    /// The operating system provides no thread.
    pub fn run(self) -> Result<(), StudioError> {
        let system = |source| StudioError::System { what: "a thread", source };
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .map_err(system)?;
        let router = router(&self.token, self.folder);
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(self.listener).map_err(system)?;
            volcomp_web::serve(listener, None, router).await;
            Ok(())
        })
    }
}

/// The session, and the interrupt of its requests. The interrupt is outside of the lock, which requests hold while they
/// run.
struct Served {
    session: Mutex<Session>,
    interrupt: Interrupt,
}

struct Session {
    folder: Folder,
    last_change: Option<Change>,
}

impl Session {
    /// Changes the folder, and records the change, so that it can be reverted even if it failed half-way.
    fn change<T>(
        &mut self,
        what: String,
        uploaded: Option<&FileName>,
        of: impl FnOnce(&Folder) -> Result<T, StudioError>,
    ) -> Result<T, StudioError> {
        let name = uploaded.and_then(|uploaded| name_of_upload(&uploaded.name).ok());
        let before = self.folder.snapshot(name.as_deref());
        let done = of(&self.folder);
        let batch = uploaded.and_then(|uploaded| uploaded.batch);
        if let Some(change) = self.folder.change_since(before, what, batch) {
            self.last_change = Some(change.after(self.last_change.take()));
        }
        done
    }

    fn revert(&mut self) -> Result<(), StudioError> {
        let Some(change) = &self.last_change else {
            let why =
                "found no change to revert: it was reverted already, or the studio was restarted";
            return Err(StudioError::Request { key: "undo", why: why.to_owned() });
        };
        self.folder.revert(change)?;
        self.last_change = None;
        Ok(())
    }

    fn state(&self) -> Result<PageState, StudioError> {
        let undo = self.last_change.as_ref().filter(|of| self.folder.output_of(of).is_none());
        let undo = undo.map(|change| change.name.clone());
        Ok(PageState { folder: self.folder.state()?, undo })
    }
}

#[derive(Serialize)]
struct PageState {
    #[serde(flatten)]
    folder: State,
    /// The change that `api/undo` reverts.
    undo: Option<ChangeName>,
}

type Page = Arc<Served>;

const PAGES: [(&str, &str, &str); 4] = [
    ("", "text/html; charset=utf-8", include_str!("../web/index.html")),
    ("studio.js", "text/javascript; charset=utf-8", include_str!("../web/studio.js")),
    ("studio.css", "text/css; charset=utf-8", include_str!("../web/studio.css")),
    ("icon.svg", "image/svg+xml", include_str!("../web/icon.svg")),
];

fn router(token: &str, folder: Folder) -> Router {
    let at = |path: &str| format!("/{token}/{path}");
    let mut router = Router::new();
    for (path, kind, text) in PAGES {
        let file = move || async move { ([(header::CONTENT_TYPE, kind)], text) };
        router = router.route(&at(path), get(file));
    }
    router
        .route(&at("report.html"), get(report))
        .route(&at("file"), get(file))
        .route(&at("api/state"), get(state))
        .route(&at("api/upload"), post(upload))
        .route(&at("api/machine"), post(machine))
        .route(&at("api/answers"), post(answers))
        .route(&at("api/fit"), post(fit))
        .route(&at("api/tables"), post(tables))
        .route(&at("api/send"), post(send))
        .route(&at("api/cancel"), post(cancel))
        .route(&at("api/undo"), post(undo))
        .route(&at("api/drift"), post(drift))
        // The limit is one byte more than the maximum, so that the handler can reject a file that is too large by its
        // name.
        .layer(DefaultBodyLimit::max(MAX_FILE_BYTES + 1))
        .route(&at("api/nc"), post(nc).layer(DefaultBodyLimit::max(MAX_PROGRAM_BYTES)))
        .fallback(|| async {
            let why = "there is no such page: open the address that `volcomp studio` prints";
            refuse(StatusCode::NOT_FOUND, why)
        })
        .layer(from_fn(every_request))
        .with_state(Arc::new(Served {
            interrupt: folder.interrupt.clone(),
            session: Mutex::new(Session { folder, last_change: None }),
        }))
}

async fn every_request(request: Request, next: Next) -> Response {
    let is_report = request.uri().path().ends_with("/report.html");
    let host = request.headers().get(header::HOST);
    let is_ours =
        host.and_then(|host| host.to_str().ok()).is_some_and(|host| hosts::is_known(host, &[]));
    let changes = request.method() != Method::GET;
    let mut response = if !is_ours {
        let why = "expected the address of this computer as Host";
        refuse(StatusCode::MISDIRECTED_REQUEST, why)
    } else if changes && is_of_another_page(request.headers()) {
        refuse(StatusCode::FORBIDDEN, "a page of another origin may not change anything")
    } else {
        next.run(request).await
    };
    headers::put(response.headers_mut());
    if is_report && response.status() == StatusCode::OK {
        let of = response.headers_mut();
        let policy = HeaderValue::from_static(REPORT_POLICY);
        of.insert(header::CONTENT_SECURITY_POLICY, policy);
        of.insert(header::X_FRAME_OPTIONS, HeaderValue::from_static("SAMEORIGIN"));
    }
    response
}

fn refuse(status: StatusCode, why: &str) -> Response {
    (status, Json(json!({ "error": why }))).into_response()
}

/// Runs work on the folder on a blocking thread, because a fit takes seconds.
async fn work<T: Send + 'static>(
    page: Page,
    work: impl FnOnce(&mut Session) -> Result<T, StudioError> + Send + 'static,
) -> Result<T, Response> {
    // Take the interrupt before waiting for the lock, so that a waiting request can be cancelled as well.
    let interrupt = page.interrupt.of_request();
    let done = tokio::task::spawn_blocking(move || {
        let mut session = page.session.lock().unwrap_or_else(PoisonError::into_inner);
        session.folder.interrupt = interrupt;
        work(&mut session).map_err(|error| (error.status(), session.folder.relative(&error)))
    });
    match done.await {
        Ok(Ok(done)) => Ok(done),
        Ok(Err((status, why))) => {
            let status = StatusCode::from_u16(status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
            Err(refuse(status, &why))
        }
        Err(_) => {
            Err(refuse(StatusCode::INTERNAL_SERVER_ERROR, "internal error: see standard error"))
        }
    }
}

async fn respond<T: Serialize + Send + 'static>(
    page: Page,
    of: impl FnOnce(&mut Session) -> Result<T, StudioError> + Send + 'static,
) -> Response {
    match work(page, of).await {
        Ok(document) => Json(document).into_response(),
        Err(refusal) => refusal,
    }
}

async fn respond_to<R: DeserializeOwned + Send + 'static, T: Serialize + Send + 'static>(
    page: Page,
    body: &Bytes,
    of: impl FnOnce(&mut Session, R) -> Result<T, StudioError> + Send + 'static,
) -> Response {
    match serde_json::from_slice(body) {
        Ok(request) => respond(page, move |session| of(session, request)).await,
        Err(e) => refuse(StatusCode::BAD_REQUEST, &format!("the request: {e}")),
    }
}

/// Cancels the running requests. A cancelled request responds when it has stopped or is finished.
async fn cancel(Shared(page): Shared<Page>) -> Response {
    page.interrupt.cancel();
    Json(json!({})).into_response()
}

async fn state(Shared(page): Shared<Page>) -> Response {
    respond(page, |session| session.state()).await
}

async fn report(Shared(page): Shared<Page>) -> Response {
    match work(page, |session| session.folder.result(REPORT)).await {
        Ok(bytes) => ([(header::CONTENT_TYPE, "text/html; charset=utf-8")], bytes).into_response(),
        Err(refusal) => refusal,
    }
}

#[derive(Deserialize)]
struct FileName {
    name: String,
    /// Number of the drop to which the file belongs; files dropped together have the same number.
    batch: Option<u64>,
}

/// Download of a file below `result/`.
async fn file(
    Shared(page): Shared<Page>,
    Query(FileName { name, .. }): Query<FileName>,
) -> Response {
    let base = name.rsplit('/').next().unwrap_or_default();
    let base: String = base.chars().filter(char::is_ascii).collect();
    let saved = format!("attachment; filename=\"{}\"", base.replace(['"', '\\'], "_"));
    match work(page, move |session| session.folder.result(&name)).await {
        Ok(bytes) => {
            let kind = "application/octet-stream".to_owned();
            let of = [(header::CONTENT_TYPE, kind), (header::CONTENT_DISPOSITION, saved)];
            (of, bytes).into_response()
        }
        Err(refusal) => refusal,
    }
}

async fn upload(Shared(page): Shared<Page>, Query(file): Query<FileName>, body: Bytes) -> Response {
    respond(page, move |session| {
        let what = format!("file {}", file.name);
        session.change(what, Some(&file), |folder| folder.receive(&file.name, &body))?;
        session.state()
    })
    .await
}

#[derive(Deserialize)]
struct MachineText {
    text: String,
}

async fn machine(Shared(page): Shared<Page>, body: Bytes) -> Response {
    respond_to(page, &body, |session, MachineText { text }| {
        let what = "machine file".to_owned();
        session.change(what, None, |folder| folder.set_machine(MACHINE, &text))?;
        session.state()
    })
    .await
}

async fn answers(Shared(page): Shared<Page>, body: Bytes) -> Response {
    respond_to(page, &body, |session, given: Vec<TypedAnswer>| {
        session.change("answers".to_owned(), None, |folder| folder.answer(&given))?;
        session.state()
    })
    .await
}

async fn undo(Shared(page): Shared<Page>) -> Response {
    respond(page, |session| {
        session.revert()?;
        session.state()
    })
    .await
}

#[derive(Deserialize)]
struct ModelName {
    model: String,
}

async fn drift(Shared(page): Shared<Page>, body: Bytes) -> Response {
    respond_to(page, &body, |session, ModelName { model }| session.folder.drift(&model)).await
}

#[derive(Deserialize)]
struct FitRequest {
    tolerance: String,
    earlier: Option<String>,
}

async fn fit(Shared(page): Shared<Page>, body: Bytes) -> Response {
    respond_to(page, &body, |session, of: FitRequest| {
        let fit = |folder: &Folder| folder.fit(&of.tolerance, of.earlier.as_deref());
        session.change("fit".to_owned(), None, fit)
    })
    .await
}

async fn tables(Shared(page): Shared<Page>, body: Bytes) -> Response {
    respond_to(page, &body, |session, of: TableRequest| session.folder.tables(&of)).await
}

#[derive(Deserialize)]
struct Program {
    name: String,
    tolerance_um: f64,
}

async fn nc(Shared(page): Shared<Page>, Query(of): Query<Program>, body: Bytes) -> Response {
    respond(page, move |session| session.folder.nc(&of.name, &body, of.tolerance_um)).await
}

async fn send(Shared(page): Shared<Page>, body: Bytes) -> Response {
    respond_to(page, &body, |session, target: Target| session.folder.send(&target)).await
}
