//! Decides which requests of a browser a program accepts.
//!
//! Only known host names are accepted. This prevents DNS rebinding, an attack in which another site makes its own name
//! resolve to the address of this program. [`is_of_another_page`] detects requests that another site sends through the
//! browser without the knowledge of the user.

use std::{net::IpAddr, time::Duration};

use axum::{
    extract::Request,
    http::{HeaderMap, StatusCode, header},
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
        // An IPv6 address in brackets contains colons that do not separate a port.
        Some((name, port))
            if port.bytes().all(|b| b.is_ascii_digit())
                && (!name.contains(':') || name.ends_with(']')) =>
        {
            name
        }
        _ => host,
    }
}

/// Whether a request comes from a page of an origin other than the requested host. The headers `Origin` and
/// `Sec-Fetch-Site` show this; only browsers send them.
pub fn is_of_another_page(headers: &HeaderMap) -> bool {
    let text = |name: &str| headers.get(name).map(|value| value.to_str().unwrap_or(""));
    let host = text(header::HOST.as_str()).unwrap_or("");
    let is_foreign = |origin: &str| {
        let at = origin.strip_prefix("https://");
        let at = at.or_else(|| origin.strip_prefix("http://"));
        !at.is_some_and(|at| at.eq_ignore_ascii_case(host))
    };
    text(header::ORIGIN.as_str()).is_some_and(is_foreign)
        || text("sec-fetch-site").is_some_and(|site| !matches!(site, "same-origin" | "none"))
}

#[cfg(test)]
mod tests {
    use super::{is_known, *};

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

    #[test]
    fn only_the_own_origin_is_accepted() {
        let host = ("host", "mill.lan:8080");
        for (said, is_another) in [
            (&[host][..], false),
            (&[host, ("origin", "http://mill.lan:8080")], false),
            (&[host, ("origin", "https://MILL.lan:8080")], false),
            (&[host, ("origin", "http://mill.lan")], true),
            (&[host, ("origin", "http://evil.example/mill.lan:8080")], true),
            (&[host, ("origin", "ftp://mill.lan:8080")], true),
            (&[host, ("origin", "null")], true),
            (&[host, ("origin", "")], true),
            (&[("origin", "http://mill.lan:8080")], true),
            (&[host, ("sec-fetch-site", "same-origin")], false),
            (&[host, ("sec-fetch-site", "none")], false),
            (&[host, ("sec-fetch-site", "same-site")], true),
            (&[host, ("sec-fetch-site", "cross-site")], true),
            (&[host, ("origin", "http://mill.lan:8080"), ("sec-fetch-site", "cross-site")], true),
        ] {
            let mut headers = HeaderMap::new();
            for (name, value) in said {
                headers.insert(*name, value.parse().expect("a header"));
            }
            assert_eq!(is_of_another_page(&headers), is_another, "{said:?}");
        }
    }
}
