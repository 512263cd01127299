//! The page of the centre and its interface: who may ask what, and what is answered. Everything is read from the store and
//! written into it; the running centre acts on what stands there.

mod answer;
mod discovery;
mod machines;
mod models;
mod overview;
mod people;
mod rollouts;
mod routes;
mod state;
mod tables;
mod who;

pub use routes::{ROUTES, Route, router};
pub use state::{PageSettings, PageState};
