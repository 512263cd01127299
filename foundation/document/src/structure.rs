//! Deserialises a TOML file with serde, and reports all of its errors with the location of each key.

use core::{
    fmt,
    ops::{Range, RangeInclusive},
};
use std::collections::{BTreeMap, BTreeSet};

use serde::de::DeserializeOwned;
use toml::{
    Deserializer, Spanned,
    de::{DeTable, DeValue},
};

use crate::{
    error::{InputError, LARGEST_NUMBER},
    toml_file::{Document, expected_range, meant},
};

/// Maximum number of errors that are reported. Each of them requires another pass over the file.
const MAX_MISTAKES: usize = 100;

/// All errors of a file, in the order of its lines. There is at least one.
#[derive(Clone, Debug, PartialEq)]
pub struct InputErrors(pub Vec<InputError>);

impl fmt::Display for InputErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}

impl std::error::Error for InputErrors {}

impl From<InputError> for InputErrors {
    fn from(error: InputError) -> Self {
        Self(vec![error])
    }
}

/// Full keys of a file (`controller[0].url`), each with the byte range of its value.
pub type Places = BTreeMap<String, Range<usize>>;

/// Keys of a file, and the errors found up to now.
pub struct Mistakes<'a> {
    document: &'a Document,
    places: Places,
    /// Keys whose invalid values were removed. Errors that are caused by the missing values are not reported.
    unread: BTreeSet<String>,
    found: Vec<InputError>,
}

impl Document {
    /// Deserialises the file. An invalid value is reported and removed, so that its default applies and further errors
    /// are found. For a key that no longer exists, `replaced` returns a message that names its successor.
    ///
    /// # Errors
    /// The text is not valid TOML (see [`decode`](Document::decode)), has 100 errors, or has an error without a
    /// location.
    pub fn structure<T: DeserializeOwned>(
        &self,
        replaced: impl Fn(&str) -> Option<&'static str>,
    ) -> Result<(T, Mistakes<'_>), InputErrors> {
        self.decode(|root| {
            let mut table = root.table().clone();
            let mut places = Places::new();
            collect(&table, "", &mut places);
            let (mut unread, mut found) = (BTreeSet::new(), Vec::new());
            loop {
                let spanned = Spanned::new(0..0, table.clone());
                let error = match T::deserialize(Deserializer::from(spanned)) {
                    Ok(value) => {
                        let document = self;
                        let mistakes = Mistakes { document, places, unread, found };
                        return Ok((value, mistakes));
                    }
                    Err(error) => error,
                };
                let span = error.span().unwrap_or_default();
                let wrong = take(&mut table, "", &span);
                let Some((key, value)) = wrong else {
                    return Err(self.error(0..0, String::new(), error.message()).into());
                };
                let message = match replaced(&key) {
                    Some(sentence) => sentence.to_owned(),
                    None => words(error.message(), self.text.get(span).unwrap_or_default()),
                };
                // A key that was removed because of an error is reported as missing in the next pass, so this second
                // error is dropped.
                let within = format!("{key}.");
                let is_stated = unread.iter().any(|other| other.starts_with(&within));
                if !(is_stated && error.message().starts_with("missing field")) {
                    found.push(self.error(value.span(), key.clone(), message));
                }
                unread.insert(key);
                if found.len() == MAX_MISTAKES {
                    return Err(InputErrors(found));
                }
            }
        })
    }

    /// Full keys of the file; empty if the file is not valid TOML.
    pub fn places(&self) -> Places {
        let mut places = Places::new();
        let found = self.decode(|root| {
            collect(root.table(), "", &mut places);
            Ok::<_, InputError>(())
        });
        found.map(|()| places).unwrap_or_default()
    }

    /// Error at a key or, if the file lacks the key, at the closest table above it.
    pub fn error_at(&self, places: &Places, key: &str, message: impl Into<String>) -> InputError {
        let mut above = key;
        let span = loop {
            if let Some(span) = places.get(above) {
                break span.clone();
            }
            match above.rsplit_once('.') {
                Some((table, _)) => above = table,
                None => break 0..0,
            }
        };
        self.error(span, key.to_owned(), message)
    }
}

