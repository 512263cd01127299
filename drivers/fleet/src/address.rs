//! Server addresses in configurations.

use std::net::IpAddr;

/// Expected form of an address, for messages.
pub const ADDRESSES: &str =
    "nats://HOST:PORT or tls://HOST:PORT, several of them separated by commas";

/// Splits a comma-separated list of addresses.
pub fn addresses(text: &str) -> impl Iterator<Item = &str> {
    text.split(',').map(str::trim)
}

/// The first invalid server address. An address without a scheme, of a WebSocket, or with a user is invalid: users are identified by their nkeys.
pub fn wrong_address(text: &str) -> Option<&str> {
    addresses(text).find(|one| !is_address(one))
}

/// Addresses reached over a network without TLS, where the traffic can be read. Loopback addresses are excluded.
pub fn in_the_clear(text: &str) -> impl Iterator<Item = &str> {
    addresses(text).filter(|one| one.strip_prefix("nats://").is_some_and(|at| !is_here(at)))
}

/// True if the host of `HOST[:PORT]` is this computer.
fn is_here(place: &str) -> bool {
    let host = match place.strip_prefix('[') {
        Some(rest) => rest.split(']').next(),
        None => place.split(':').next(),
    };
    let host = host.unwrap_or_default();
    host == "localhost"
        || host
            .parse()
            .is_ok_and(|address: IpAddr| address.is_loopback())
}

fn is_address(text: &str) -> bool {
    let place = text
        .strip_prefix("nats://")
        .or_else(|| text.strip_prefix("tls://"));
    let Some(place) = place else { return false };
    // The port is optional.
    if let Some(rest) = place.strip_prefix('[') {
        let Some((host, port)) = rest.split_once(']') else {
            return false;
        };
        let port = match port {
            "" => None,
            port => match port.strip_prefix(':') {
                Some(port) => Some(port),
                None => return false,
            },
        };
        return host.parse::<std::net::Ipv6Addr>().is_ok() && port.is_none_or(is_port);
    }
    let (host, port) = match place.split_once(':') {
        Some((host, port)) => (host, Some(port)),
        None => (place, None),
    };
    let fits = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'.' | b'_');
    !host.is_empty() && host.bytes().all(fits) && port.is_none_or(is_port)
}

fn is_port(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_digit()) && text.parse::<u16>().is_ok_and(|port| port > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stays_on_this_computer_or_has_tls_is_not_in_the_clear() {
        let none = "nats://127.0.0.1:4222, nats://localhost, nats://[::1]:4222, nats://127.8.0.1, tls://nats.shop.lan";
        assert_eq!(in_the_clear(none).count(), 0);
        // One of several without TLS, and names that only begin like this computer.
        for (text, found) in [
            ("tls://a:4222,nats://b:4222", "nats://b:4222"),
            (
                "nats://localhost.shop.lan:4222",
                "nats://localhost.shop.lan:4222",
            ),
            ("nats://127.shop.lan", "nats://127.shop.lan"),
            ("nats://[2001:db8::1]:4222", "nats://[2001:db8::1]:4222"),
            ("nats://192.0.2.1:4222", "nats://192.0.2.1:4222"),
        ] {
            assert_eq!(in_the_clear(text).collect::<Vec<_>>(), [found], "{text}");
        }
    }
}
