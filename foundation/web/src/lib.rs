#![doc = include_str!("../README.md")]

pub mod client;
pub mod file_name;
pub mod headers;
pub mod hosts;
mod origin;
mod server;
pub mod tls;

pub use origin::is_of_another_page;
pub use server::serve;
pub use tls::{CertificateError, Tls, TlsError};

/// Script that plots curves over time, bars and maps on canvases. It uses the colours `--ink`, `--line` and `--soft` of
/// the page's style sheet.
pub const PLOT_JS: &str = include_str!("../assets/plot.js");
