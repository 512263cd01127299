use std::{
    collections::HashMap,
    net::{IpAddr, SocketAddr},
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    time::Duration,
};

use axum::{
    Extension, Json,
    extract::{Request, State},
    http::{HeaderMap, StatusCode, header},
    middleware::Next,
    response::{IntoResponse, Response},
};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;
use volcomp_port::Clock;
use volcomp_web::{headers, hosts, is_of_another_page};

use crate::{
    config::DashboardConfig,
    documents::{Refusal, TokenPlan},
    error::{GatewayError, TokenError},
    locked,
    request::Reply,
};

/// Timeout of a request, including the response time of the service.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// Path for uploads of machine files, which may be slow.
pub(super) const UPLOAD_PATH: &str = "/api/model/upload";
const UPLOAD_TIMEOUT: Duration = Duration::from_secs(300);

/// Who may read and operate the dashboard, and under which host names.
pub struct AccessControl {
    /// Tokens and their roles.
    pub tokens: Tokens,
    /// Host names, in addition to addresses, under which browsers may reach the dashboard.
    pub hosts: Vec<String>,
    /// True if reading requires a token, because other computers can reach the dashboard.
    pub reading_needs_token: bool,
    /// True if the machine is the built-in simulation. If no tokens are configured, the token `demo` may then operate
    /// it from this computer.
    pub is_demo: bool,
}

/// The token of the built-in simulation. It is no secret, because a simulation moves no machine.
const DEMO_TOKEN: &str = "demo";

impl AccessControl {
    pub fn new(config: &DashboardConfig, tokens: Tokens) -> Self {
        Self {
            tokens,
            hosts: config.hosts.clone(),
            reading_needs_token: config.reading_needs_token(),
            is_demo: false,
        }
    }

    /// Checks whether a token has at least the role `needed`.
    ///
    /// # Errors
    /// Why access is denied.
    pub(super) fn check(
        &self,
        from: IpAddr,
        token: Option<&str>,
        needed: Role,
    ) -> Result<Holder, Denied> {
        let is_demo = self.operates_as_demo()
            && from.to_canonical().is_loopback()
            && token == Some(DEMO_TOKEN)
            && needed <= Role::Operate;
        if is_demo {
            return Ok(Holder { name: DEMO_TOKEN.to_owned(), role: Role::Operate });
        }
        self.tokens.check(from, token, needed)
    }

    fn operates_as_demo(&self) -> bool {
        self.is_demo && self.tokens.is_empty()
    }

    /// The token that the page of the built-in simulation receives; `None` on a configured machine, or if tokens are configured.
    pub(super) fn demo_token(&self) -> Option<&'static str> {
        self.operates_as_demo().then_some(DEMO_TOKEN)
    }

    /// True if a token exists that permits operating.
    pub(super) fn is_operable(&self) -> bool {
        let mut holders = self.tokens.holders();
        self.operates_as_demo() || holders.any(|holder| holder.role >= Role::Operate)
    }

    /// Authorizes a disarm request and returns its origin for the audit log. Without a token, requests from this
    /// computer are accepted unless a page of another origin sent them.
    pub(super) fn authorize_disarm(
        &self,
        from: IpAddr,
        headers: &HeaderMap,
    ) -> Result<String, Denied> {
        if from.to_canonical().is_loopback() && !headers.contains_key(header::AUTHORIZATION) {
            if is_of_another_page(headers) {
                return Err(Denied::AnotherPage);
            }
            return Ok("local user without a token".to_owned());
        }
        let holder = self.check(from, bearer(headers), Role::Operate)?;
        Ok(holder.name)
    }
}

/// Middleware for every request: checks the host, applies the timeout, sets the response headers.
pub(super) async fn check_request(
    State(access): State<Arc<AccessControl>>,
    request: Request,
    next: Next,
) -> Response {
    let timeout =
        if request.uri().path() == UPLOAD_PATH { UPLOAD_TIMEOUT } else { REQUEST_TIMEOUT };
    let unknown = "this name is not configured: add it to [dashboard] hosts";
    let passed = hosts::pass(request, next, &access.hosts, unknown, timeout).await;
    let mut response = passed.unwrap_or_else(|(status, why)| refuse(status, why));
    headers::put(response.headers_mut());
    response
}

/// Middleware: requires a token if reading requires one.
pub(super) async fn require_view(
    State(access): State<Arc<AccessControl>>,
    Extension(from): Extension<SocketAddr>,
    request: Request,
    next: Next,
) -> Response {
    if access.reading_needs_token
        && let Err(denied) = access.check(from.ip(), bearer(request.headers()), Role::View)
    {
        return denied.into_response();
    }
    next.run(request).await
}

