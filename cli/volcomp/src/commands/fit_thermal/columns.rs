//! The columns of a file with temperatures and displacements over time.

use std::path::Path;

use volcomp_document::{Column, CsvTable, read_text};

use crate::failure::Failure;

/// A time, temperatures and displacements, as many of each as there are rows.
pub(super) struct Columns {
    pub(super) time_s: Vec<f64>,
    /// Names of the temperature columns, without `_degc`.
    pub(super) sensors: Vec<String>,
    /// One column for each sensor, °C.
    pub(super) degc: Vec<Vec<f64>>,
    /// Name of the column with its unit, and its values.
    pub(super) displacements: Vec<(String, Vec<f64>)>,
    /// Notes for a person on how the file was read.
    pub(super) notes: Vec<String>,
}

/// Reads the column `time_s`, those that end in `_degc` and those that end in `_um` or `_urad`.
pub(super) fn read(path: &Path) -> Result<Columns, Failure> {
    let table = CsvTable::parse(&path.display().to_string(), &read_text(path)?)?;
    let numbers = |column: Column| {
        let cells = table.rows().map(|row| row.cell(column).number());
        cells.collect::<Result<Vec<f64>, _>>()
    };
    let mut found = Columns {
        time_s: Vec::new(),
        sensors: Vec::new(),
        degc: Vec::new(),
        displacements: Vec::new(),
        notes: Vec::new(),
    };
    if let Some(time) = table.column("time_s")? {
        found.time_s = numbers(time)?;
    }
    for (column, name) in table.names() {
        if let Some(sensor) = name.strip_suffix("_degc") {
            found.sensors.push(sensor.to_owned());
            found.degc.push(numbers(column)?);
        } else if name.ends_with("_um") || name.ends_with("_urad") {
            found
                .displacements
                .push((name.to_owned(), numbers(column)?));
        }
    }
    let missing = if found.time_s.is_empty() {
        "column time_s with a time in each row"
    } else if found.sensors.is_empty() {
        "temperature: a column that ends in _degc"
    } else if found.displacements.is_empty() {
        "displacement: a column that ends in _um or _urad"
    } else {
        let repeated = spread_repeated(&mut found.time_s).map_err(|row| {
            let line = table.rows().nth(row).map_or(0, |row| row.line());
            Failure::in_line(path, line as u64, "time_s", "the time goes back")
        })?;
        if repeated > 0 {
            found.notes.push(format!(
                "{repeated} rows repeat the time of the row before (too few digits): they are spread evenly"
            ));
        }
        return Ok(found);
    };
    let columns: Vec<&str> = table.names().map(|(_, name)| name).collect();
    let message = format!("found no {missing}; the columns are {}", columns.join(", "));
    Err(table.header_error(message).into())
}

/// Rows with one time are spread evenly up to the next: some loggers write too few digits. How many there were;
/// or the row at which time goes back.
fn spread_repeated(time_s: &mut [f64]) -> Result<usize, usize> {
    if let Some(row) = (1..time_s.len()).find(|&row| time_s[row] < time_s[row - 1]) {
        return Err(row);
    }
    let (mut from, mut repeated, mut spacing_s) = (0, 0, 1.0);
    while from < time_s.len() {
        let same = time_s[from..]
            .iter()
            .take_while(|t| **t == time_s[from])
            .count();
        if let Some(next) = time_s.get(from + same) {
            spacing_s = (next - time_s[from]) / same as f64;
        }
        for (place, time) in time_s[from..from + same].iter_mut().enumerate() {
            *time += spacing_s * place as f64;
        }
        repeated += same - 1;
        from += same;
    }
    Ok(repeated)
}
