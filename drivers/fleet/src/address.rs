use std::net::{IpAddr, Ipv6Addr};

/// Expected form of a list of addresses, for messages.
pub const ADDRESSES: &str =
    "nats://HOST:PORT or tls://HOST:PORT, several of them separated by commas";

const DEFAULT_PORT: u16 = 4222;

/// Splits a comma-separated list of addresses.
pub fn addresses(text: &str) -> impl Iterator<Item = &str> {
    text.split(',').map(str::trim)
}

/// First invalid server address in a list; `None` if all are valid. Invalid are addresses without a scheme, WebSocket
/// addresses, and addresses with a user, because nkeys identify users.
pub fn wrong_address(text: &str) -> Option<&str> {
    addresses(text).find(|one| parse(one).is_none())
}

/// Addresses without TLS to other hosts than the loopback. Others on the network can read this traffic.
pub fn in_the_clear(text: &str) -> impl Iterator<Item = &str> {
    addresses(text).filter(|one| {
        one.starts_with("nats://") && !parse(one).is_some_and(|(host, _)| is_loopback(host))
    })
}

/// Port of the first address in a list [default: 4222]; `None` if the address is invalid.
pub fn first_port(text: &str) -> Option<u16> {
    let (_, port) = parse(addresses(text).next()?)?;
    Some(port.unwrap_or(DEFAULT_PORT))
}

fn is_loopback(host: &str) -> bool {
    host == "localhost" || host.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

/// Host and port of an address; `None` if the address is invalid. An IPv6 host is returned without its brackets.
fn parse(text: &str) -> Option<(&str, Option<u16>)> {
    let address = text.strip_prefix("nats://").or_else(|| text.strip_prefix("tls://"))?;
    let (host, port) = if let Some(rest) = address.strip_prefix('[') {
        let (host, port) = rest.split_once(']')?;
        host.parse::<Ipv6Addr>().ok()?;
        match port {
            "" => (host, None),
            port => (host, Some(port.strip_prefix(':')?)),
        }
    } else {
        let (host, port) = match address.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (address, None),
        };
        let fits = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'.' | b'_');
        if host.is_empty() || !host.bytes().all(fits) {
            return None;
        }
        (host, port)
    };
    match port {
        None => Some((host, None)),
        Some(port) => Some((host, Some(parse_port(port)?))),
    }
}

fn parse_port(text: &str) -> Option<u16> {
    let digits = text.bytes().all(|byte| byte.is_ascii_digit());
    text.parse().ok().filter(|port| digits && *port > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_and_tls_addresses_are_not_in_the_clear() {
        let none = "nats://127.0.0.1:4222, nats://localhost, nats://[::1]:4222, nats://127.8.0.1, tls://nats.shop.lan";
        assert_eq!(in_the_clear(none).count(), 0);
        // The list has one address without TLS, or a name only begins like a loopback address.
        for (text, found) in [
            ("tls://a:4222,nats://b:4222", "nats://b:4222"),
            ("nats://localhost.shop.lan:4222", "nats://localhost.shop.lan:4222"),
            ("nats://127.shop.lan", "nats://127.shop.lan"),
            ("nats://[2001:db8::1]:4222", "nats://[2001:db8::1]:4222"),
            ("nats://192.0.2.1:4222", "nats://192.0.2.1:4222"),
        ] {
            assert_eq!(in_the_clear(text).collect::<Vec<_>>(), [found], "{text}");
        }
    }

    #[test]
    fn the_first_address_gives_the_port() {
        for (text, port) in [
            ("nats://127.0.0.1:4300, nats://b:4301", Some(4300)),
            ("tls://[::1]:4300", Some(4300)),
            ("nats://[::1]", Some(4222)),
            ("tls://nats.shop.lan", Some(4222)),
            ("nats://a:0", None),
            ("nats://a:+1", None),
            ("nats://[::1]x", None),
            ("http://a:80", None),
        ] {
            assert_eq!(first_port(text), port, "{text}");
        }
    }
}
