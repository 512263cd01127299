#![doc = include_str!("../README.md")]

pub mod client;
pub mod file_name;
pub mod hosts;
mod server;
pub mod tls;

pub use hosts::is_of_another_page;
pub use server::serve;
pub use tls::{CertificateError, Tls, TlsError};

/// Script that plots curves over time, bars and maps on canvases. It uses the colours `--ink`, `--line` and `--soft` of
/// the page's style sheet.
pub const PLOT_JS: &str = include_str!("../assets/plot.js");

/// Security headers of every response.
pub mod headers {
    use axum::http::{HeaderMap, HeaderValue, header};

    /// Adds the security headers to a response. A page then loads only resources from its origin, cannot be framed, submits
    /// no forms, sends no referrer, and is not cached.
    pub fn put(headers: &mut HeaderMap) {
        for (name, value) in [
            (
                header::CONTENT_SECURITY_POLICY,
                "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
            ),
            (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
            (header::X_FRAME_OPTIONS, "DENY"),
            (header::REFERRER_POLICY, "no-referrer"),
            (header::CACHE_CONTROL, "no-store"),
        ] {
            headers.insert(name, HeaderValue::from_static(value));
        }
    }
}
