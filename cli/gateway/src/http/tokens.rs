//! Named tokens and their roles: viewing, operating, changing models.

use std::{
    collections::HashMap,
    net::IpAddr,
    path::{Path, PathBuf},
    sync::Mutex,
    time::Duration,
};

use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;
use volcomp_port::Clock;

use crate::{
    documents::TokenPlan,
    error::{GatewayError, TokenError},
    locked,
};

/// Number of wrong tokens from one address within [`WRONG_IN`] after which further wrong ones are blocked.
const WRONG: u32 = 5;
/// Period over which wrong tokens are counted and an address stays blocked.
const WRONG_IN: Duration = Duration::from_secs(60);
/// Maximum number of addresses whose wrong tokens are counted.
const ADDRESSES: usize = 1024;

/// Role of a token: the set of requests it allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Read state, history, map and metrics.
    View,
    /// Also arm, disarm, acknowledge and reload.
    Operate,
    /// Also upload files and activate models.
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

/// The holder of a token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Name recorded in the audit log.
    pub name: String,
    /// Determines which requests the token allows.
    pub role: Role,
}

/// The tokens of a file, stored as hashes.
#[derive(Debug)]
pub struct Tokens {
    holders: Vec<(Holder, [u8; 32])>,
    /// Number of wrong tokens by address, and the time of the first one.
    wrong: Mutex<HashMap<IpAddr, (u32, Duration)>>,
    /// Clock for blocking an address.
    clock: Clock,
}

impl Default for Tokens {
    fn default() -> Self {
        Self {
            holders: Vec::new(),
            wrong: Mutex::default(),
            clock: Clock::system(),
        }
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
            holders.push((
                Holder {
                    name: name.to_owned(),
                    role,
                },
                hash(token),
            ));
        }
        Ok(Self {
            holders,
            ..Self::default()
        })
    }

    /// Replaces the clock.
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

    /// Whether there are no tokens.
    pub fn is_empty(&self) -> bool {
        self.holders.is_empty()
    }

    /// Checks whether a token allows `needed`. All tokens are compared, in constant time.
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
