//! The dashboard: pages, state, events, history, metrics, requests.

mod map;
mod routes;
mod shared;
mod tokens;

pub use routes::router;
pub use shared::Dashboard;
pub use tokens::{Denied, Holder, Role, Tokens};
pub use volcomp_web::{Tls, serve, tls};
