//! FANUC pitch error compensation as a file of parameters: steps from point to point, in detection units.

mod read;
mod write;

pub(crate) use read::read;
pub(crate) use write::write;

/// Where the data begin: N10000 + point, from memory.
const DATA: u32 = 10_000;
