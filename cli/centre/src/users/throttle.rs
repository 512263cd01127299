//! Wrong passwords delay further attempts: for one account from one address, for one account, and from one address. A
//! correct password is accepted after the delay, so an attacker cannot lock a user out.
//!
//! State: the counts and the waiting attempts, in memory. Each pair of address and account has at most [`MAX_WAITING`] attempts waiting, which
//! bounds guesses to `MAX_WAITING / DELAY` a second.

use std::{
    collections::{BTreeSet, HashMap},
    net::IpAddr,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use serde::Serialize;

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