impl Mistakes<'_> {
    /// Whether the file contains a key, with a valid or an invalid value.
    pub fn states(&self, key: &str) -> bool {
        self.places.contains_key(key)
    }

    /// Whether the file contains a key with a valid value.
    pub fn is_read(&self, key: &str) -> bool {
        self.states(key) && !self.unread.contains(key)
    }

    pub fn places(&self) -> &Places {
        &self.places
    }

    /// Adds an error at a key or table. Does nothing if an invalid value in it was already reported.
    pub fn add(&mut self, key: &str, message: impl Into<String>) {
        let within = |unread: &String| {
            let rest = unread.strip_prefix(key);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        };
        if !self.unread.iter().any(within) {
            let error = self.document.error_at(&self.places, key, message);
            self.found.push(error);
        }
    }

    /// Adds an error if a key is missing in the table `above`. An empty `above` is the root.
    pub fn require(&mut self, above: &str, key: &str) {
        let dot = if above.is_empty() { "" } else { "." };
        if !self.states(&format!("{above}{dot}{key}")) {
            let message = format!("key `{key}` is missing");
            let error = self.document.error_at(&self.places, above, message);
            self.found.push(error);
        }
    }

    /// Adds an error if a number in the file is outside `range`, which includes both ends. An infinite end is no limit.
    /// Defaults are not checked.
    pub fn range(&mut self, key: &str, found: f64, range: RangeInclusive<f64>) {
        let is_within = range.contains(&found) && found.abs() <= LARGEST_NUMBER;
        if self.states(key) && !is_within {
            let expected = if found.abs() <= LARGEST_NUMBER {
                expected_range(range)
            } else {
                "a finite number".to_owned()
            };
            self.add(key, format!("found {found}, expected {expected}"));
        }
    }

    /// Adds an error if a whole number in the file is outside `range`, which includes both ends. Defaults are not
    /// checked.
    #[expect(clippy::needless_pass_by_value, reason = "it is a number")]
    pub fn whole<N: PartialOrd + fmt::Display>(
        &mut self,
        key: &str,
        found: N,
        range: RangeInclusive<N>,
    ) {
        if self.states(key) && !range.contains(&found) {
            let (low, high) = range.into_inner();
            let message = format!("found {found}, expected a whole number from {low} to {high}");
            self.add(key, message);
        }
    }

    /// Returns the value if there are no errors.
    ///
    /// # Errors
    /// All errors, in the order of the lines.
    pub fn none_or<T>(self, value: T) -> Result<T, InputErrors> {
        let mut found = self.found;
        if found.is_empty() {
            return Ok(value);
        }
        found.sort_by_key(|error| error.line);
        Err(InputErrors(found))
    }
}

fn under(above: &str, key: &str) -> String {
    if above.is_empty() { key.to_owned() } else { format!("{above}.{key}") }
}

fn collect(table: &DeTable<'_>, above: &str, places: &mut Places) {
    for (key, value) in table {
        let key = under(above, key.get_ref());
        match value.get_ref() {
            DeValue::Table(inner) => collect(inner, &key, places),
            DeValue::Array(items) => {
                for (index, item) in items.iter().enumerate() {
                    if let DeValue::Table(inner) = item.get_ref() {
                        let key = format!("{key}[{index}]");
                        collect(inner, &key, places);
                        places.insert(key, item.span());
                    }
                }
            }
            _ => {}
        }
        places.insert(key, value.span());
    }
}

