//! Formats documents as readable TOML: one value per line, small tables inline.

use serde::Serialize;
use serde_json::{Map, Value};

const MARK_COLUMN: usize = 48;
/// Maximum number of keys of a table that is written inline.
const MAX_INLINE: usize = 5;

/// Formats a document, except the root keys in `without`.
pub(crate) fn of(document: &impl Serialize, without: &[&str]) -> String {
    let Ok(Value::Object(mut table)) = serde_json::to_value(document) else {
        return String::new();
    };
    table.retain(|key, _| !without.contains(&key.as_str()));
    without_empty(&mut table);
    marked(&table, &|_| false)
}

/// Formats a table. Marks the values for whose full key, such as `controller[0].url`, `is_default` returns true.
pub(crate) fn marked(table: &Map<String, Value>, is_default: &dyn Fn(&str) -> bool) -> String {
    let mut text = String::new();
    write(&mut text, table, ["", ""], is_default);
    text
}

/// Removes keys with the value null, and empty lists and tables.
pub(crate) fn without_empty(table: &mut Map<String, Value>) {
    table.retain(|key, value| match value {
        Value::Null => false,
        Value::Object(inner) => {
            without_empty(inner);
            !inner.is_empty()
        }
        Value::Array(items) => {
            for inner in items.iter_mut().filter_map(Value::as_object_mut) {
                without_empty(inner);
            }
            // Keep empty lists of these keys: a read-only controller has no axes, and a thermometer may have no names.
            !items.is_empty() || ["axes", "names"].contains(&key.as_str())
        }
        _ => true,
    });
}

/// Writes the values of a table, then its subtables. `header` is the name of the table in headers, `key` its full key.
fn write(
    text: &mut String,
    table: &Map<String, Value>,
    [header, key]: [&str; 2],
    is_default: &dyn Fn(&str) -> bool,
) {
    let dot = if key.is_empty() { "" } else { "." };
    let has_header = |value: &&Value| has_header(value, key.is_empty());
    for (name, value) in table.iter().filter(|(_, value)| !has_header(value)) {
        let mut line = format!("{name} = {}", toml(value));
        if is_default(&format!("{key}{dot}{name}")) {
            let width = line.chars().count();
            line += &" ".repeat(MARK_COLUMN.saturating_sub(width).max(2));
            line += "# default";
        }
        *text += &line;
        *text += "\n";
    }
    for (name, value) in table.iter().filter(|(_, value)| has_header(value)) {
        let (header, key) = (format!("{header}{dot}{name}"), format!("{key}{dot}{name}"));
        let gap = if text.is_empty() { "" } else { "\n" };
        match value {
            Value::Array(items) => {
                for (index, item) in items.iter().enumerate() {
                    let gap = if index > 0 { "\n" } else { gap };
                    text.extend([gap, "[[", &header, "]]\n"]);
                    if let Value::Object(table) = item {
                        let key = format!("{key}[{index}]");
                        write(text, table, [&header, &key], is_default);
                    }
                }
            }
            Value::Object(table) => {
                text.extend([gap, "[", &header, "]\n"]);
                write(text, table, [&header, &key], is_default);
            }
            _ => {}
        }
    }
}

/// True if a value is written under a header: every table of the root, and large tables below it.
fn has_header(value: &Value, is_root: bool) -> bool {
    let is_large = |value: &Value| match value {
        Value::Object(table) => {
            is_root || table.len() > MAX_INLINE || table.values().any(Value::is_object)
        }
        _ => false,
    };
    match value {
        Value::Array(items) => items.iter().any(is_large),
        value => is_large(value),
    }
}

fn toml(value: &Value) -> String {
    match value {
        Value::String(text) => volcomp_document::toml_string(text),
        Value::Array(items) => {
            let rows = items.iter().any(Value::is_object);
            let items: Vec<String> = items.iter().map(toml).collect();
            if rows {
                format!("[\n  {},\n]", items.join(",\n  "))
            } else {
                format!("[{}]", items.join(", "))
            }
        }
        Value::Object(table) => {
            let entries = table.iter();
            let entries = entries.map(|(key, value)| format!("{key} = {}", toml(value)));
            let entries: Vec<String> = entries.collect();
            format!("{{ {} }}", entries.join(", "))
        }
        other => other.to_string(),
    }
}
