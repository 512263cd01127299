//! The guard against its rules.

mod adv6;
mod barrier;
mod direction;
mod edges;
mod faults;
mod interlocks;
mod lines;
mod lowered;
mod machine;
mod proof;
mod properties;
mod ramps;
mod read_back;
mod selector;
mod sequences;
mod states;
mod structured_text;
mod temperature;
mod vector;
mod world;
