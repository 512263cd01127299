//! TOML file as tables and values that record their location.

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

use crate::{bound::bounded, error::InputError, nearest::near, syntax};

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
            let message = syntax::message(&self.text, &span, e.message());
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
