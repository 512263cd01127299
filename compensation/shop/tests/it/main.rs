//! The virtual shop: its output, its rejections, and the calibration of its output.

mod both_sides;
mod coverage;
mod figures;
mod formats;
mod held_rotary;
mod locations;
mod messages;
mod observation_messages;
mod observations;
mod round_trip;
mod wear;
