//! Parsed TOML file: tables and values that record their location, with functions that look up and check values.
//!
//! Also distinguishes the kinds of file, and explains syntax errors.

use core::{
    fmt::Display,
    ops::{Range, RangeInclusive},
};
use std::sync::Arc;

use toml::{
    Spanned,
    de::{DeTable, DeValue},
};
use toml_parser::lexer::TokenKind;

use crate::error::{InputError, bounded, near};

/// TOML text with the name of its file.
#[derive(Clone, Debug)]
pub struct Document {
    name: String,
    pub(crate) text: Arc<str>,
}

/// Table of a document and its full key.
#[derive(Clone)]
pub struct Section<'a> {
    document: &'a Document,
    key: String,
    span: Range<usize>,
    table: &'a DeTable<'a>,
}

/// Value of a document and its full key.
#[derive(Clone)]
pub struct Value<'a> {
    document: &'a Document,
    key: String,
    node: &'a Spanned<DeValue<'a>>,
}

/// Maximum size of a TOML file, bytes. On invalid text the parser allocates about fifty times the size of the file;
/// this limit keeps a program that corrects a machine from running out of memory.
pub(crate) const MOST_BYTES: usize = 4 * 1024 * 1024;

/// Maximum number of keys and table headers, where each part of a dotted key or header counts. Each part becomes a
/// table or a value of some hundred bytes; without this limit a file of 4 MiB takes 2 GB of memory.
const MOST_KEYS: usize = 100_000;

/// Number of keys and table headers in a TOML text. Each part of a dotted key or header counts; numbers in arrays do
/// not.
fn key_count(text: &str) -> usize {
    let (mut keys, mut parts, mut is_header, mut is_first) = (0, 1, false, true);
    for token in toml_parser::Source::new(text).lex() {
        match token.kind() {
            TokenKind::Whitespace | TokenKind::Comment => continue,
            TokenKind::Dot => parts += 1,
            TokenKind::Equals => {
                keys += parts;
                parts = 1;
            }
            TokenKind::RightSquareBracket if is_header => {
                keys += parts;
                (parts, is_header) = (1, false);
            }
            TokenKind::Newline => {
                (parts, is_header, is_first) = (1, false, true);
                continue;
            }
            TokenKind::LeftSquareBracket => {
                (parts, is_header) = (1, is_first || is_header);
            }
            TokenKind::Comma => (parts, is_header) = (1, false),
            TokenKind::RightSquareBracket
            | TokenKind::LeftCurlyBracket
            | TokenKind::RightCurlyBracket => parts = 1,
            _ => {}
        }
        is_first = false;
    }
    keys
}

impl Document {
    /// Builds a document from the text of `file`.
    pub fn new(file: &str, text: &str) -> Self {
        Self { name: file.to_owned(), text: text.into() }
    }

    /// Parses the text and calls `decode` with its root table.
    ///
    /// # Errors
    /// The text is larger than 4 MiB, has more than 100 000 keys, or is not valid TOML (repeated keys included); errors
    /// of `decode`.
    pub fn decode<T, E: From<InputError>>(
        &self,
        decode: impl FnOnce(Section<'_>) -> Result<T, E>,
    ) -> Result<T, E> {
        if self.text.len() > MOST_BYTES {
            let message = "found a file of more than 4 MiB, expected a TOML file of 4 MiB at most";
            return Err(self.error(0..0, String::new(), message).into());
        }
        if key_count(&self.text) > MOST_KEYS {
            let message = format!("found more than {MOST_KEYS} keys, expected {MOST_KEYS} at most");
            return Err(self.error(0..0, String::new(), message).into());
        }
        let root = DeTable::parse(&self.text).map_err(|e| {
            let span = e.span().unwrap_or(0..0);
            let message = message(&self.text, &span, e.message());
            self.error(span, String::new(), message)
        })?;
        decode(Section {
            document: self,
            key: String::new(),
            span: root.span(),
            table: root.get_ref(),
        })
    }

    pub(crate) fn error(
        &self,
        span: Range<usize>,
        key: String,
        message: impl Into<String>,
    ) -> InputError {
        let before = self.text.as_bytes().iter().take(span.start);
        InputError {
            file: self.name.clone(),
            line: 1 + before.filter(|&&byte| byte == b'\n').count(),
            key,
            message: message.into(),
            span,
            text: self.text.clone(),
        }
    }
}

const MEANT: usize = 4;

/// Suggestions for an unknown word: up to four similar words of `expected`, or all words of `expected` if none is
/// similar.
pub(crate) fn meant(found: &str, expected: &[&str]) -> String {
    let near = near(found, expected);
    let near: Vec<String> = (near.iter().take(MEANT)).map(|word| format!("`{word}`")).collect();
    match &near[..] {
        [] => format!("expected one of: {}", expected.join(", ")),
        [one] => format!("did you mean {one}?"),
        [first @ .., last] => format!("did you mean {} or {last}?", first.join(", ")),
    }
}

impl<'a> Section<'a> {
    pub(crate) fn table(&self) -> &'a DeTable<'a> {
        self.table
    }

