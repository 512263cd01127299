//! The JSON documents of `volcomp compile` and `volcomp completions`.

use schemars::JsonSchema;
use serde::Serialize;

/// The document of `volcomp compile`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Compile {
    /// The file that was written.
    pub(crate) file: String,
    /// The size of the file, bytes.
    pub(crate) bytes: usize,
    /// Version of the format.
    pub(crate) version: u32,
    /// SHA-256 of the machine, as it stands in the head of the file: hexadecimal digits.
    pub(crate) sha256: String,
    /// How far a compiled curve may be from its source, nm for displacements and nrad for rotations.
    pub(crate) tolerance_nm: f64,
    /// How many cubic pieces the curves have.
    pub(crate) pieces: usize,
}

/// The document of `volcomp completions`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Completions {
    /// The shell for which the script is.
    pub(crate) shell: String,
    /// The script that the shell reads.
    pub(crate) script: String,
}
