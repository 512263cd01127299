//! The machine file, the volumetric error of a machine, and its correction.
