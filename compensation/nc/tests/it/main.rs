//! Tests of this crate from outside.

mod average;
mod bounds;
mod controls;
mod fast_path;
mod files;
mod five_axes;
mod flow;
mod floyd;
mod heidenhain;
mod identity;
mod inspect;
mod motions;
mod offsets;
mod play;
mod polar;
mod printers;
mod random_play;
mod random_programs;
mod rows;
mod siemens;
mod traps;
mod unknown_places;
mod verify;
