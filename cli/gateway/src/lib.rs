#![doc = include_str!("../README.md")]

pub mod audit;
pub mod check;
pub mod config;
mod devices;
pub mod differences;
pub mod documents;
pub mod error;
#[cfg(feature = "fleet")]
pub mod fleet;
pub mod http;
mod identity;
pub mod interop;
mod lock;
pub mod machine;
pub mod metrics;
pub mod models;
mod observe;
pub mod options;
pub mod plan;
pub mod published;
pub mod rehearse;
pub mod request;
pub mod run;
pub mod send_map;
pub mod service;
pub mod signals;
pub mod simulate;
pub mod slot;
pub mod status;
mod toml_text;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks a mutex and ignores poisoning: no holder leaves the data in an inconsistent state.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write;
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string never fails.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
