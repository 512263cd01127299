//! Tests of the public interface of the crate.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

mod bad_input;
mod bounds;
mod checks;
mod circular;
mod form;
mod geometry;
mod incomplete_runs;
mod lasers;
mod mapped;
mod properties;
mod samples;
mod standards;
mod tables;
