//! Notes: what the user should read beside a result.

use core::fmt::{self, Display, Formatter};

use serde::{Serialize, Serializer};

/// How much a note matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The result could mislead.
    Warning,
    /// The result holds; this was not used, or was assumed.
    Info,
}

/// One statement beside a result: where, what, and what to do. Its [`Display`] is one sentence, and so is its JSON.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// How much it matters.
    pub severity: Severity,
    /// The file, `file:line` or the name concerned; empty where the whole result is meant.
    pub place: String,
    /// What was found and, where there is one, the limit.
    pub what: String,
    /// What to do or to check; empty where `what` says enough.
    pub hint: &'static str,
}

impl Note {
    /// A warning about a place without a hint.
    pub fn warning(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self {
            severity: Severity::Warning,
            place: place.into(),
            what: what.into(),
            hint: "",
        }
    }

    /// A remark about a place without a hint.
    pub fn info(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self {
            severity: Severity::Info,
            ..Self::warning(place, what)
        }
    }

    /// The same with what to do.
    #[must_use]
    pub fn hint(self, hint: &'static str) -> Self {
        Self { hint, ..self }
    }
}

impl Display for Note {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if !self.place.is_empty() {
            write!(f, "{}: ", self.place)?;
        }
        f.write_str(&self.what)?;
        if !self.hint.is_empty() {
            write!(f, "; {}", self.hint)?;
        }
        Ok(())
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Note {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        str::schema_name()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        str::json_schema(generator)
    }
}

impl Serialize for Note {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
