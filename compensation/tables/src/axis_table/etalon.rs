//! TwinCAT TF5280: the Etalon exchange format, one section for each component error.

use core::fmt::Write;

use volcomp_vocabulary::ErrorName;

use super::{
    ErrorTable, ErrorTables, ExchangeError, LineError, TextFile, Written,
    isg_csv::{POSITION, take, value},
    text::{number, short},
};

pub(crate) fn write(errors: &ErrorTables) -> Written {
    let mut written = Written::default();
    if errors.curves.is_empty() && errors.locations.is_empty() {
        return written;
    }
    let mut text = String::new();
    for table in &errors.curves {
        // Writing to a string does not fail.
        let _ = writeln!(text, "[{}]\nGridpoints = {{", table.name);
        for (at, found) in table.positions.iter().zip(&table.values) {
            let _ = writeln!(
                text,
                "{} {}",
                short(table.at_edge(*at), POSITION),
                value(table.name, *found)
            );
        }
        text += "}\n";
    }
    for (name, found) in &errors.locations {
        // `C0Y`: the name without its E.
        let _ = writeln!(
            text,
            "[{}0{}]\nVALUE = {}",
            name.component.letter(),
            name.axis,
            value(*name, *found)
        );
    }
    written.files.push(TextFile {
        name: "errors.txt".to_owned(),
        text,
    });
    written
}

pub(crate) fn read(files: &[&TextFile]) -> Result<ErrorTables, ExchangeError> {
    let mut errors = ErrorTables::default();
    for file in files {
        read_file(file, &mut errors)?;
    }
    Ok(errors)
}

fn read_file(file: &TextFile, errors: &mut ErrorTables) -> Result<(), ExchangeError> {
    let mut name: Option<ErrorName> = None;
    // The numbers between the braces, while they are open.
    let mut open: Option<Vec<f64>> = None;
    let mut last = 1;
    for (index, whole) in file.text.lines().enumerate() {
        let line = index + 1;
        let text = whole.split("//").next().unwrap_or("").trim();
        if text.is_empty() {
            continue;
        }
        last = line;
        let quoted = || volcomp_document::quoted(text);
        let mut inside = None;
        if open.is_some() {
            inside = Some(text);
        } else if let Some(section) = text.strip_prefix('[') {
            let stem = section.strip_suffix(']').map(str::trim);
            let found = stem.and_then(|stem| stem.parse().ok());
            name = Some(found.ok_or_else(|| {
                LineError::at(file, line, quoted(), "an error in brackets: [EXX], [C0Y]")
            })?);
        } else if let Some(rest) = key(text, "Gridpoints") {
            let braced = rest.strip_prefix('{');
            inside =
                Some(braced.ok_or_else(|| LineError::at(file, line, quoted(), "Gridpoints = {"))?);
            open = Some(Vec::new());
        } else if let Some(rest) = key(text, "VALUE") {
            let found = number(rest)
                .ok_or_else(|| LineError::at(file, line, quoted(), "VALUE = and a number"))?;
            let Some(of) = name.take() else {
                return Err(LineError::at(
                    file,
                    line,
                    "VALUE",
                    "the name of the error before it: [C0Y]",
                ));
            };
            if !of.location || errors.locations.iter().any(|(known, _)| *known == of) {
                return Err(LineError::at(
                    file,
                    line,
                    format!("a VALUE of {of}"),
                    "one of a location error, each once",
                ));
            }
            errors.locations.push((of, found));
        } else {
            return Err(LineError::at(
                file,
                line,
                quoted(),
                "[name], Gridpoints = { … } or VALUE =",
            ));
        }
        let (Some(text), Some(numbers)) = (inside, &mut open) else {
            continue;
        };
        let (content, closes) = match text.split_once('}') {
            Some((content, rest)) if rest.trim().is_empty() => (content, true),
            Some(_) => return Err(LineError::at(file, line, quoted(), "nothing behind }")),
            None => (text, false),
        };
        for word in content
            .split([' ', '\t', ',', ';'])
            .filter(|word| !word.is_empty())
        {
            numbers.push(number(word).ok_or_else(|| {
                LineError::at(file, line, volcomp_document::quoted(word), "a number")
            })?);
        }
        if !closes {
            continue;
        }
        close(
            file,
            line,
            name.take(),
            &open.take().unwrap_or_default(),
            errors,
        )?;
    }
    if open.is_some() {
        return Err(LineError::at(
            file,
            last,
            "the end of the file",
            "} behind the Gridpoints",
        ));
    }
    if let Some(name) = name {
        return Err(LineError::at(
            file,
            last,
            format!("[{name}] with nothing in it"),
            "Gridpoints or VALUE",
        ));
    }
    Ok(())
}

/// What stands behind `KEY =`.
fn key<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let rest = text.get(key.len()..).filter(|_| {
        text.get(..key.len())
            .is_some_and(|k| k.eq_ignore_ascii_case(key))
    })?;
    Some(rest.trim_start().strip_prefix('=')?.trim())
}

/// The closing brace: the numbers are a table.
fn close(
    file: &TextFile,
    line: usize,
    name: Option<ErrorName>,
    numbers: &[f64],
    errors: &mut ErrorTables,
) -> Result<(), ExchangeError> {
    let Some(of) = name.filter(|name| !name.location) else {
        return Err(LineError::at(
            file,
            line,
            "Gridpoints",
            "the name of an error motion before them: [EXX]",
        ));
    };
    if !numbers.len().is_multiple_of(2) {
        return Err(LineError::at(
            file,
            line,
            format!("{} numbers", numbers.len()),
            "pairs of position and value",
        ));
    }
    let pairs = numbers.chunks_exact(2);
    let table = ErrorTable {
        name: of,
        positions: pairs
            .clone()
            .map(|pair| ErrorTable::from_edge(of.axis, pair[0]))
            .collect(),
        values: pairs.map(|pair| pair[1]).collect(),
    };
    take(file, line, table, errors)
}
