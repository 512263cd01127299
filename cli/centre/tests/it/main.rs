//! Tests of the centre: its rules by themselves, its store, and the whole against a real `nats-server`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test fails by panicking"
)]

mod browser;
mod command;
mod config;
mod demo;
mod discover;
mod engine;
mod engine_killed;
mod engine_together;
mod engine_watching;
mod gateway;
mod http;
mod ingest;
mod map;
mod page;
mod rollout;
mod servers;
mod shop;
mod store;
mod support;
mod told;
mod withdrawn;
