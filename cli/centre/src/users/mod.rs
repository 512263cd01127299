//! Users: roles, passwords (Argon2id) and sessions, as plain data and rules. `store::users` stores them.
//!
//! A session is a random token in the browser and its hash in the store. Its times count from the boot of the computer
//! and are valid until the next boot, so setting back the wall clock does not extend a session.

mod throttle;

use std::{fmt, str::FromStr, sync::LazyLock, time::Duration};

use argon2::{Argon2, PasswordHasher, PasswordVerifier};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::Error;
pub use throttle::{Attempt, Throttle};
pub(crate) use throttle::{REFUSAL_WINDOW, Refusal, Refusals};

/// Permissions of a user; each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    Viewer,
    /// May register machines, add models, roll them out, acknowledge alarms and search the network.
    Engineer,
    /// May manage users and read the audit log.
    Admin,
}

impl Role {
    pub const ALL: [Self; 3] = [Self::Viewer, Self::Engineer, Self::Admin];

    pub fn name(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Engineer => "engineer",
            Self::Admin => "admin",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|role| role.name() == text)
            .ok_or_else(|| format!("found {text:?}, expected viewer, engineer or admin"))
    }
}

/// User name, unique in the centre: 1 to 64 lower-case letters, digits, dots, hyphens and underscores.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct UserName(String);

impl UserName {
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for UserName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let fits =
            |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b".-_".contains(&byte);
        let first = text.bytes().next().is_some_and(|byte| byte.is_ascii_lowercase());
        // In the audit log, `centre` denotes the program itself.
        if first && text.len() <= 64 && text.bytes().all(fits) && text != "centre" {
            Ok(Self(text.to_owned()))
        } else {
            let found: String = text.chars().take(80).collect();
            Err(Error::Wrong(format!(
                "found {found:?}, expected a user's name: 1 to 64 lower-case letters, digits, dots, hyphens and underscores, a letter first; not `centre`"
            )))
        }
    }
}

impl TryFrom<String> for UserName {
    type Error = Error;

    fn try_from(text: String) -> Result<Self, Error> {
        text.parse()
    }
}

impl From<UserName> for String {
    fn from(name: UserName) -> Self {
        name.0
    }
}

impl fmt::Display for UserName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct User {
    pub name: UserName,
    pub role: Role,
    pub disabled: bool,
    pub added_s: f64,
    pub added_by: String,
}

const MIN_CHARACTERS: usize = 12;
/// Maximum length of a password, bytes: a longer one only costs time.
const MAX_BYTES: usize = 1024;

/// A password as entered. It is never displayed, not even by `Debug`.
#[derive(Clone, PartialEq, Eq)]
pub struct Password(String);

impl Password {
    pub fn chosen(text: String) -> Result<Self, Error> {
        let found = text.chars().count();
        if found < MIN_CHARACTERS {
            return Err(Error::Wrong(format!(
                "the password has {found} characters, expected at least {MIN_CHARACTERS}"
            )));
        }
        Self::entered(text)
    }

    pub fn entered(text: String) -> Result<Self, Error> {
        if text.len() > MAX_BYTES {
            return Err(Error::Wrong(format!(
                "the password has {} bytes, expected at most {MAX_BYTES}",
                text.len()
            )));
        }
        Ok(Self(text))
    }
}

impl fmt::Debug for Password {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Password(..)")
    }
}

/// Hashes a password with a random salt, in the form `$argon2id$v=19$…` (19 MiB, two passes).
pub fn hash(password: &Password) -> Result<String, Error> {
    let hash = Argon2::default().hash_password(password.0.as_bytes());
    hash.map(|hash| hash.to_string())
        .map_err(|_| Error::Wrong("the password could not be hashed".to_owned()))
}

