//! The JSON document of `volcomp import`.

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

/// The document of `volcomp import`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Import {
    /// The format.
    pub(crate) format: String,
    /// The files that were read.
    pub(crate) files: Vec<String>,
    /// What is odd in them, and what was made of it.
    pub(crate) warnings: Vec<String>,
    /// The tables as they stand in the files, in the sign of volcomp.
    pub(crate) tables: Vec<Read>,
    /// The curves as in `[errors]` of a machine file, by the names of the errors.
    pub(crate) errors: Value,
    /// The file with the curves; only with `--output`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) output: Option<String>,
}

/// A table that was read.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Read {
    /// The axis over which it goes.
    pub(crate) input: Vec<String>,
    /// The letter of the axis that deviates, or the name of an error.
    pub(crate) output: String,
    /// The positions, mm or deg, as one list.
    pub(crate) positions: Vec<Vec<f64>>,
    /// The values after positive motion, or of both.
    pub(crate) forward: Vec<f64>,
    /// The values after negative motion; `null`: as `forward`.
    pub(crate) backward: Option<Vec<f64>>,
    /// The unit of the values: `um` or `urad`.
    pub(crate) unit: String,
    /// Whether the positions repeat with the length of the table.
    pub(crate) modulo: bool,
}