    /// Full key of this table; empty for the root table.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Error with this message, located at the line and key of this table.
    pub fn error(&self, message: impl Into<String>) -> InputError {
        self.document.error(self.span.clone(), self.key.clone(), message)
    }

    /// Rejects unknown keys.
    ///
    /// # Errors
    /// An unknown key: names the first one, with similar expected keys or, if none is similar, all expected keys.
    pub fn allow(&self, expected: &[&str]) -> Result<(), InputError> {
        for (key, value) in self.values() {
            if !expected.contains(&key) {
                return Err(value.error(format!("unknown key, {}", meant(key, expected))));
            }
        }
        Ok(())
    }

    /// All keys with their values, sorted by key.
    pub fn values(&self) -> impl Iterator<Item = (&'a str, Value<'a>)> + '_ {
        self.table
            .iter()
            .map(|(key, value)| (key.get_ref().as_ref(), self.value(key.get_ref(), value)))
    }

    /// Value of a key, if present.
    pub fn get(&self, key: &str) -> Option<Value<'a>> {
        self.table.get(key).map(|value| self.value(key, value))
    }

    /// Value of a key that must be present.
    ///
    /// # Errors
    /// The key is missing.
    pub fn require(&self, key: &str) -> Result<Value<'a>, InputError> {
        self.get(key).ok_or_else(|| self.error(format!("key `{key}` is missing")))
    }

    /// Table of a key, if present.
    ///
    /// # Errors
    /// The value is not a table.
    pub fn section(&self, key: &str) -> Result<Option<Section<'a>>, InputError> {
        self.get(key).map(|value| value.section()).transpose()
    }

    fn value(&self, key: &str, value: &'a Spanned<DeValue<'a>>) -> Value<'a> {
        let dot = if self.key.is_empty() { "" } else { "." };
        Value { document: self.document, key: format!("{}{dot}{key}", self.key), node: value }
    }
}

impl<'a> Value<'a> {
    /// Full key: the keys of the enclosing tables and of this value, separated by dots.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Error with this message, located at the line and key of this value.
    pub fn error(&self, message: impl Into<String>) -> InputError {
        self.document.error(self.node.span(), self.key.clone(), message)
    }

    fn mismatch(&self, expected: &str) -> InputError {
        let found = match self.node.get_ref() {
            DeValue::String(text) => format!("the text \"{text}\""),
            DeValue::Integer(number) => number.as_str().to_owned(),
            DeValue::Float(number) => number.as_str().to_owned(),
            DeValue::Boolean(truth) => truth.to_string(),
            DeValue::Datetime(_) => "a date".to_owned(),
            DeValue::Array(items) => format!("an array of {}", items.len()),
            DeValue::Table(_) => "a table".to_owned(),
        };
        self.error(format!("found {found}, expected {expected}"))
    }

    /// A finite number from −1e15 to 1e15 ([`LARGEST_NUMBER`](crate::LARGEST_NUMBER)); integers are accepted.
    ///
    /// # Errors
    /// The value is not a number, is `nan` or `inf`, or is outside the bounds.
    pub fn number(&self) -> Result<f64, InputError> {
        let number = match self.node.get_ref() {
            DeValue::Float(number) => number.as_str().parse::<f64>().ok(),
            DeValue::Integer(number) => i64::from_str_radix(number.as_str(), number.radix())
                .ok()
                .map(|integer| integer as f64),
            _ => None,
        };
        bounded(number).map_err(|expected| self.mismatch(expected))
    }

