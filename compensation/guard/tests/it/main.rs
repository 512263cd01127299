//! The guard against its rules.

mod barrier;
mod direction;
mod edges;
mod faults;
mod interlocks;
mod proof;
mod properties;
mod selector;
mod states;
mod structured_text;
mod temperature;
mod vector;
mod world;
