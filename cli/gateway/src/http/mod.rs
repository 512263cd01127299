//! The dashboard: pages, state, events, metrics, requests.

mod hosts;
mod map;
mod routes;
mod server;
pub mod tls;
mod tokens;

pub use server::{Dashboard, serve};
pub use tokens::{Denied, Holder, Role, Tokens};
