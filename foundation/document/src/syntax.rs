//! Messages about TOML syntax errors: those of the parser, or clearer ones for frequent mistakes.

use core::ops::Range;

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

/// For a number with a decimal comma in an inline table: its key, and the digits before and after the comma. A comma in
/// an inline table must be followed by a key.
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

/// Digits before and after a comma just before this offset. In an array, a number with a decimal comma would be two
/// values.
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
