//! Tests of the crate's public face.

mod deadline;
mod served;
