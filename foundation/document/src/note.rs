//! Notes: remarks and warnings for the user that accompany a result.

use core::fmt::{self, Display, Formatter};

use serde::{Serialize, Serializer};

/// How serious a note is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The result could mislead.
    Warning,
    /// The result is valid; something was ignored or assumed.
    Info,
}

/// A note on a result: location, statement and recommendation. [`Display`] and JSON give all of it as one sentence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// Whether the result could mislead.
    pub severity: Severity,
    /// File, `file:line` or name concerned; empty if the whole result is concerned.
    pub place: String,
    /// Statement: what was found and, if there is one, the limit.
    pub what: String,
    /// Recommendation; empty if `what` is sufficient.
    pub hint: &'static str,
}

impl Note {
    /// A warning without a hint.
    pub fn warning(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self { severity: Severity::Warning, place: place.into(), what: what.into(), hint: "" }
    }

    /// A remark without a hint.
    pub fn info(place: impl Into<String>, what: impl Into<String>) -> Self {
        Self { severity: Severity::Info, ..Self::warning(place, what) }
    }

    /// Adds a recommendation.
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
