//! Tests of the centre: its rules by themselves, its store, and the whole against a real `nats-server`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test fails by panicking"
)]

mod command;
mod config;
mod engine;
mod gateway;
mod rollout;
mod shop;
mod store;
mod support;