    /// Whether the value is an integer or a float.
    pub fn is_number(&self) -> bool {
        matches!(self.node.get_ref(), DeValue::Float(_) | DeValue::Integer(_))
    }

    /// A whole number within `range`, including both ends.
    ///
    /// # Errors
    /// The value is not a whole number or is outside `range`; the message states the range.
    pub fn whole<N>(&self, range: RangeInclusive<N>) -> Result<N, InputError>
    where
        N: TryFrom<i128> + PartialOrd + Display,
    {
        let found = match self.node.get_ref() {
            DeValue::Integer(number) => i128::from_str_radix(number.as_str(), number.radix()).ok(),
            _ => None,
        };
        found
            .and_then(|found| N::try_from(found).ok())
            .filter(|found| range.contains(found))
            .ok_or_else(|| {
                let (low, high) = (range.start(), range.end());
                self.mismatch(&format!("a whole number from {low} to {high}"))
            })
    }

    /// A whole number from 0 to `most`.
    ///
    /// # Errors
    /// The value is not a whole number or is outside these bounds.
    pub fn count(&self, most: usize) -> Result<usize, InputError> {
        self.whole(0..=most)
    }

    /// The value as text.
    ///
    /// # Errors
    /// The value is not a text.
    pub fn text(&self) -> Result<&'a str, InputError> {
        match self.node.get_ref() {
            DeValue::String(text) => Ok(text),
            _ => Err(self.mismatch("a text in quotes")),
        }
    }

    /// The value as `true` or `false`.
    ///
    /// # Errors
    /// The value is not `true` or `false`.
    pub fn truth(&self) -> Result<bool, InputError> {
        match self.node.get_ref() {
            DeValue::Boolean(truth) => Ok(*truth),
            _ => Err(self.mismatch("true or false")),
        }
    }

    /// The value as a table.
    ///
    /// # Errors
    /// The value is not a table.
    pub fn section(&self) -> Result<Section<'a>, InputError> {
        match self.node.get_ref() {
            DeValue::Table(table) => Ok(Section {
                document: self.document,
                key: self.key.clone(),
                span: self.node.span(),
                table,
            }),
            _ => Err(self.mismatch("a table")),
        }
    }

    /// Items of an array.
    ///
    /// # Errors
    /// The value is not an array.
    pub fn items(&self) -> Result<Vec<Value<'a>>, InputError> {
        let DeValue::Array(items) = self.node.get_ref() else {
            return Err(self.mismatch("an array"));
        };
        let item = |(index, value): (usize, &'a Spanned<DeValue<'a>>)| Value {
            document: self.document,
            key: format!("{}[{index}]", self.key),
            node: value,
        };
        Ok(items.iter().enumerate().map(item).collect())
    }

    /// An array of numbers, each as for [`Value::number`].
    ///
    /// # Errors
    /// The value is not an array, or an item is rejected by [`Value::number`].
    pub fn numbers(&self) -> Result<Vec<f64>, InputError> {
        self.items()?.iter().map(Value::number).collect()
    }

    /// An array of exactly `N` numbers, each as for [`Value::number`].
    ///
    /// # Errors
    /// The value is not an array of `N` items, or an item is rejected by [`Value::number`].
    pub fn vector<const N: usize>(&self) -> Result<[f64; N], InputError> {
        let numbers = self.numbers()?;
        <[f64; N]>::try_from(numbers).map_err(|numbers| {
            // A number with a decimal comma is parsed as two numbers.
            let hint = if numbers.len() == 2 * N {
                "; a number has a decimal point, a comma separates numbers"
            } else {
                ""
            };
            self.mismatch(&format!("an array of {N} numbers{hint}"))
        })
    }

    /// An array of texts.
    ///
    /// # Errors
    /// The value is not an array, or an item is not a text.
    pub fn texts(&self) -> Result<Vec<&'a str>, InputError> {
        self.items()?.iter().map(Value::text).collect()
    }
}

