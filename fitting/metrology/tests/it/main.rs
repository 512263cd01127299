//! Behaviour of the crate, seen from outside.

mod renishaw;
mod samples;
