//! Named tokens: who may look, who may operate, and who may bring a new model.

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

/// After so many wrong tokens from one address within [`WRONG_IN`] no further wrong one is looked at.
const WRONG: u32 = 5;
/// How long wrong tokens are counted and an address stays blocked.
const WRONG_IN: Duration = Duration::from_secs(60);
/// The largest number of addresses whose wrong tokens are counted.
const ADDRESSES: usize = 1024;

/// The role of a token: the requests that it allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Reading state, history, map and metrics.
    View,
    /// Reading, arming, disarming, acknowledging and reloading.
    Operate,
    /// All that, and uploading files and putting models in force.
    Engineer,
}

impl Role {
    /// The role as it stands in the token file.
    pub fn name(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Operate => "operate",
            Self::Engineer => "engineer",
        }
    }
}

/// Whose a token is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// The name that stands in the audit log.
    pub name: String,
    /// The role, which says which requests the token allows.
    pub role: Role,
}

/// The tokens of a file: only their hashes are kept.
#[derive(Debug)]
pub struct Tokens {
    holders: Vec<(Holder, [u8; 32])>,
    /// The number of wrong tokens by address, and the time of the first of them.
    wrong: Mutex<HashMap<IpAddr, (u32, Duration)>>,
    /// The clock by which an address stays blocked.
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

/// Why somebody is not let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Denied {
    /// No token is configured at all.
    NoneConfigured,
    /// No token was given, or a wrong one.
    Unknown,
    /// The token does not allow this.
    Role,
    /// Too many wrong tokens came from this address.
    TooMany,
    /// No token was given, and a browser asks for a page of another origin.
    AnotherPage,
}

impl Tokens {
    /// The token file of the configuration, else the service's credential `tokens`, else none.
    ///
    /// # Errors
    /// A file that others may read, or with wrong lines.
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

    /// Takes lines `NAME ROLE TOKEN`; `#` begins a comment.
    ///
    /// # Errors
    /// The line and what is wrong with it; never the token.
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

    /// The same tokens by another clock.
    #[must_use]
    pub fn with_clock(mut self, clock: Clock) -> Self {
        self.clock = clock;
        self
    }

    /// Whose the tokens are, in the order of the file.
    pub fn holders(&self) -> impl Iterator<Item = &Holder> {
        self.holders.iter().map(|(holder, _)| holder)
    }

    /// The tokens as a plan shows them.
    pub fn plan(&self) -> Vec<TokenPlan> {
        let plan = |holder: &Holder| TokenPlan {
            name: holder.name.clone(),
            role: holder.role.name().to_owned(),
        };
        self.holders().map(plan).collect()
    }

    /// Whether there is no token.
    pub fn is_empty(&self) -> bool {
        self.holders.is_empty()
    }

    /// Lets a request in: whoever holds the token, if it allows `needed`. All tokens are compared, in the same time.
    ///
    /// # Errors
    /// Why the request is not let in.
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
            // A right token is let in always: nobody may keep another one of the same address from disarming.
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
