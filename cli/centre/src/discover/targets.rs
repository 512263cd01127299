//! Which addresses are asked: stated subnets, and no others.

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr},
    str::FromStr,
};

/// The largest subnet: as many addresses as two bytes tell apart.
const SHORTEST_PREFIX: u8 = 16;

/// A subnet of IPv4, or one address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Subnet {
    first: Ipv4Addr,
    prefix: u8,
}

/// Why a subnet is not searched.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotSearched {
    /// It cannot be read.
    #[error(
        "found {found:?}, expected an address or a subnet of IPv4, such as 192.0.2.17 or 192.0.2.0/24"
    )]
    Unreadable { found: String },
    /// The address has bits beyond its prefix: it is not clear what is meant.
    #[error("found {found}, expected {expected}: the address has bits beyond its prefix")]
    Bits {
        found: String,
        /// The subnet in which the address lies.
        expected: Subnet,
    },
    /// It has more addresses than are searched at once.
    #[error(
        "found {found} with {addresses} addresses, expected at most 65536 (/{SHORTEST_PREFIX}): state the subnets of the machines"
    )]
    TooLarge {
        found: Subnet,
        /// How many addresses it has.
        addresses: u64,
    },
    /// Others' computers may be there.
    #[error(
        "{found} is not a private range: others' computers may be there. If it is yours say --yes-these-are-mine"
    )]
    Public { found: Subnet },
    /// No single computers are there.
    #[error("{found} holds no single computers: it is multicast, broadcast or reserved")]
    Reserved { found: Subnet },
}

impl FromStr for Subnet {
    type Err = NotSearched;

    fn from_str(text: &str) -> Result<Self, NotSearched> {
        let unreadable = || NotSearched::Unreadable {
            found: text.to_owned(),
        };
        let (address, prefix) = match text.split_once('/') {
            Some((address, prefix)) => {
                let digits = prefix.bytes().all(|byte| byte.is_ascii_digit());
                let prefix: Option<u8> = prefix.parse().ok().filter(|_| digits);
                (address, prefix.filter(|prefix| *prefix <= 32))
            }
            None => (text, Some(32)),
        };
        let address: Ipv4Addr = address.parse().map_err(|_| unreadable())?;
        let prefix = prefix.ok_or_else(unreadable)?;
        let first = Ipv4Addr::from(u32::from(address) & mask(prefix));
        let subnet = Self { first, prefix };
        if first == address {
            Ok(subnet)
        } else {
            Err(NotSearched::Bits {
                found: text.to_owned(),
                expected: subnet,
            })
        }
    }
}

impl fmt::Display for Subnet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.first, self.prefix)
    }
}

fn mask(prefix: u8) -> u32 {
    u32::MAX
        .checked_shl(32 - u32::from(prefix.min(32)))
        .unwrap_or(0)
}

impl Subnet {
    fn last(self) -> u32 {
        u32::from(self.first) | !mask(self.prefix)
    }

    /// Whether it may be searched; `mine` confirms that a public range belongs to whoever asks.
    pub fn check(&self, mine: bool) -> Result<(), NotSearched> {
        let addresses = u64::from(self.last() - u32::from(self.first)) + 1;
        if self.prefix < SHORTEST_PREFIX {
            return Err(NotSearched::TooLarge {
                found: *self,
                addresses,
            });
        }
        let [a, ..] = self.first.octets();
        if a == 0 || a >= 224 {
            return Err(NotSearched::Reserved { found: *self });
        }
        let private = PRIVATE.iter().any(|(range, prefix)| {
            u32::from(self.first) & mask(*prefix) == u32::from(*range) && self.prefix >= *prefix
        });
        if private || mine {
            Ok(())
        } else {
            Err(NotSearched::Public { found: *self })
        }
    }

    /// The addresses of computers: all of them, but for that of the subnet itself and its broadcast where it has more than two.
    pub fn addresses(&self) -> impl Iterator<Item = IpAddr> + use<> {
        let (first, last) = (u32::from(self.first), self.last());
        let ends = u32::from(self.prefix < 31);
        (first + ends..=last - ends).map(|address| IpAddr::V4(Ipv4Addr::from(address)))
    }
}

/// Ranges in which a shop has its machines: private ones of RFC 1918, the computer itself, link-local ones, shared ones of
/// RFC 6598, and those of the documentation (RFC 5737) and of benchmarks (RFC 2544), which are nobody's.
const PRIVATE: [(Ipv4Addr, u8); 10] = [
    (Ipv4Addr::new(10, 0, 0, 0), 8),
    (Ipv4Addr::new(172, 16, 0, 0), 12),
    (Ipv4Addr::new(192, 168, 0, 0), 16),
    (Ipv4Addr::new(127, 0, 0, 0), 8),
    (Ipv4Addr::new(169, 254, 0, 0), 16),
    (Ipv4Addr::new(100, 64, 0, 0), 10),
    (Ipv4Addr::new(192, 0, 2, 0), 24),
    (Ipv4Addr::new(198, 51, 100, 0), 24),
    (Ipv4Addr::new(203, 0, 113, 0), 24),
    (Ipv4Addr::new(198, 18, 0, 0), 15),
];
