#![doc = include_str!("../README.md")]

pub mod audit;
pub mod check;
pub mod client;
pub mod config;
mod devices;
pub mod documents;
pub mod error;
#[cfg(feature = "fleet")]
pub mod fleet;
mod history;
pub mod http;
mod identity;
pub mod init;
pub mod install;
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
pub mod simulate;
pub mod token;
mod toml_text;

use std::{
    io::Write,
    sync::{Mutex, MutexGuard, PoisonError},
};

use error::GatewayError;

/// Prints to standard output; a broken pipe is ignored.
///
/// # Errors
/// Standard output cannot be written.
pub fn print(text: &str) -> Result<(), GatewayError> {
    let mut output = std::io::stdout().lock();
    match output.write_all(text.as_bytes()).and_then(|()| output.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(GatewayError::system("standard output", e))
        }
        _ => Ok(()),
    }
}

/// Locks a mutex and ignores poisoning: no thread leaves the data in an inconsistent state.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
