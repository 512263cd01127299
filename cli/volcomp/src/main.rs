//! The `volcomp` command.
fn main() {}
