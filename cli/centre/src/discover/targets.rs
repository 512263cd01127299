//! The addresses to probe: the given subnets and no others.

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr},
    str::FromStr,
};

/// Prefix length of the largest subnet: 65 536 addresses.
const SHORTEST_PREFIX: u8 = 16;

/// An IPv4 subnet or a single address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Subnet {
    first: Ipv4Addr,
    prefix: u8,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SubnetError {
    #[error(
        "found {found:?}, expected an address or a subnet of IPv4, such as 192.0.2.17 or 192.0.2.0/24"
    )]
    Unreadable { found: String },
    /// The address has bits set beyond its prefix, so it is ambiguous.
    #[error("found {found}, expected {expected}: the address has bits beyond its prefix")]
    Bits {
        found: String,
        /// The subnet that contains the address.
        expected: Subnet,
    },
    #[error(
        "found {found} with {addresses} addresses, expected at most 65536 (/{SHORTEST_PREFIX}): state the subnets of the machines"
    )]
    TooLarge {
        found: Subnet,
        /// Number of addresses in the subnet.
        addresses: u64,
    },
    /// The range is public and may belong to others.
    #[error(
        "{found} is not a private range: it may contain computers of others. If it is yours, add --yes-these-are-mine"
    )]
    Public { found: Subnet },
    /// A range without individual hosts, such as multicast.
    #[error("{found} contains no hosts: it is multicast, broadcast or reserved")]
    Reserved { found: Subnet },
}

impl FromStr for Subnet {
    type Err = SubnetError;

    fn from_str(text: &str) -> Result<Self, SubnetError> {
        let unreadable = || SubnetError::Unreadable { found: text.to_owned() };
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
            Err(SubnetError::Bits { found: text.to_owned(), expected: subnet })
        }
    }
}

impl fmt::Display for Subnet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.first, self.prefix)
    }
}

fn mask(prefix: u8) -> u32 {
    u32::MAX.checked_shl(32 - u32::from(prefix.min(32))).unwrap_or(0)
}

impl Subnet {
    fn last(self) -> u32 {
        u32::from(self.first) | !mask(self.prefix)
    }

    /// Checks whether the subnet may be searched; `mine` confirms that a public range belongs to the user.
    pub fn check(&self, mine: bool) -> Result<(), SubnetError> {
        let addresses = u64::from(self.last() - u32::from(self.first)) + 1;
        if self.prefix < SHORTEST_PREFIX {
            return Err(SubnetError::TooLarge { found: *self, addresses });
        }
        let [a, ..] = self.first.octets();
        if a == 0 || a >= 224 {
            return Err(SubnetError::Reserved { found: *self });
        }
        let private = PRIVATE.iter().any(|(range, prefix)| {
            u32::from(self.first) & mask(*prefix) == u32::from(*range) && self.prefix >= *prefix
        });
        if private || mine { Ok(()) } else { Err(SubnetError::Public { found: *self }) }
    }

    /// Host addresses. Subnets of more than two addresses exclude their network and broadcast addresses.
    pub fn addresses(&self) -> impl Iterator<Item = IpAddr> + use<> {
        let (first, last) = (u32::from(self.first), self.last());
        let ends = u32::from(self.prefix < 31);
        (first + ends..=last - ends).map(|address| IpAddr::V4(Ipv4Addr::from(address)))
    }
}

/// Ranges in which a shop has its machines: private (RFC 1918), loopback, link-local, shared (RFC 6598), documentation (RFC 5737) and benchmarking
/// (RFC 2544).
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
