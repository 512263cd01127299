//! Notes: remarks and warnings for the user that accompany a result.

use core::fmt::{self, Display, Formatter};

use serde::{Serialize, Serializer};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The result could mislead.
    Warning,
    /// The result is valid, but something was ignored or assumed.
    Info,
}

/// A note about a result, with location, statement and recommendation. [`Display`] and JSON combine them into one
/// sentence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    pub severity: Severity,
    /// File, `file:line` or name to which the note refers; empty if it refers to the whole result.
    pub place: String,
    /// Statement of what was found and, if there is one, of the limit.
    pub what: String,
    /// Recommendation; empty if `what` is sufficient.
    pub hint: &'static str,
}

impl Note {
    pub fn warning(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self { severity: Severity::Warning, place: place.into(), what: what.into(), hint: "" }
    }

    pub fn info(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self { severity: Severity::Info, ..Self::warning(place, what) }
    }

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
