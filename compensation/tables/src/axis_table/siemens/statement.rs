//! One line of an initialisation file or of a program that fills tables.

use super::super::text::number;

/// What a line says.
pub(super) enum Statement {
    Metric,
    Inch,
    /// CHANDATA, M17 and what else frames the statements.
    Frame,
    /// Another variable of the control.
    Other(String),
    /// A part of a compensation table.
    Set {
        name: String,
        index: Vec<String>,
        value: Value,
        has_equals: bool,
    },
}

/// What stands behind the `=`.
pub(super) enum Value {
    Number(f64),
    Axis(String),
}

const EXPECTED: &str = "a statement such as $AN_CEC[0,1]=0.005 or $AA_ENC_COMP[0,1,AX1]=0.005";

/// Reads a line without its comment; `None` where it is empty.
pub(super) fn statement(line: &str) -> Result<Option<Statement>, &'static str> {
    let text = without_number(line.trim());
    if text.is_empty() {
        return Ok(None);
    }
    let upper = text.to_ascii_uppercase();
    if upper == "METRIC" {
        return Ok(Some(Statement::Metric));
    }
    if upper == "INCH" {
        return Ok(Some(Statement::Inch));
    }
    if is_frame(&upper) {
        return Ok(Some(Statement::Frame));
    }
    if !upper.starts_with('$') {
        return Err(EXPECTED);
    }
    let (name, rest) = upper.split_once('[').ok_or(EXPECTED)?;
    let name = name.trim();
    if !(name.starts_with("$AN_CEC") || name.starts_with("$AA_ENC_COMP")) {
        return Ok(Some(Statement::Other(name.to_owned())));
    }
    let (index, rest) = rest.split_once(']').ok_or("a `]` behind the index")?;
    let index = index
        .split([',', '.'])
        .map(|part| part.trim().to_owned())
        .collect();
    let rest = rest.trim();
    let (has_equals, value) = match rest.strip_prefix('=') {
        Some(value) => (true, value.trim()),
        None => (false, rest),
    };
    let value = match (number(value), value) {
        (Some(number), _) => Value::Number(number),
        (None, "TRUE") => Value::Number(1.0),
        (None, "FALSE") => Value::Number(0.0),
        (None, text) => {
            let bare = text
                .strip_prefix('(')
                .and_then(|rest| rest.strip_suffix(')'))
                .unwrap_or(text)
                .trim();
            let is_name =
                !bare.is_empty() && bare.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
            if !is_name || bare.as_bytes()[0].is_ascii_digit() {
                return Err("a number, or an axis in brackets, behind the index");
            }
            Value::Axis(bare.to_owned())
        }
    };
    Ok(Some(Statement::Set {
        name: name.to_owned(),
        index,
        value,
        has_equals,
    }))
}

/// Without a block number `N120`.
fn without_number(text: &str) -> &str {
    let Some(rest) = text.strip_prefix(['N', 'n']) else {
        return text;
    };
    let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
    if digits == 0 {
        text
    } else {
        rest[digits..].trim_start()
    }
}

fn is_frame(upper: &str) -> bool {
    const WORDS: [&str; 5] = ["M17", "M30", "M02", "M2", "STOPRE"];
    WORDS.contains(&upper) || upper.starts_with("CHANDATA") || upper.starts_with('%')
}
