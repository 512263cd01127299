//! The page of the centre and its interface: who may ask what, and what is answered. Everything is read from the store and
//! written into it; the running centre acts on what stands there.

mod ages;
mod answer;
mod calls;
mod change;
mod discovery;
mod face;
mod machines;
mod models;
mod overview;
mod people;
mod routes;
mod tables;
mod who;

pub use face::{Face, FaceSettings};
pub use routes::{Need, ROUTES, Route, router};
