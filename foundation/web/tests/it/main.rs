//! Tests of the crate's public face.

mod asked;
mod served;
