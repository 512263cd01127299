//! End-to-end tests of volcomp.
