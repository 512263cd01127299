//! The JSON document on standard error when a call with `--json` fails.

use schemars::JsonSchema;
use serde::Serialize;

/// The document on standard error of a call with `--json` that fails.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Document {
    pub(crate) error: Error,
}

/// Why the program stopped. Keys that do not apply are not there.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Error {
    pub(crate) kind: Kind,
    /// The message: the value that was found and the one that was expected, in one text.
    pub(crate) message: String,
    /// The file in which something is wrong.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) file: Option<String>,
    /// The line in that file, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) line: Option<u64>,
    /// The key or column in that file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) key: Option<String>,
}

/// Whose fault it is, as in the exit status.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Kind {
    /// The command line itself is wrong: exit status 2.
    Call,
    /// An option's value or a file is wrong: exit status 2.
    Input,
    /// The work failed: exit status 1.
    Work,
}
