#![doc = include_str!("../README.md")]

pub mod assemble;
pub mod audit;
pub mod config;
pub mod cycle;
mod document;
pub mod error;
pub mod http;
mod metrics;
pub mod model;
pub mod realtime;
pub mod report;
pub mod run;
pub mod service;
pub mod simulate;
pub mod status;
mod times;
