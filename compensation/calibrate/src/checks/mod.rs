//! Checks of the input before the fit, and of its result.

pub(crate) mod contradictions;
pub(crate) mod lines;
pub(crate) mod result;
