//! The dashboard: pages, state, events, history, metrics, requests.

mod hosts;
mod map;
mod routes;
mod server;
mod shared;
pub mod tls;
mod tokens;

pub use server::serve;
pub use shared::Dashboard;
pub use tls::Tls;
pub use tokens::{Denied, Holder, Role, Tokens};
