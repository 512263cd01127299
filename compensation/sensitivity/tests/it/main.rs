//! Sensitivities and formulas compared with the model, singular values and published counts.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod formula;
mod numbers;
mod published;

use std::path::Path;

use volcomp_model::Machine;

pub(crate) fn example(name: &str) -> Machine {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    Machine::read(folder.join(name)).unwrap()
}
