//! Words, wiring, coherent readings of lines, and a control on digital lines.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod controller;
mod guarded;
mod wiring;
mod words;
