//! The guard against its rules.

mod barrier;
mod direction;
mod faults;
mod follower;
mod properties;
mod selector;
mod states;
mod structured_text;
mod temperature;
mod world;
