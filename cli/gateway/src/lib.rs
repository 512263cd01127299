#![doc = include_str!("../README.md")]

pub mod audit;
pub mod check;
pub mod client;
pub mod config;
pub mod devices;
pub mod differences;
pub mod documents;
pub mod error;
#[cfg(feature = "fleet")]
pub mod fleet;
pub mod history;
pub mod http;
mod identity;
pub mod interop;
mod linuxcnc;
mod lock;
pub mod machine;
pub mod metrics;
pub mod models;
mod observe;
mod online;
pub mod options;
pub mod plan;
pub mod process;
pub mod published;
pub mod rehearse;
pub mod request;
pub mod run;
pub mod send_map;
pub mod service;
pub mod signals;
pub mod simulate;
mod sinumerik;
pub mod slot;
pub mod text;
mod times;
mod toml_text;

/// Bytes as hexadecimal digits.
fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string never fails.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
