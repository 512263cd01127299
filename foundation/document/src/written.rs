use std::fmt::Write;

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