/// Removes from a table the innermost entry whose key or value contains these bytes. Returns the key of the entry, with
/// `above` in front, and its value; `None` if no entry contains the bytes.
fn take<'i>(
    table: &mut DeTable<'i>,
    above: &str,
    span: &Range<usize>,
) -> Option<(String, Spanned<DeValue<'i>>)> {
    let holds = |bytes: Range<usize>| bytes.start <= span.start && span.end <= bytes.end;
    let is_key = |key: &Spanned<_>, value: &Spanned<DeValue<'_>>| {
        holds(key.span()) || value_holds(value, &holds)
    };
    let found = table.iter().find(|(key, value)| is_key(key, value));
    let name = found?.0.clone();
    let key = under(above, name.get_ref());
    if !holds(name.span())
        && let Some(value) = table.get_mut(name.get_ref().as_ref())
    {
        let inner = match value.get_mut() {
            DeValue::Table(inner) => take(inner, &key, span),
            DeValue::Array(items) => {
                let mut items = items.iter_mut().enumerate();
                items.find_map(|(index, item)| match item.get_mut() {
                    DeValue::Table(inner) => take(inner, &format!("{key}[{index}]"), span),
                    _ => None,
                })
            }
            _ => None,
        };
        if inner.is_some() {
            return inner;
        }
    }
    let value = table.remove(name.get_ref().as_ref())?;
    Some((key, value))
}

/// Whether a value contains a byte range. The span of a table that is written in several parts covers only its first
/// header.
fn value_holds(value: &Spanned<DeValue<'_>>, holds: &impl Fn(Range<usize>) -> bool) -> bool {
    let inside = match value.get_ref() {
        DeValue::Table(inner) => {
            inner.iter().any(|(key, value)| holds(key.span()) || value_holds(value, holds))
        }
        DeValue::Array(items) => items.iter().any(|item| value_holds(item, holds)),
        _ => false,
    };
    inside || holds(value.span())
}

