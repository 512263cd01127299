#![doc = include_str!("../README.md")]

pub mod back;
pub mod clock;
pub mod command;
pub mod config;
mod config_page;
mod config_server;
pub mod demo;
pub mod described;
pub mod discover;
pub mod drift;
pub mod engine;
pub mod http;
pub mod ingest;
pub mod instance;
pub mod intervals;
pub mod issue;
pub mod keys;
pub mod map;
pub mod models;
mod point;
pub mod records;
pub mod registration;
pub mod rollout;
pub mod store;
pub mod users;

/// Bytes as hexadecimal digits in lower case.
pub(crate) fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string never fails.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
