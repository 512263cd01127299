//! The `volcomp-centre` command: the control centre of many machine tools.

fn main() {}
