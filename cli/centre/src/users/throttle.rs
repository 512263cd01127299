//! Wrong passwords are slowed down: by the address from which they come, and by the name that they try.
//!
//! State: the counts, in memory.

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

/// So many wrong passwords from one address are taken within [`WITHIN`], …
const OF_ADDRESS: u32 = 5;
/// … and so many for one name, from wherever: above it only who guesses from many addresses.
const OF_NAME: u32 = 50;
/// How long wrong passwords are counted.
const WITHIN: Duration = Duration::from_secs(60);
/// The largest number of addresses and of names that are counted.
const MOST: usize = 4096;

#[derive(Clone, PartialEq, Eq, Hash)]
enum Key {
    Address(IpAddr),
    Name(String),
}

/// The wrong passwords of the last minute.
#[derive(Default)]
pub struct Throttle(Mutex<HashMap<Key, (u32, Instant)>>);

impl Throttle {
    /// Whether a password from there for this name is looked at now. To be asked where the password is compared, so that those
    /// which wait for their turn are counted.
    pub fn admits(&self, from: IpAddr, name: &str) -> bool {
        let counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let below = |key: Key, most: u32| {
            counts
                .get(&key)
                .is_none_or(|(count, since)| *count < most || since.elapsed() >= WITHIN)
        };
        below(Key::Address(group(from)), OF_ADDRESS) && below(Key::Name(name.to_owned()), OF_NAME)
    }

    /// Counts a wrong password.
    pub fn wrong(&self, from: IpAddr, name: &str) {
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if counts.len() + 2 > MOST {
            counts.retain(|_, (_, since)| since.elapsed() < WITHIN);
        }
        if counts.len() + 2 > MOST {
            // So many addresses and names within a minute: the memory is bounded, and all counts begin anew.
            counts.clear();
        }
        for key in [Key::Address(group(from)), Key::Name(name.to_owned())] {
            let (count, since) = counts.entry(key).or_insert((0, Instant::now()));
            if since.elapsed() >= WITHIN {
                (*count, *since) = (0, Instant::now());
            }
            *count = count.saturating_add(1);
        }
    }
}

/// Addresses of IPv6 count by their network: one computer has as many of them as it likes.
fn group(address: IpAddr) -> IpAddr {
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

#[cfg(test)]
mod tests {
    use super::Throttle;

    #[test]
    fn an_address_is_blocked_and_others_are_not() {
        let throttle = Throttle::default();
        let [bad, good] = ["192.0.2.1", "192.0.2.2"].map(|text| text.parse().unwrap());
        for _ in 0..5 {
            assert!(throttle.admits(bad, "anna"));
            throttle.wrong(bad, "anna");
        }
        assert!(!throttle.admits(bad, "anna") && !throttle.admits(bad, "otto"));
        assert!(throttle.admits(good, "anna"));
        // The addresses of one network of IPv6 are one.
        let [one, other] = ["2001:db8::1", "2001:db8::2"].map(|text| text.parse().unwrap());
        for _ in 0..5 {
            throttle.wrong(one, "otto");
        }
        assert!(!throttle.admits(other, "berta"));
    }

    #[test]
    fn a_name_that_many_guess_is_blocked() {
        let throttle = Throttle::default();
        for last in 0..50 {
            throttle.wrong(std::net::Ipv4Addr::new(192, 0, 2, last).into(), "anna");
        }
        let fresh = "198.51.100.7".parse().unwrap();
        assert!(!throttle.admits(fresh, "anna"));
        assert!(throttle.admits(fresh, "otto"));
    }
}