/// Verifies a password. Without a stored hash (unknown user), the function takes the same time and returns `false`.
pub fn is_right(password: &Password, stored: Option<&str>) -> bool {
    static DUMMY_HASH: LazyLock<Option<String>> =
        LazyLock::new(|| hash(&Password("of no user".to_owned())).ok());
    let Some(compared) = stored.or(DUMMY_HASH.as_deref()) else {
        return false;
    };
    let argon2 = Argon2::default();
    let equal = argon2.verify_password(password.0.as_bytes(), compared);
    equal.is_ok() && stored.is_some()
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BootTime {
    pub boot: String,
    /// Seconds since boot, standby included.
    pub since_boot_s: f64,
}

impl BootTime {
    pub fn now() -> Self {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
        // Without a boot identifier only the time since boot is compared; it restarts with each boot.
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        Self {
            boot: boot.trim().to_owned(),
            since_boot_s: time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9,
        }
    }

    #[must_use]
    pub fn later(&self, by: Duration) -> Self {
        Self { boot: self.boot.clone(), since_boot_s: self.since_boot_s + by.as_secs_f64() }
    }

    /// Seconds since an earlier time; `None` if `earlier` is from another boot or is later.
    pub fn since(&self, earlier: &Self) -> Option<f64> {
        let seconds = self.since_boot_s - earlier.since_boot_s;
        (self.boot == earlier.boot && seconds >= 0.0).then_some(seconds)
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Session {
    pub user: UserName,
    pub since: BootTime,
    /// Time of last use, updated at most once a minute.
    pub used: BootTime,
    pub from: String,
}

impl Session {
    pub const IDLE_TIMEOUT: Duration = Duration::from_secs(30 * 60);
    /// Maximum duration of a session: a working day.
    pub const MAX_DURATION: Duration = Duration::from_secs(12 * 3600);
    pub const LAST_USE_INTERVAL: Duration = Duration::from_secs(60);

    /// True until the maximum duration or the idle timeout has passed.
    pub fn is_alive(&self, now: &BootTime) -> bool {
        let within = |earlier: &BootTime, limit: Duration| {
            now.since(earlier).is_some_and(|seconds| seconds <= limit.as_secs_f64())
        };
        within(&self.since, Self::MAX_DURATION) && within(&self.used, Self::IDLE_TIMEOUT)
    }

    pub fn needs_last_use_update(&self, now: &BootTime) -> bool {
        now.since(&self.used)
            .is_some_and(|seconds| seconds >= Self::LAST_USE_INTERVAL.as_secs_f64())
    }
}

/// Session token of a browser: 256 random bits. Only its hash is stored.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    pub fn generate() -> Result<Self, getrandom::Error> {
        let mut bytes = [0; 32];
        getrandom::fill(&mut bytes)?;
        Ok(Self(volcomp_model::hexadecimal(&bytes)))
    }

    /// Parses a token received from a browser; `None` if it is malformed.
    pub fn parse(text: &str) -> Option<Self> {
        let fits = text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
        fits.then(|| Self(text.to_owned()))
    }

    pub fn text(&self) -> &str {
        &self.0
    }

    /// Hash of the token, under which the session is stored. A timing attack on the look-up may reveal part of the
    /// hash, but nothing of the token.
    pub fn hash(&self) -> String {
        volcomp_model::hexadecimal(&Sha256::digest(self.0.as_bytes()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_password_matches() {
        let of = |text: &str| Password::entered(text.to_owned()).unwrap();
        let stored = hash(&of("correct horse battery")).unwrap();
        assert!(stored.starts_with("$argon2id$v=19$m=19456,t=2,p=1$"), "{stored}");
        assert!(is_right(&of("correct horse battery"), Some(&stored)));
        assert!(!is_right(&of("correct horse batterz"), Some(&stored)));
        assert!(!is_right(&of(""), Some(&stored)));
        assert!(!is_right(&of("of no user"), None));
        assert!(!is_right(&of("x"), Some("no hash")));
        // Each hash has another salt.
        assert_ne!(stored, hash(&of("correct horse battery")).unwrap());
        assert_eq!(format!("{:?}", of("secret")), "Password(..)");
    }

    #[test]
    fn too_short_and_too_long_passwords_are_rejected() {
        let refused = |made: Result<Password, Error>| made.unwrap_err().to_string();
        let short = refused(Password::chosen("ä".repeat(11)));
        assert_eq!(short, "the password has 11 characters, expected at least 12");
        assert!(Password::chosen("ä".repeat(12)).is_ok());
        let long = refused(Password::entered("a".repeat(1025)));
        assert_eq!(long, "the password has 1025 bytes, expected at most 1024");
    }

    fn session() -> (Session, BootTime) {
        let now = BootTime { boot: "a".to_owned(), since_boot_s: 1000.0 };
        let session = Session {
            user: "anna".parse().unwrap(),
            since: now.clone(),
            used: now.clone(),
            from: String::new(),
        };
        (session, now)
    }

    #[test]
    fn a_session_ends_idle_after_a_day_and_with_the_boot() {
        let (mut session, start) = session();
        let after = |s: u64| start.later(Duration::from_secs(s));
        assert!(session.is_alive(&after(1800)));
        assert!(!session.is_alive(&after(1801)));
        session.used = after(43_000);
        assert!(session.is_alive(&after(43_200)));
        assert!(!session.is_alive(&after(43_201)));
        let other = BootTime { boot: "b".to_owned(), ..after(10) };
        assert!(!session.is_alive(&other));
        // A time before the session's start is from another boot.
        let before = BootTime { since_boot_s: 999.0, ..start.clone() };
        assert!(!session.is_alive(&before));
        let (session, _) = self::session();
        assert!(
            !session.needs_last_use_update(&after(59)) && session.needs_last_use_update(&after(60))
        );
    }

    #[test]
    fn tokens_are_random_and_stored_as_hashes() {
        let [one, other] = [Token::generate().unwrap(), Token::generate().unwrap()];
        assert_ne!(one.text(), other.text());
        assert_eq!(one.text().len(), 64);
        assert_ne!(one.hash(), one.text());
        assert!(Token::parse(one.text()).is_some());
        assert!(Token::parse("..").is_none() && Token::parse(&"g".repeat(64)).is_none());
    }
}