/// Returns the name and role of the token. Clients call it to detect a wrong token before its first use.
pub(super) async fn token(
    State(access): State<Arc<AccessControl>>,
    Extension(from): Extension<SocketAddr>,
    headers: HeaderMap,
) -> Response {
    match access.check(from.ip(), bearer(&headers), Role::View) {
        Ok(holder) => Json(TokenPlan { name: holder.name, role: holder.role.name().to_owned() })
            .into_response(),
        Err(denied) => denied.into_response(),
    }
}

pub(super) fn answer(reply: Reply) -> Response {
    let status = StatusCode::from_u16(reply.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
    (status, Json(reply.answer)).into_response()
}

pub(super) fn bearer(headers: &HeaderMap) -> Option<&str> {
    let value = headers.get(header::AUTHORIZATION)?.to_str().ok()?;
    let (scheme, token) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
}

pub(super) fn refuse(status: StatusCode, why: &str) -> Response {
    (status, Json(Refusal::new(why))).into_response()
}

/// A file of the web interface that is compiled in.
pub(super) fn page(kind: &'static str, text: &'static str) -> Response {
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

impl IntoResponse for Denied {
    fn into_response(self) -> Response {
        match self {
            Self::NoneConfigured => refuse(StatusCode::NOT_FOUND, "no token is configured"),
            Self::Unknown => refuse(StatusCode::UNAUTHORIZED, "a valid token is needed"),
            Self::AnotherPage => {
                refuse(StatusCode::FORBIDDEN, "a page of another origin may not disarm")
            }
            Self::Role => refuse(StatusCode::FORBIDDEN, "this token does not allow it"),
            Self::TooMany => {
                refuse(StatusCode::TOO_MANY_REQUESTS, "too many wrong tokens: wait a minute")
            }
        }
    }
}

/// Number of wrong tokens from one address within [`WRONG_IN`] after which further wrong tokens are blocked.
const WRONG: u32 = 5;
/// Period over which wrong tokens are counted and an address stays blocked.
const WRONG_IN: Duration = Duration::from_secs(60);
const ADDRESSES: usize = 1024;

/// Role of a token: the set of requests it allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Role {
    /// Read state, history, map and metrics.
    View,
    /// In addition arm, disarm, acknowledge and reload.
    Operate,
    /// In addition upload files and activate models.
    Engineer,
}

impl Role {
    /// The role as written in the token file.
    pub fn name(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Operate => "operate",
            Self::Engineer => "engineer",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Name recorded in the audit log.
    pub name: String,
    /// Set of requests that the token allows.
    pub role: Role,
}

/// The tokens of a file, stored as hashes.
#[derive(Debug)]
pub struct Tokens {
    holders: Vec<(Holder, [u8; 32])>,
    /// Number of wrong tokens by address, and the time of the first one.
    wrong: Mutex<HashMap<IpAddr, (u32, Duration)>>,
    clock: Clock,
}

impl Default for Tokens {
    fn default() -> Self {
        Self { holders: Vec::new(), wrong: Mutex::default(), clock: Clock::system() }
    }
}

/// Why access is denied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Denied {
    /// No tokens are configured.
    NoneConfigured,
    /// The token is missing or unknown.
    Unknown,
    /// The role of the token does not allow this request.
    Role,
    /// Too many wrong tokens from this address.
    TooMany,
    /// The request has no token and comes from a page of another origin.
    AnotherPage,
}

impl Tokens {
    /// Loads the configured token file, else the service's credential `tokens`, else no tokens.
    ///
    /// # Errors
    /// The file is readable by other users, or has invalid lines.
    pub fn load(configured: Option<&Path>) -> Result<Self, GatewayError> {
        if let Some(path) = configured {
            return Self::read(path);
        }
        let folder = std::env::var_os("CREDENTIALS_DIRECTORY").map(PathBuf::from);
        match folder.map(|folder| folder.join("tokens")) {
            Some(path) if path.exists() => Self::read(&path),
            _ => Ok(Self::default()),
        }
    }

    fn read(path: &Path) -> Result<Self, GatewayError> {
        let text = volcomp_document::private::read(path)?;
        Self::parse(&text).map_err(|(line, source)| GatewayError::Token {
            file: path.to_owned(),
            line,
            source,
        })
    }

    /// Parses lines `NAME ROLE TOKEN`; `#` starts a comment.
    ///
    /// # Errors
    /// The line number and the error; never the token.
    pub fn parse(text: &str) -> Result<Self, (usize, TokenError)> {
        let mut holders: Vec<(Holder, [u8; 32])> = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            if line.is_empty() {
                continue;
            }
            let wrong = |error| (index + 1, error);
            let words: Vec<&str> = line.split_whitespace().collect();
            let [name, role, token] = words[..] else {
                return Err(wrong(TokenError::Words(words.len())));
            };
            let role = match role {
                "view" => Role::View,
                "operate" => Role::Operate,
                "engineer" => Role::Engineer,
                _ => return Err(wrong(TokenError::Role)),
            };
            if !is_long_enough(token) {
                return Err(wrong(TokenError::Short));
            }
            if holders.iter().any(|(holder, _)| holder.name == name) {
                return Err(wrong(TokenError::Twice));
            }
            holders.push((Holder { name: name.to_owned(), role }, hash(token)));
        }
        Ok(Self { holders, ..Self::default() })
    }

    /// Sets the clock, for tests.
    #[must_use]
    pub fn with_clock(mut self, clock: Clock) -> Self {
        self.clock = clock;
        self
    }

    /// The holders in the order of the file.
    pub fn holders(&self) -> impl Iterator<Item = &Holder> {
        self.holders.iter().map(|(holder, _)| holder)
    }

    /// The tokens as shown in a plan.
    pub fn plan(&self) -> Vec<TokenPlan> {
        let plan = |holder: &Holder| TokenPlan {
            name: holder.name.clone(),
            role: holder.role.name().to_owned(),
        };
        self.holders().map(plan).collect()
    }

    pub fn is_empty(&self) -> bool {
        self.holders.is_empty()
    }

    /// Checks whether a token has at least the role `needed`. All tokens are compared, in constant time.
    ///
    /// # Errors
    /// Why access is denied.
    pub fn check(&self, from: IpAddr, token: Option<&str>, needed: Role) -> Result<Holder, Denied> {
        if self.holders.is_empty() {
            return Err(Denied::NoneConfigured);
        }
        let token = token.ok_or(Denied::Unknown)?;
        let given = hash(token);
        let mut found = None;
        for (holder, known) in &self.holders {
            if bool::from(known.ct_eq(&given)) {
                found = Some(holder);
            }
        }
        match found {
            Some(holder) if holder.role >= needed => Ok(holder.clone()),
            Some(_) => Err(Denied::Role),
            // A valid token is never blocked: wrong tokens from the same address must not prevent an operator from
            // disarming.
            None if self.is_blocked(from) => Err(Denied::TooMany),
            None => {
                self.count_wrong(from);
                Err(Denied::Unknown)
            }
        }
    }

    fn is_blocked(&self, from: IpAddr) -> bool {
        let wrong = locked(&self.wrong);
        let now = self.clock.elapsed();
        wrong
            .get(&from)
            .is_some_and(|(count, since)| *count >= WRONG && now.saturating_sub(*since) < WRONG_IN)
    }

    fn count_wrong(&self, from: IpAddr) {
        let mut wrong = locked(&self.wrong);
        let now = self.clock.elapsed();
        if wrong.len() >= ADDRESSES {
            wrong.retain(|_, (_, since)| now.saturating_sub(*since) < WRONG_IN);
        }
        if wrong.len() >= ADDRESSES && !wrong.contains_key(&from) {
            return;
        }
        let (count, since) = wrong.entry(from).or_insert((0, now));
        if now.saturating_sub(*since) >= WRONG_IN {
            (*count, *since) = (0, now);
        }
        *count += 1;
    }
}

