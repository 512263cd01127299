//! Tests of the public interface of the crate.
#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

mod bad_input;
mod bounds;
mod checks;
mod circular;
mod csv;
mod diagonals;
mod form;
mod form_peer;
mod form_refused;
mod form_revolved;
mod fuzz_corpus;
mod geometry;
mod incomplete_runs;
mod iso230_2;
mod mapped;
mod other_lasers;
mod properties;
mod renishaw;
mod samples;
mod standards;
mod straight_lines;
mod wide;
