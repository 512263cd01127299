//! Refused requests as records of the audit log: the first of a kind from an address at once, further ones within a minute as
//! one record with their number.
//!
//! State: the counts of the current minute, in memory. An entry exists exactly while its minute lasts.

use std::{
    collections::{BTreeSet, HashMap},
    net::IpAddr,
    sync::{Mutex, PoisonError},
    time::Duration,
};

use serde::Serialize;

use super::throttle::network;

/// How long refusals of a kind from one address are counted.
pub(crate) const WINDOW: Duration = Duration::from_secs(60);
/// Maximum number of different objects that a record names.
const MAX_OBJECTS: usize = 8;
/// Maximum number of addresses and kinds that are counted; beyond, all addresses are counted together.
const MAX_KEYS: usize = 1024;

/// What is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Refusal {
    /// A wrong name or password.
    Login,
    /// Too many wrong passwords before.
    Throttled,
    /// A request that the role of the user does not permit, or from a page of another origin.
    Forbidden,
}

impl Refusal {
    /// The action in the audit log.
    pub(crate) fn action(self) -> &'static str {
        match self {
            Self::Login => "login.refused",
            Self::Throttled => "login.throttled",
            Self::Forbidden => "request.forbidden",
        }
    }
}

/// Refusals that no record holds yet.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Further {
    /// Number of refusals.
    pub(crate) count: u64,
    /// Some of the names or paths that were tried.
    pub(crate) tried: BTreeSet<String>,
}

type Key = (Refusal, Option<IpAddr>);

/// The refusals of the current minute.
#[derive(Default)]
pub(crate) struct Refusals(Mutex<HashMap<Key, Further>>);

impl Refusals {
    /// Counts a refusal. A key if this is the first of its minute: it is to be recorded at once, and the others by
    /// [`Self::take`] at the end of the window.
    pub(crate) fn count(&self, refusal: Refusal, from: IpAddr, object: &str) -> Option<Key> {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut key = (refusal, Some(network(from)));
        if counts.len() >= MAX_KEYS && !counts.contains_key(&key) {
            key.1 = None;
        }
        if let Some(further) = counts.get_mut(&key) {
            further.count += 1;
            if further.tried.len() < MAX_OBJECTS {
                further.tried.insert(object.to_owned());
            }
            None
        } else {
            counts.insert(key, Further::default());
            Some(key)
        }
    }

    /// Ends a window: the refusals after its first one, if there were any.
    pub(crate) fn take(&self, key: Key) -> Option<Further> {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        counts.remove(&key).filter(|further| further.count > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::{Refusal, Refusals};

    #[test]
    fn the_first_is_recorded_and_the_others_are_counted() {
        let refusals = Refusals::default();
        let [one, other] = ["192.0.2.1", "192.0.2.2"].map(|text| text.parse().unwrap());
        let key = refusals.count(Refusal::Login, one, "anna").unwrap();
        for number in 0..59 {
            let object = format!("name{}", number % 20);
            assert_eq!(refusals.count(Refusal::Login, one, &object), None);
        }
        let quiet = refusals.count(Refusal::Login, other, "anna").unwrap();
        assert!(
            refusals
                .count(Refusal::Forbidden, one, "/api/users")
                .is_some()
        );
        let further = refusals.take(key).unwrap();
        assert_eq!((further.count, further.tried.len()), (59, 8));
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
