//! Tests of the rules of the guard.

mod barrier;
mod direction;
mod edges;
mod faults;
mod interlocks;
mod lines;
mod lowered;
mod machine;
mod position;
mod proof;
mod ramps;
mod random_limits;
mod read_back;
mod selector;
mod sequences;
mod slow_ways;
mod states;
mod temperature;
mod vector;
mod world;
