//! The comparisons of `volcomp demo`: measured lines before and after, the floor, kinds of curve.

pub(crate) mod irregular;
pub(crate) mod lines;
pub(crate) mod published;
