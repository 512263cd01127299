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

/// Script that plots curves over time, bars and maps on canvases, in the colours `--ink`, `--line` and `--soft` of the style sheet of the page.
pub const PLOT_JS: &str = include_str!("../assets/plot.js");
