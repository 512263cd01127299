//! Tests of this crate from outside.

mod arcs;
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
mod offsets;
mod play;
mod polar;
mod printers;
mod random_play;
mod random_programs;
mod rows;
mod siemens;
mod straight;
mod subroutines;
mod traps;
mod unknown_places;
mod verify;
mod zeros;
