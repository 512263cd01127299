//! Serde support: a machine as the text of its machine file.

use crate::{error::ModelError, machine::Machine};

impl From<Machine> for String {
    fn from(machine: Machine) -> Self {
        machine.to_toml()
    }
}

impl TryFrom<String> for Machine {
    type Error = ModelError;

    fn try_from(text: String) -> Result<Self, ModelError> {
        Self::parse(&text, "machine")
    }
}
