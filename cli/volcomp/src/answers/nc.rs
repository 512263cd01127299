//! The JSON document of `volcomp nc`.

use schemars::JsonSchema;
use serde::Serialize;

/// The document of `volcomp nc`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Nc {
    /// The file that was written.
    pub(crate) file: String,
    /// Lines of the program that were read.
    pub(crate) lines: u64,
    /// Motions in them.
    pub(crate) motions: u64,
    /// Lines that were changed.
    pub(crate) changed: u64,
    /// Lines that were added, since a motion was split.
    pub(crate) added: u64,
    /// Whether the program says where it ends (M2, M30 or a second percent sign).
    pub(crate) ended: bool,
    /// What a user should know of the program, each once.
    pub(crate) notes: Vec<NcNote>,
}

/// A note on a program.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct NcNote {
    /// The line at which it was met first, counted from 1.
    pub(crate) line: usize,
    /// What it says.
    pub(crate) text: String,
}
