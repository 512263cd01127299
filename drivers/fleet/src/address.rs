//! Addresses of servers as a configuration has them.

/// What an address must be, for messages.
pub const ADDRESSES: &str =
    "nats://HOST:PORT or tls://HOST:PORT, several of them separated by commas";

/// The addresses in a text, one by one.
pub fn addresses(text: &str) -> impl Iterator<Item = &str> {
    text.split(',').map(str::trim)
}

/// The first that is no address of a server. One without a scheme, of a web socket, or with a user is none: users are known by
/// their nkeys.
pub fn wrong_address(text: &str) -> Option<&str> {
    addresses(text).find(|one| !is_address(one))
}

fn is_address(text: &str) -> bool {
    let place = text
        .strip_prefix("nats://")
        .or_else(|| text.strip_prefix("tls://"));
    let Some(place) = place else { return false };
    // The port may be left out.
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
