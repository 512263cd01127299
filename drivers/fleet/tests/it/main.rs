//! The fleet's documents, and its connections to a real `nats-server`.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

mod acceptance;
mod bench;
mod cluster;
mod fuzz_corpus;
mod hub;
mod permissions;
mod server_2_9;
mod spool;
