//! Host names under which a browser may address this program. They prevent DNS rebinding, in which another site
//! resolves its own name to the address of this program.

use std::{net::IpAddr, time::Duration};

use axum::{
    extract::Request,
    http::{StatusCode, header},
    middleware::Next,
    response::Response,
};

/// Passes on a request if its Host header names this program ([`is_known`]), and limits the time until the response.
///
/// # Errors
/// Status and reason: there is no Host header, the host is not known (the reason is `unknown`), or the response takes
/// longer than `timeout`.
pub async fn pass(
    request: Request,
    next: Next,
    known: &[String],
    unknown: &'static str,
    timeout: Duration,
) -> Result<Response, (StatusCode, &'static str)> {
    let host = request.headers().get(header::HOST);
    let host = host.and_then(|host| host.to_str().ok());
    let host = host.ok_or((StatusCode::BAD_REQUEST, "no Host header"))?;
    if !is_known(host, known) {
        return Err((StatusCode::MISDIRECTED_REQUEST, unknown));
    }
    let response = tokio::time::timeout(timeout, next.run(request)).await;
    response.map_err(|_| (StatusCode::REQUEST_TIMEOUT, "the request took too long"))
}

/// Whether a Host header names this program: its host is an IP address, `localhost`, or one of the `known` names, with
/// any port.
pub fn is_known(host: &str, known: &[String]) -> bool {
    let name = without_port(host);
    let address = name.trim_start_matches('[').trim_end_matches(']');
    address.parse::<IpAddr>().is_ok()
        || name.eq_ignore_ascii_case("localhost")
        || known.iter().any(|known| known.eq_ignore_ascii_case(name))
}

fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        // The colons of an address in brackets do not separate a port.
        Some((name, port))
            if port.bytes().all(|b| b.is_ascii_digit())
                && (!name.contains(':') || name.ends_with(']')) =>
        {
            name
        }
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use super::is_known;

    #[test]
    fn foreign_host_names_are_rejected() {
        let known = ["gateway.shop.lan".to_owned()];
        for host in [
            "127.0.0.1:8080",
            "localhost",
            "LOCALHOST:1",
            "[::1]:8080",
            "[::1]",
            "192.0.2.7",
            "gateway.shop.lan:443",
        ] {
            assert!(is_known(host, &known), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8080",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "",
            ":8080",
            "gateway",
        ] {
            assert!(!is_known(host, &known), "{host}");
        }
    }
}
