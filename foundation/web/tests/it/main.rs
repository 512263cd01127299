//! Tests of the public interface of the crate.

mod deadline;
mod served;