/// Describes an expected range. An infinite end is no limit.
pub(crate) fn expected_range(range: RangeInclusive<f64>) -> String {
    let (low, high) = range.into_inner();
    match (low.is_finite(), high.is_finite()) {
        (true, false) => format!("a number of {low} or more"),
        (false, true) => format!("a number of {high} or less"),
        _ => format!("a number from {low} to {high}"),
    }
}

impl<'a> Section<'a> {
    /// Value that `decode` returns for a key; `None` if the key is missing.
    ///
    /// # Errors
    /// The errors of `decode`.
    pub fn optional<T, E>(
        &self,
        key: &str,
        decode: impl FnOnce(&Value<'a>) -> Result<T, E>,
    ) -> Result<Option<T>, E> {
        self.get(key).map(|value| decode(&value)).transpose()
    }

    /// Number within `range`, or `default` if the key is missing. The default may be outside the range.
    ///
    /// # Errors
    /// The value is not a number within the range.
    pub fn number_or(
        &self,
        key: &str,
        range: RangeInclusive<f64>,
        default: f64,
    ) -> Result<f64, InputError> {
        Ok(self.optional(key, |value| value.number_in(range))?.unwrap_or(default))
    }

    /// Whole number within `range`, or `default` if the key is missing. The default may be outside the range.
    ///
    /// # Errors
    /// The value is not a whole number within the range.
    pub fn whole_or<N>(
        &self,
        key: &str,
        range: RangeInclusive<N>,
        default: N,
    ) -> Result<N, InputError>
    where
        N: TryFrom<i128> + PartialOrd + Display,
    {
        Ok(self.optional(key, |value| value.whole(range))?.unwrap_or(default))
    }

    /// `true` or `false`, or `default` if the key is missing.
    ///
    /// # Errors
    /// The value is neither `true` nor `false`.
    pub fn truth_or(&self, key: &str, default: bool) -> Result<bool, InputError> {
        Ok(self.optional(key, Value::truth)?.unwrap_or(default))
    }

    /// The value must be one of the words. Returns the second element of the pair with this word, or `default` if the
    /// key is missing.
    ///
    /// # Errors
    /// The value of the key is not one of the words.
    pub fn one_of<T: Clone>(
        &self,
        key: &str,
        words: &[(&str, T)],
        default: T,
    ) -> Result<T, InputError> {
        Ok(self.optional(key, |value| value.one_of(words))?.unwrap_or(default))
    }

    /// Decodes all tables of an array of tables (`[[key]]`) in order. Returns an empty list if the key is missing.
    ///
    /// # Errors
    /// The value is not an array of tables, or an error of `decode`.
    pub fn tables<T, E: From<InputError>>(
        &self,
        key: &str,
        mut decode: impl FnMut(&Section<'a>) -> Result<T, E>,
    ) -> Result<Vec<T>, E> {
        let Some(value) = self.get(key) else {
            return Ok(Vec::new());
        };
        let mut decoded = Vec::new();
        for item in value.items()? {
            decoded.push(decode(&item.section()?)?);
        }
        Ok(decoded)
    }
}

impl Value<'_> {
    /// Number within `range`, including both ends. An infinite end is no limit.
    ///
    /// # Errors
    /// The value is not a number within the range. The message states the range.
    pub fn number_in(&self, range: RangeInclusive<f64>) -> Result<f64, InputError> {
        let found = self.number()?;
        if range.contains(&found) {
            return Ok(found);
        }
        let expected = expected_range(range);
        Err(self.error(format!("found {found}, expected {expected}")))
    }

    /// Finite number above 0.
    ///
    /// # Errors
    /// The value is not a finite number above 0.
    pub fn positive(&self) -> Result<f64, InputError> {
        let found = self.number()?;
        if found > 0.0 {
            return Ok(found);
        }
        Err(self.error(format!("found {found}, expected a number above 0")))
    }

    /// The text must be one of the words. Returns the second element of the pair with this word.
    ///
    /// # Errors
    /// The text is not one of the words. The message lists the words.
    pub fn one_of<T: Clone>(&self, words: &[(&str, T)]) -> Result<T, InputError> {
        let found = self.text()?;
        if let Some((_, meaning)) = words.iter().find(|(word, _)| *word == found) {
            return Ok(meaning.clone());
        }
        let known: Vec<&str> = words.iter().map(|(word, _)| *word).collect();
        let known = known.join(", ");
        Err(self.error(format!("found \"{found}\", expected one of: {known}")))
    }
}

/// Kind of TOML file. Each kind has some keys that no other kind has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// Geometry and errors of a machine.
    Machine,
    /// Measurement files of a machine, and the set-up of each measurement.
    Calibration,
    /// Volumetric observations, and the unknowns to estimate from them.
    Observations,
    /// Virtual shop, which is a machine and the instruments that measure it.
    Shop,
    /// Configuration of the gateway.
    Gateway,
    /// Registers of a Modbus module.
    Profile,
}

