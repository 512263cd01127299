//! The dashboard: pages, state, events, history, metrics, requests.

mod door;
mod map;
mod model;
mod routes;
mod server;
mod shared;
mod tokens;

pub use routes::router;
pub(crate) use server::{listen, runtime};
pub use shared::{Dashboard, Door};
pub use tokens::{Denied, Holder, Role, Tokens};
pub use volcomp_web::{Tls, serve, tls};
