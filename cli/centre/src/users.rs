//! Users: roles, passwords (Argon2id), sessions and rejected requests, as plain data and rules. `store::users` stores
//! users and sessions.
//!
//! A session is a random token in the browser and its hash in the store. Its times count from the boot of the computer
//! and are valid until the next boot, so setting back the wall clock does not extend a session.
//!
//! Wrong passwords delay further attempts: for one account from one address, for one account, and from one address. A
//! correct password is accepted after the delay, so an attacker cannot lock a user out.
//!
//! State: the counts and the waiting attempts, in memory. Each pair of address and account has at most `MAX_WAITING`
//! attempts waiting, which bounds guesses to `MAX_WAITING / DELAY` a second.

use std::{
    collections::{BTreeSet, HashMap},
    fmt,
    net::IpAddr,
    str::FromStr,
    sync::{LazyLock, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use argon2::{Argon2, PasswordHasher, PasswordVerifier};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::Error;

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

/// Wrong passwords for one account from one address within [`WINDOW`] before attempts are delayed.
const MAX_WRONG_OF_PAIR: u32 = 5;
/// Wrong passwords from one address (any account), or for one account (any address), before attempts are delayed.
const MAX_WRONG_OF_ONE: u32 = 50;
const WINDOW: Duration = Duration::from_secs(60);
const DELAY: Duration = Duration::from_secs(2);
const MAX_WAITING: u32 = 2;
const MAX_COUNTS: usize = 4096;

#[derive(Clone, PartialEq, Eq, Hash)]
enum Key {
    Address(IpAddr),
    Account(String),
    Pair(IpAddr, String),
}

impl Key {
    fn all(from: IpAddr, account: &str) -> [Self; 3] {
        let network = network(from);
        [
            Self::Address(network),
            Self::Account(account.to_owned()),
            Self::Pair(network, account.to_owned()),
        ]
    }

    fn max(&self) -> u32 {
        match self {
            Self::Pair(..) => MAX_WRONG_OF_PAIR,
            Self::Address(_) | Self::Account(_) => MAX_WRONG_OF_ONE,
        }
    }
}

#[derive(Default)]
struct Counts {
    /// Number of wrong passwords, and the start of the window in which they are counted.
    wrong: HashMap<Key, (u32, Instant)>,
    /// Number of delayed attempts by address and account, at least 1.
    waiting: HashMap<(IpAddr, String), u32>,
}

/// The wrong passwords of the last minute.
#[derive(Default)]
pub struct Throttle(Mutex<Counts>);

/// An attempt that may be made after `delay`.
pub struct Attempt<'a> {
    throttle: &'a Throttle,
    waiting: Option<(IpAddr, String)>,
}

impl Attempt<'_> {
    pub fn delay(&self) -> Duration {
        if self.waiting.is_some() { DELAY } else { Duration::ZERO }
    }
}

impl Drop for Attempt<'_> {
    fn drop(&mut self) {
        if let Some(pair) = self.waiting.take() {
            let mut counts = self.throttle.counts();
            if let Some(count) = counts.waiting.get_mut(&pair) {
                *count -= 1;
                if *count == 0 {
                    counts.waiting.remove(&pair);
                }
            }
        }
    }
}

impl Throttle {
    fn counts(&self) -> MutexGuard<'_, Counts> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Registers a login attempt; hold the attempt until the password has been compared. `None` if the maximum number
    /// of attempts for this account from this address is already waiting.
    pub fn attempt(&self, from: IpAddr, account: &str) -> Option<Attempt<'_>> {
        let mut counts = self.counts();
        let delayed = Key::all(from, account).iter().any(|key| {
            counts
                .wrong
                .get(key)
                .is_some_and(|(count, since)| *count >= key.max() && since.elapsed() < WINDOW)
        });
        let waiting = if delayed {
            let pair = (network(from), account.to_owned());
            let count = counts.waiting.entry(pair.clone()).or_insert(0);
            if *count >= MAX_WAITING {
                return None;
            }
            *count += 1;
            Some(pair)
        } else {
            None
        };
        Some(Attempt { throttle: self, waiting })
    }

    pub fn wrong(&self, from: IpAddr, account: &str) {
        let mut counts = self.counts();
        let keys = Key::all(from, account);
        if counts.wrong.len() + keys.len() > MAX_COUNTS {
            counts.wrong.retain(|_, (_, since)| since.elapsed() < WINDOW);
        }
        if counts.wrong.len() + keys.len() > MAX_COUNTS {
            // Memory is bounded: restart all counts.
            counts.wrong.clear();
        }
        for key in keys {
            let (count, since) = counts.wrong.entry(key).or_insert((0, Instant::now()));
            if since.elapsed() >= WINDOW {
                (*count, *since) = (0, Instant::now());
            }
            *count = count.saturating_add(1);
        }
    }
}

/// Network of an IPv6 address, because one computer can have many addresses of its network. IPv4 addresses are returned
/// unchanged.
fn network(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(_) => address,
        IpAddr::V6(v6) => v6.to_ipv4_mapped().map_or_else(
            || {
                let [a, b, c, d, ..] = v6.segments();
                IpAddr::from([a, b, c, d, 0, 0, 0, 0])
            },
            IpAddr::V4,
        ),
    }
}

/// Time over which rejections of a kind from one address are combined.
pub(crate) const REFUSAL_WINDOW: Duration = Duration::from_secs(60);
const MAX_OBJECTS: usize = 8;
/// Maximum number of counted addresses and kinds; beyond it, all addresses are counted together.
const MAX_KEYS: usize = 1024;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Refusal {
    Login,
    /// Rejected because of too many wrong passwords.
    Throttled,
    /// A request that the role of the user does not permit, or from a page of another origin.
    Forbidden,
}

