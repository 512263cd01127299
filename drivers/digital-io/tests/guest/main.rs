//! Lines of the kernel's simulated GPIO chips: run by `tests/guest/run` where the host's kernel has none.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]
