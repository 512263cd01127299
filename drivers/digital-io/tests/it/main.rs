//! Words, wiring, coherent reading of lines, and a control behind them.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod controller;
mod guarded;
mod wiring;
mod words;
