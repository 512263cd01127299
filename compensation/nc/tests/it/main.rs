//! Tests of this crate from outside.

mod arcs;
mod flow;
mod identity;
mod straight;
