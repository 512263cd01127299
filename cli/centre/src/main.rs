//! The `volcomp-centre` command.

fn main() {}