fn is_long_enough(token: &str) -> bool {
    let hexadecimal = token.bytes().all(|byte| byte.is_ascii_hexdigit());
    token.len() >= if hexadecimal { 32 } else { 22 }
}

fn hash(token: &str) -> [u8; 32] {
    Sha256::digest(token.as_bytes()).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_simulation_can_be_operated_from_its_own_computer_without_a_token_file() {
        let access = |is_demo, tokens: &str| AccessControl {
            is_demo,
            ..AccessControl::new(
                &DashboardConfig::default(),
                Tokens::parse(tokens).expect("tokens"),
            )
        };
        let check = |access: &AccessControl, from: [u8; 4], token, needed| {
            let checked = access.check(IpAddr::from(from), token, needed);
            checked.map(|holder| holder.name)
        };
        let (here, there) = ([127, 0, 0, 1], [192, 0, 2, 7]);
        let (given, none) = (Some(DEMO_TOKEN), Err(Denied::NoneConfigured));
        let demo = access(true, "");
        assert!(demo.is_operable());
        assert_eq!(check(&demo, here, given, Role::Operate), Ok(DEMO_TOKEN.to_owned()));
        assert_eq!(check(&demo, there, given, Role::Operate), none);
        assert_eq!(check(&demo, here, None, Role::Operate), none);
        assert_eq!(check(&demo, here, Some("other"), Role::Operate), none);
        assert_eq!(check(&demo, here, given, Role::Engineer), none);
        // The demo token is not valid on a configured machine, nor if tokens are configured.
        let configured = access(false, "");
        assert!(!configured.is_operable() && configured.demo_token().is_none());
        assert_eq!(check(&configured, here, given, Role::Operate), none);
        let own = access(true, "anna operate 0123456789abcdef0123456789abcdef");
        assert_eq!(own.demo_token(), None);
        assert_eq!(check(&own, here, given, Role::Operate), Err(Denied::Unknown));
    }
}
