//! The words, the wiring, reading lines that switch one after the other, and a control behind them.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod controller;
mod guarded;
mod serialised;
mod wiring;
mod words;
