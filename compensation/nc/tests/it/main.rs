//! Tests of this crate from outside.

mod arcs;
mod average;
mod five_axes;
mod flow;
mod floyd;
mod identity;
mod inspect;
mod straight;
mod traps;
mod verify;
