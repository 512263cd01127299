//! Tests of this crate from outside.

mod identity;
mod straight;
