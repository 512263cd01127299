//! The web interface and its HTTP API: authorization, requests and responses. All data are read from and written to the store; the running centre
//! acts on the stored state.

mod access;
mod discovery;
mod machines;
mod models;
mod overview;
mod response;
mod rollouts;
mod routes;
mod state;
mod tables;
mod users;

pub use routes::{ROUTES, Route, router};
pub use state::{PageSettings, PageState};
