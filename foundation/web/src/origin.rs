//! Detection of cross-site requests: requests that another site sends through a user's browser without the user's
//! knowledge.

use axum::http::{HeaderMap, header};

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
    use super::*;

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
