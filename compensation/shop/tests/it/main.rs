//! The virtual shop: its output, its rejections, and the calibration of its output.

mod both_sides;
mod coverage;
mod example;
mod figures;
mod formats;
mod fuzz_corpus;
mod held_rotary;
mod locations;
mod messages;
mod observation_messages;
mod observations;
mod placed;
mod plans;
mod round_trip;
mod volume;
mod wear;
