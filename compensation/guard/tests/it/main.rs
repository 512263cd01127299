//! The guard against its rules.

mod direction;
mod faults;
mod follower;
mod properties;
mod selector;
mod states;
mod temperature;
mod world;
