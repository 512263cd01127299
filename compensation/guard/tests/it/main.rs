//! Tests of the rules of the guard.

mod barrier;
mod edges;
mod faults;
mod interlocks;
mod lines;
mod lowered;
mod position;
mod proof;
mod ramps;
mod sequences;
mod slow_ways;
mod states;
mod temperature;
mod vector;
mod world;