impl FileKind {
    const ALL: [Self; 6] = [
        Self::Machine,
        Self::Calibration,
        Self::Observations,
        Self::Shop,
        Self::Gateway,
        Self::Profile,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Machine => "a machine file",
            Self::Calibration => "a calibration file",
            Self::Observations => "a file of observations",
            Self::Shop => "a shop file",
            Self::Gateway => "a configuration of the gateway",
            Self::Profile => "a profile of a Modbus module",
        }
    }

    fn own_keys(self) -> &'static [&'static str] {
        match self {
            Self::Machine => &["structure", "type", "axes", "errors", "assembly", "thermal"],
            Self::Calibration => &["reference", "reference_axes", "uncertainty"],
            Self::Observations => &["unknown", "observation", "folds"],
            Self::Shop => &["instrument", "seed", "format"],
            Self::Gateway => &["controller", "thermometer", "guard", "cycle_ms", "audit"],
            Self::Profile => &["channels", "digital", "baud"],
        }
    }
}

impl Section<'_> {
    /// Rejects every root key except the expected keys. If the file has a key that is specific to another kind of file,
    /// and no key that is specific to this kind, the error names the other kind instead of a key.
    ///
    /// # Errors
    /// The file is of another kind, or has an unknown key. The error for the first unknown key is that of
    /// [`Section::allow`].
    pub fn allow_in(&self, kind: FileKind, expected: &[&str]) -> Result<(), InputError> {
        let Err(unknown) = self.allow(expected) else {
            return Ok(());
        };
        Err(self.other_kind(kind, expected).unwrap_or(unknown))
    }

    /// Error for a file of another kind, which has a key that is specific to that kind and no key that is specific to
    /// `kind`. `None` for any other file.
    pub fn other_kind(&self, kind: FileKind, expected: &[&str]) -> Option<InputError> {
        let key_of = |kind: FileKind| kind.own_keys().iter().find(|key| self.get(key).is_some());
        // A calibration file may also contain observations, so expected keys do not identify another kind.
        let foreign = |kind: FileKind| {
            let mut keys = kind.own_keys().iter();
            keys.find(|key| !expected.contains(key) && self.get(key).is_some())
        };
        // Calibration and shop files may both contain measurements. So measurements identify a calibration file only if
        // neither kind was expected.
        let no_measurements = !matches!(kind, FileKind::Shop | FileKind::Calibration);
        let measured = (no_measurements && self.get("measurement").is_some())
            .then_some((FileKind::Calibration, &"measurement"));
        let mut others = FileKind::ALL.into_iter().filter(|other| *other != kind);
        let found = others.find_map(|other| foreign(other).map(|key| (other, key))).or(measured);
        match found {
            Some((other, key)) if key_of(kind).is_none() => {
                let (found, expected) = (other.name(), kind.name());
                Some(
                    self.error(format!(
                        "found {found} (it has the key `{key}`), expected {expected}"
                    )),
                )
            }
            _ => None,
        }
    }
}