/// Rewrites an error message of serde in the terms of this crate. `stated` is the wrong text.
fn words(message: &str, stated: &str) -> String {
    let quoted = |text: &str| -> Vec<String> {
        let parts = text.split('`').skip(1).step_by(2);
        parts.map(str::to_owned).collect()
    };
    if message.starts_with("unknown field") {
        let names = quoted(message);
        let known: Vec<&str> = names.iter().skip(1).map(String::as_str).collect();
        let found = names.first().map_or("", String::as_str);
        return format!("unknown key, {}", meant(found, &known));
    }
    if message.starts_with("unknown variant") {
        let names = quoted(message);
        let known = names.get(1..).unwrap_or_default().join(", ");
        let found = names.first().map_or("", String::as_str);
        return format!("found \"{found}\", expected one of: {known}");
    }
    if let Some(rest) = message.strip_prefix("missing field ") {
        return format!("key {rest} is missing");
    }
    let length = message.strip_prefix("invalid length ");
    if let Some((found, expected)) =
        length.and_then(|rest| rest.split_once(", expected an array of length "))
    {
        return format!("found an array of {found}, expected an array of {expected} numbers");
    }
    let invalid = ["invalid type: ", "invalid value: ", "invalid length "]
        .iter()
        .find_map(|start| message.strip_prefix(start));
    let Some((found, expected)) = invalid.and_then(|rest| rest.rsplit_once(", expected ")) else {
        return match message {
            "invalid socket address syntax" => {
                format!("found {stated}, expected an address and port such as 127.0.0.1:8080")
            }
            _ if message.starts_with("expected") => format!("found {stated}, {message}"),
            _ => message.to_owned(),
        };
    };
    let found = match found.split_once(' ') {
        Some(("string", text)) => format!("the text {text}"),
        Some((_, number)) if number.contains('`') => quoted(number).concat(),
        None if found == "map" => "a table".to_owned(),
        None if found == "sequence" => "an array".to_owned(),
        _ => found.to_owned(),
    };
    let expected = match expected {
        "f64" => "a finite number",
        "u8" => "a whole number from 0 to 255",
        "u16" => "a whole number from 0 to 65535",
        "u32" | "u64" | "usize" => "a whole number of 0 or more",
        "a string" | "path string" => "a text in quotes",
        "a boolean" => "true or false",
        "a sequence" => "an array",
        "an array of length 2" => "an array of 2 numbers",
        other if other == "a map" || other.starts_with("struct ") => "a table",
        other => other,
    };
    format!("found {found}, expected {expected}")
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Default, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct File {
        limit_um: f64,
        count: u16,
        word: Word,
        range: [f64; 2],
        names: Vec<String>,
        listen: Option<core::net::SocketAddr>,
        part: Vec<Part>,
        byte: Option<Byte>,
    }

    #[derive(Debug, Default, PartialEq, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Word {
        #[default]
        Binary,
        GrayCode,
    }

    #[derive(Debug, Default, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct Part {
        on: bool,
        inner: Option<Byte>,
    }

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Byte {
        at: u16,
    }

    fn read(text: &str) -> Result<File, String> {
        let document = Document::new("F", text);
        let replaced = |key: &str| (key == "old").then_some("found old, expected limit_um");
        document
            .structure(replaced)
            .and_then(|(file, mistakes)| mistakes.none_or(file))
            .map_err(|errors| errors.to_string())
    }

    /// Each of the mistakes is reported with its line and key, and with the found and the expected value.
    #[test]
    fn every_mistake_is_reported() {
        let text = "limit_um = \"much\"\ncount = -1\nword = \"grey\"\nrange = [1.0]\nnames = [1]\nlisten = \"here\"\nold = 3\nlimit = 2\n[[part]]\non = true\n[[part]]\non = 1\nof = 2\n[part.inner]\n[byte]\nat = 70000\n";
        let expected = "F:1: limit_um: found the text \"much\", expected a finite number
F:2: count: found -1, expected a whole number from 0 to 65535
F:3: word: found \"grey\", expected one of: binary, gray-code
F:4: range: found an array of 1, expected an array of 2 numbers
F:5: names: found 1, expected a text in quotes
F:6: listen: found \"here\", expected an address and port such as 127.0.0.1:8080
F:7: old: found old, expected limit_um
F:8: limit: unknown key, did you mean `limit_um`?
F:12: part[1].on: found 1, expected true or false
F:13: part[1].of: unknown key, did you mean `on`?
F:14: part[1].inner: key `at` is missing
F:16: byte.at: found 70000, expected a whole number from 0 to 65535";
        assert_eq!(read(text), Err(expected.to_owned()));
    }

    #[test]
    fn what_fits_is_read() {
        let file =
            read("limit_um = 3\nrange = [1, 2.5]\nword = \"gray-code\"\npart = [{ on = true }]\n");
        let expected = File {
            limit_um: 3.0,
            range: [1.0, 2.5],
            word: Word::GrayCode,
            part: vec![Part { on: true, inner: None }],
            ..File::default()
        };
        assert_eq!(file, Ok(expected));
    }

    /// A rule about a key whose value was already rejected reports nothing. Rules about other keys are reported.
    #[test]
    fn rules_are_reported_beside_mistakes() {
        let document = Document::new("F", "limit_um = \"much\"\ncount = 9\n[[part]]\non = true\n");
        let (file, mut mistakes) = document.structure::<File>(|_| None).expect("TOML");
        mistakes.range("limit_um", file.limit_um, 1.0..=2.0);
        mistakes.whole("count", file.count, 0..=8);
        mistakes.require("", "limit_um");
        mistakes.require("", "names");
        mistakes.require("part[0]", "inner");
        mistakes.add("part[0].inner", "of no use");
        let found = mistakes.none_or(()).expect_err("wrong").to_string();
        let expected = "F:1: limit_um: found the text \"much\", expected a finite number
F:1: key `names` is missing
F:2: count: found 9, expected a whole number from 0 to 8
F:3: part[0]: key `inner` is missing
F:3: part[0].inner: of no use";
        assert_eq!(found, expected);
    }

    /// Deserialisation restarts after each mistake, but reading a file with very many mistakes must end in reasonable
    /// time.
    #[test]
    fn a_file_full_of_mistakes_ends() {
        let lines: Vec<String> = (0..5000).map(|n| format!("k{n} = 1")).collect();
        let document = Document::new("F", &lines.join("\n"));
        let found = document.structure::<File>(|_| None).err().expect("wrong");
        assert_eq!(found.0.len(), MAX_MISTAKES);
    }
}