impl Refusal {
    pub(crate) fn action(self) -> &'static str {
        match self {
            Self::Login => "login.refused",
            Self::Throttled => "login.throttled",
            Self::Forbidden => "request.forbidden",
        }
    }
}

/// Rejections not yet in the audit log. The first rejection of a kind from an address is recorded immediately; further
/// ones within a minute are recorded together with their number.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct SuppressedRefusals {
    pub(crate) count: u64,
    pub(crate) tried: BTreeSet<String>,
}

type RefusalKey = (Refusal, Option<IpAddr>);

/// Rejections of the current minute. An entry exists exactly while its minute lasts.
#[derive(Default)]
pub(crate) struct Refusals(Mutex<HashMap<RefusalKey, SuppressedRefusals>>);

impl Refusals {
    /// Counts a rejection. Returns a key for the first rejection of its window, which must be recorded immediately. At
    /// the end of the window, [`Self::take`] returns the further ones.
    pub(crate) fn count(&self, refusal: Refusal, from: IpAddr, object: &str) -> Option<RefusalKey> {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut key = (refusal, Some(network(from)));
        if counts.len() >= MAX_KEYS && !counts.contains_key(&key) {
            key.1 = None;
        }
        if let Some(suppressed) = counts.get_mut(&key) {
            suppressed.count += 1;
            if suppressed.tried.len() < MAX_OBJECTS {
                suppressed.tried.insert(object.to_owned());
            }
            None
        } else {
            counts.insert(key, SuppressedRefusals::default());
            Some(key)
        }
    }

    /// Ends a window. Returns the rejections after the first one, if any.
    pub(crate) fn take(&self, key: RefusalKey) -> Option<SuppressedRefusals> {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        counts.remove(&key).filter(|suppressed| suppressed.count > 0)
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

    fn delay(throttle: &Throttle, from: IpAddr, account: &str) -> Option<Duration> {
        throttle.attempt(from, account).map(|attempt| attempt.delay())
    }

    #[test]
    fn wrong_passwords_delay_this_account_from_this_address() {
        let throttle = Throttle::default();
        let [bad, good] = ["192.0.2.1", "192.0.2.2"].map(|text| text.parse().unwrap());
        for _ in 0..5 {
            assert_eq!(delay(&throttle, bad, "anna"), Some(Duration::ZERO));
            throttle.wrong(bad, "anna");
        }
        assert_eq!(delay(&throttle, bad, "anna"), Some(DELAY));
        assert_eq!(delay(&throttle, bad, "otto"), Some(Duration::ZERO));
        assert_eq!(delay(&throttle, good, "anna"), Some(Duration::ZERO));
        // Two attempts may wait; a third is rejected until one of them has ended.
        let first = throttle.attempt(bad, "anna");
        let _second = throttle.attempt(bad, "anna");
        assert_eq!(delay(&throttle, bad, "anna"), None);
        drop(first);
        assert_eq!(delay(&throttle, bad, "anna"), Some(DELAY));
        // The addresses of one IPv6 network count together.
        let [one, other] = ["2001:db8::1", "2001:db8::2"].map(|text| text.parse().unwrap());
        for _ in 0..5 {
            throttle.wrong(one, "otto");
        }
        assert_eq!(delay(&throttle, other, "otto"), Some(DELAY));
    }

    #[test]
    fn an_account_guessed_from_many_addresses_and_an_address_that_guesses_many_are_delayed() {
        let throttle = Throttle::default();
        let fresh: IpAddr = "198.51.100.7".parse().unwrap();
        for last in 0..50 {
            throttle.wrong(std::net::Ipv4Addr::new(192, 0, 2, last).into(), "anna");
            throttle.wrong(fresh, &format!("guess{last}"));
        }
        let other = "203.0.113.9".parse().unwrap();
        assert_eq!(delay(&throttle, other, "anna"), Some(DELAY));
        assert_eq!(delay(&throttle, other, "otto"), Some(Duration::ZERO));
        assert_eq!(delay(&throttle, fresh, "otto"), Some(DELAY));
    }

    #[test]
    fn the_first_refusal_is_recorded_and_further_ones_counted() {
        let refusals = Refusals::default();
        let [one, other] = ["192.0.2.1", "192.0.2.2"].map(|text| text.parse().unwrap());
        let key = refusals.count(Refusal::Login, one, "anna").unwrap();
        for number in 0..59 {
            let object = format!("name{}", number % 20);
            assert_eq!(refusals.count(Refusal::Login, one, &object), None);
        }
        let quiet = refusals.count(Refusal::Login, other, "anna").unwrap();
        assert!(refusals.count(Refusal::Forbidden, one, "/api/users").is_some());
        let suppressed = refusals.take(key).unwrap();
        assert_eq!((suppressed.count, suppressed.tried.len()), (59, 8));
        assert_eq!(refusals.take(quiet), None);
        assert!(refusals.count(Refusal::Login, one, "anna").is_some());
    }

    #[test]
    fn memory_is_bounded() {
        let refusals = Refusals::default();
        let mut recorded = 0;
        for number in 0..3000_u32 {
            let from = std::net::Ipv4Addr::from(number).into();
            recorded += usize::from(refusals.count(Refusal::Login, from, "anna").is_some());
        }
        assert_eq!(recorded, 1025);
    }
}