/// Message about a syntax error. `parser` is the message of the parser, which is returned if there is no clearer one.
pub(crate) fn message(text: &str, span: &Range<usize>, parser: &str) -> String {
    let parser = parser.trim();
    let at = text.get(..span.start).map_or(0, str::len);
    let start = text[..at].rfind('\n').map_or(0, |end| end + 1);
    let line = text[start..].lines().next().unwrap_or_default();
    let mut before = text[..start].lines().map(str::trim);
    let is_first = before.all(|line| line.is_empty() || line.starts_with('#'));
    let code = line.split('#').next().unwrap_or_default().trim();
    if is_first && !code.contains('=') && !code.starts_with('[') && !code.is_empty() {
        return format!("found `{}`, expected TOML: `key = value` or `[table]`", shown(code));
    }
    if parser.starts_with("unexpected leading zero")
        && let Some((whole, part)) = decimal_comma_at(text, at)
    {
        return format!(
            "found `{whole},{part}`, expected a decimal point: {whole}.{part} (TOML has no decimal commas)"
        );
    }
    let Some(value) = code.split_once('=').map(|(_, value)| value.trim()) else {
        return parser.to_owned();
    };
    if parser.starts_with("duplicate key") {
        let key = code.split('=').next().unwrap_or_default().trim();
        return format!("the key `{}` appears twice, expected each key once", shown(key));
    }
    if let Some((key, whole, part)) = decimal_comma_inside(value) {
        return format!(
            "found `{key} = {whole},{part}`, expected a decimal point: {key} = {whole}.{part}"
        );
    }
    // Only these messages of the parser are about a value.
    let about_values = ["string values", "unexpected", "invalid", "extra"];
    if !about_values.iter().any(|start| parser.starts_with(start)) {
        return parser.to_owned();
    }
    if let Some((whole, part)) = decimal_comma(value) {
        return format!("found `{value}`, expected a decimal point: {whole}.{part}");
    }
    if value.is_empty() {
        return "found nothing behind `=`, expected a value".to_owned();
    }
    // The whole value is a single bare word, such as `oops`, `12µm` or `–3`.
    let is_bare = !value.contains(['"', '\'', '[', ']', '{', '}', '=']);
    if is_bare {
        let expected = "expected a number (12.5), a text in quotes (\"X\"), true or false";
        return format!("found `{}`, {expected}", shown(value));
    }
    parser.to_owned()
}

/// Digits before and after the comma, if the value is a single number with a decimal comma.
fn decimal_comma(value: &str) -> Option<(&str, &str)> {
    let (whole, part) = value.split_once(',')?;
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let size = whole.strip_prefix(['-', '+']).unwrap_or(whole);
    (digits(size) && digits(part)).then_some((whole, part))
}

/// Finds a number with a decimal comma in an inline table. Returns its key, and the digits before and after the comma.
/// After a comma in an inline table, TOML requires another key.
fn decimal_comma_inside(value: &str) -> Option<(&str, &str, &str)> {
    let inside = value.strip_prefix('{')?;
    let mut parts = inside.split(',').peekable();
    while let Some(part) = parts.next() {
        let behind = parts.peek()?.trim().trim_end_matches('}').trim();
        let Some((key, whole)) = part.rsplit_once('=') else {
            continue;
        };
        let (key, whole) = (key.trim(), whole.trim());
        let size = whole.strip_prefix(['-', '+']).unwrap_or(whole);
        let digits =
            |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        if digits(size) && digits(behind) {
            return Some((key, whole, behind));
        }
    }
    None
}

/// Digits before and after the comma that ends at the byte offset `at`; `None` if there are no such digits. In an
/// array, such a number would be parsed as two values.
fn decimal_comma_at(text: &str, at: usize) -> Option<(&str, &str)> {
    let before = text.get(..at)?.strip_suffix(',')?;
    let whole = before.rsplit(|c: char| !c.is_ascii_digit() && c != '-' && c != '+').next()?;
    let behind = text.get(at..)?;
    let end = behind.find(|c: char| !c.is_ascii_digit());
    let part = &behind[..end.unwrap_or(behind.len())];
    (!whole.is_empty() && !part.is_empty()).then_some((whole, part))
}

/// Excerpt of the file, truncated to 60 characters.
fn shown(text: &str) -> String {
    const LONGEST: usize = 60;
    let mut cut: String = text.chars().take(LONGEST).collect();
    if cut.len() < text.len() {
        cut.push('…');
    }
    cut
}
