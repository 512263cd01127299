//! Tests of the centre: its rules, its store, and end to end with a real `nats-server`.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

mod browser;
mod command;
mod discover;
mod engine;
mod gateway;
mod http;
mod ingest;
mod map;
mod rollout;
mod servers;
mod shop;
mod store;
mod support;
