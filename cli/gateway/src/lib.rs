#![doc = include_str!("../README.md")]

pub mod assemble;
pub mod audit;
pub mod config;
pub mod cycle;
mod document;
pub mod error;
pub mod http;
mod metrics;
pub mod model;
pub mod path;
pub mod process;
pub mod realtime;
pub mod report;
pub mod run;
pub mod service;
pub mod simulate;
pub mod status;
mod times;

/// Bytes as hexadecimal digits.
fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string never fails.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
