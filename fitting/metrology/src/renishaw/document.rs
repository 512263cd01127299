//! Structure of a file: sections `NAME::` up to `EOF::`, with line numbers.

use volcomp_document::quoted;

use crate::MetrologyError;
use crate::number::Place;

pub(super) struct Section<'t> {
    pub(super) name: String,
    pub(super) line: usize,
    pub(super) lines: Vec<(usize, &'t str)>,
}

pub(super) struct Document<'t> {
    pub(super) file: &'t str,
    sections: Vec<Section<'t>>,
    last_line: usize,
    pub(super) text_after_end: bool,
}

impl<'t> Document<'t> {
    pub(super) fn split(text: &'t str, file: &'t str) -> Result<Self, MetrologyError> {
        let mut document = Self { file, sections: Vec::new(), last_line: 0, text_after_end: false };
        let mut ended = false;
        for (index, raw) in text.lines().enumerate() {
            let (number, line) = (index + 1, raw.trim_ascii());
            if ended {
                document.text_after_end |= !line.trim_matches('\u{1a}').is_empty();
            } else if let Some(name) = section_name(line) {
                ended = name == "EOF";
                document.open(name, number)?;
            } else if !line.is_empty() {
                document.append(number, line)?;
            }
            document.last_line = number;
        }
        if ended { Ok(document) } else { Err(document.cut()) }
    }

    fn open(&mut self, name: String, line: usize) -> Result<(), MetrologyError> {
        if let Some(first) = self.sections.iter().find(|s| s.name == name) {
            let found = format!("`{name}::` again (first in line {})", first.line);
            let place = Place::new(self.file, line);
            return Err(place.contradictory("section", found, "each section once"));
        }
        self.sections.push(Section { name, line, lines: Vec::new() });
        Ok(())
    }

    fn append(&mut self, number: usize, line: &'t str) -> Result<(), MetrologyError> {
        let Some(section) = self.sections.last_mut() else {
            let expected = "a section line such as `HEADER::`";
            return Err(Place::new(self.file, number).wrong_kind(quoted(line), expected));
        };
        section.lines.push((number, line));
        Ok(())
    }

    fn cut(&self) -> MetrologyError {
        let last = self.sections.last();
        let last_text = last.and_then(|s| s.lines.last()).map_or_else(
            || last.map(|s| format!("{}::", s.name)).unwrap_or_default(),
            |(_, text)| (*text).to_owned(),
        );
        let found = format!("the end of the file after {}", quoted(&last_text));
        let place = Place::new(self.file, self.last_line);
        place.truncated("end of file", found, "`EOF::` as the last line (the file is cut off)")
    }

    pub(super) fn section(&self, name: &str) -> Option<&Section<'t>> {
        self.sections.iter().find(|s| s.name == name)
    }

    pub(super) fn required(&self, name: &str) -> Result<&Section<'t>, MetrologyError> {
        self.section(name).ok_or_else(|| {
            let names: Vec<&str> = self.sections.iter().map(|s| s.name.as_str()).collect();
            let place = Place::new(self.file, self.last_line);
            let found = format!("only {}", names.join(", "));
            place.malformed("sections", found, format!("a section `{name}::`"))
        })
    }
}

/// Name of a section, if the line is `NAME::`. The name must not contain a colon, because free text may contain one.
pub(super) fn section_name(line: &str) -> Option<String> {
    let name = line.strip_suffix("::")?.trim_ascii_end();
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, ' ' | '-' | '_');
    (!name.is_empty() && name.chars().all(plain)).then(|| name.to_ascii_uppercase())
}

/// Splits a line `key : value`. Upper case, blanks, tabs and hyphens are removed from the key, so that `Target-count`
/// and `Target count` are equal.
pub(super) fn key_value(line: &str) -> Option<(String, &str)> {
    let (key, value) = line.split_once(':')?;
    let key = key
        .chars()
        .filter(|c| !matches!(c, ' ' | '\t' | '-'))
        .map(|c| c.to_ascii_lowercase())
        .collect();
    Some((key, value.trim_ascii()))
}

impl<'t> Section<'t> {
    /// Number of the only line with this key, and its value; `None` if there is no such line.
    pub(super) fn value(
        &self,
        file: &str,
        key: &str,
    ) -> Result<Option<(usize, &'t str)>, MetrologyError> {
        let mut found = None;
        for (line, text) in &self.lines {
            let Some((_, value)) = key_value(text).filter(|(k, _)| k == key) else {
                continue;
            };
            if let Some((first, _)) = found {
                let what = format!("{} (first in line {first})", quoted(text));
                let expected = "each key once in its section";
                return Err(Place::new(file, *line).contradictory("key", what, expected));
            }
            found = Some((*line, value));
        }
        Ok(found)
    }

    pub(super) fn required_value(
        &self,
        file: &str,
        key: &str,
        shown: &str,
    ) -> Result<(usize, &'t str), MetrologyError> {
        self.value(file, key)?.ok_or_else(|| {
            let place = Place::new(file, self.line);
            place.malformed(&self.name, format!("no `{shown}`"), format!("a line `{shown}:`"))
        })
    }
}
