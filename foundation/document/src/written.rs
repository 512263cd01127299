//! Texts that volcomp writes: keys and values of TOML files, cells of CSV files, and notes.
//!
//! A note is a remark or a warning for the user that accompanies a result.

use core::fmt::{self, Display, Formatter};
use std::fmt::Write;

use serde::{Serialize, Serializer};

/// A text as a TOML string on one line, in quotes; also valid as a key.
pub fn toml_string(text: &str) -> String {
    let usual = toml::Value::String(text.to_owned()).to_string();
    let has_lines = ["\"\"\"", "'''"].iter().any(|mark| usual.starts_with(mark));
    if !has_lines {
        return usual;
    }
    let mut quoted = String::from("\"");
    for character in text.chars() {
        match character {
            '"' | '\\' => quoted.extend(['\\', character]),
            // Writing to a String cannot fail.
            _ if character.is_control() => {
                let _ = write!(quoted, "\\u{:04X}", u32::from(character));
            }
            _ => quoted.push(character),
        }
    }
    quoted.push('"');
    quoted
}

/// A name as a TOML key, quoted only if necessary.
pub fn toml_key(name: &str) -> String {
    let is_bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if !name.is_empty() && name.chars().all(is_bare) {
        return name.to_owned();
    }
    toml_string(name)
}

/// A text of one line as a cell of a comma-separated CSV table; quoted only if it contains a quotation mark, a
/// separator or `#`.
pub fn csv_cell(text: &str) -> String {
    if text.contains(['"', ',', ';', '\t', '#']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CsvTable;

    const ODD: [&str; 9] = [
        "plain",
        "T1, long",
        "a\"b",
        "a'b''c'''d",
        "C:\\new\\u0041",
        "µ\u{200b}\u{7f}\u{85}\u{301}",
        "two\nlines\r\tand a tab\0",
        "# 5; of 6",
        "\"\"\"",
    ];

    /// The TOML and CSV readers return the original text.
    #[test]
    fn what_is_written_is_read_back() {
        for text in ODD {
            let line = format!("{} = {}", toml_key(text), toml_string(text));
            assert_eq!(line.lines().count(), 1);
            let table: toml::Table = line.parse().expect("TOML");
            assert_eq!(table.get(text).and_then(|t| t.as_str()), Some(text));
            let text = text.replace(['\n', '\r'], " ");
            let csv = format!("x,name\n1,{}\n", csv_cell(&text));
            let table = CsvTable::parse("t.csv", &csv).expect("CSV");
            let column = table.require("name").expect("there");
            let cells: Vec<&str> = table.rows().map(|row| row.cell(column).text()).collect();
            assert_eq!(cells, [text]);
        }
        assert_eq!(toml_key("bare-key_1"), "bare-key_1");
        assert_eq!(toml_key(""), "\"\"");
    }
}
