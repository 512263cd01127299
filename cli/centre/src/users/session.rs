//! Sessions: a random token in the browser, its hash in the store, and two timeouts.
//!
//! Times count from the boot of the computer and are valid only until the next boot, so setting back the wall clock does not extend a session.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::UserName;

/// A time within one boot of the computer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moment {
    /// Boot id of the kernel.
    pub boot: String,
    /// Seconds since boot, standby included.
    pub since_boot_s: f64,
}

impl Moment {
    pub fn now() -> Self {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
        // Without a boot id only the time counts; it restarts with each boot.
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        Self {
            boot: boot.trim().to_owned(),
            since_boot_s: time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9,
        }
    }

    /// A later time of the same boot.
    #[must_use]
    pub fn later(&self, by: Duration) -> Self {
        Self {
            boot: self.boot.clone(),
            since_boot_s: self.since_boot_s + by.as_secs_f64(),
        }
    }

    /// Seconds since an earlier time; `None` if that was in another boot, or is not earlier.
    pub fn since(&self, earlier: &Self) -> Option<f64> {
        let seconds = self.since_boot_s - earlier.since_boot_s;
        (self.boot == earlier.boot && seconds >= 0.0).then_some(seconds)
    }
}

/// A session of a user.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Session {
    pub user: UserName,
    pub since: Moment,
    /// Last use, to the minute.
    pub used: Moment,
    /// Address from which the user logged in, for display.
    pub from: String,
}

impl Session {
    /// Idle timeout.
    pub const IDLE: Duration = Duration::from_secs(30 * 60);
    /// Maximum duration of a session: a working day.
    pub const LONGEST: Duration = Duration::from_secs(12 * 3600);
    /// Interval at which the time of its last use is stored.
    pub const NOTED: Duration = Duration::from_secs(60);

    /// True until a timeout has passed.
    pub fn is_alive(&self, now: &Moment) -> bool {
        let within = |earlier: &Moment, limit: Duration| {
            now.since(earlier)
                .is_some_and(|seconds| seconds <= limit.as_secs_f64())
        };
        within(&self.since, Self::LONGEST) && within(&self.used, Self::IDLE)
    }

    /// True if the time of its last use must be stored again.
    pub fn is_to_be_noted(&self, now: &Moment) -> bool {
        now.since(&self.used)
            .is_some_and(|seconds| seconds >= Self::NOTED.as_secs_f64())
    }
}

/// Session token of a browser: 256 random bits. Only its hash is stored.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Generates a token from the random generator of the operating system.
    pub fn draw() -> Result<Self, getrandom::Error> {
        let mut bytes = [0; 32];
        getrandom::fill(&mut bytes)?;
        Ok(Self(crate::hex(&bytes)))
    }

    /// Parses a token received from a browser; `None` if it is malformed.
    pub fn shown(text: &str) -> Option<Self> {
        let fits = text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
        fits.then(|| Self(text.to_owned()))
    }

    pub fn text(&self) -> &str {
        &self.0
    }

    /// Hash of the token, under which the session is stored. A timing attack on the look-up by hash may reveal part of a hash, but nothing of the
    /// token.
    pub fn hash(&self) -> String {
        crate::hex(&Sha256::digest(self.0.as_bytes()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn session() -> (Session, Moment) {
        let now = Moment {
            boot: "a".to_owned(),
            since_boot_s: 1000.0,
        };
        let session = Session {
            user: "anna".parse().unwrap(),
            since: now.clone(),
            used: now.clone(),
            from: String::new(),
        };
        (session, now)
    }

    #[test]
    fn it_ends_unused_and_after_a_day_and_with_the_boot() {
        let (mut session, start) = session();
        let after = |s: u64| start.later(Duration::from_secs(s));
        assert!(session.is_alive(&after(1800)));
        assert!(!session.is_alive(&after(1801)));
        session.used = after(43_000);
        assert!(session.is_alive(&after(43_200)));
        assert!(!session.is_alive(&after(43_201)));
        let other = Moment {
            boot: "b".to_owned(),
            ..after(10)
        };
        assert!(!session.is_alive(&other));
        // A time before its beginning is none of this boot.
        let before = Moment {
            since_boot_s: 999.0,
            ..start.clone()
        };
        assert!(!session.is_alive(&before));
        let (session, _) = self::session();
        assert!(!session.is_to_be_noted(&after(59)) && session.is_to_be_noted(&after(60)));
    }

    #[test]
    fn tokens_are_random_and_stored_as_hashes() {
        let [one, other] = [Token::draw().unwrap(), Token::draw().unwrap()];
        assert_ne!(one.text(), other.text());
        assert_eq!(one.text().len(), 64);
        assert_ne!(one.hash(), one.text());
        assert!(Token::shown(one.text()).is_some());
        assert!(Token::shown("..").is_none() && Token::shown(&"g".repeat(64)).is_none());
    }
}
