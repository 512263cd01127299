pub(crate) mod contradictions;
pub(crate) mod lines;
pub(crate) mod result;
