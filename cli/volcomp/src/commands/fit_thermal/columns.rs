//! The columns of a file with temperatures and displacements over time.

use std::path::Path;

use volcomp_document::{Column, CsvTable, read_text};
use volcomp_model::vocabulary::{AxisKind, AxisName};

use super::plausible::implausible;
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
    /// The axis that was moved during the test, where the column names one, and its position in each row, mm.
    pub(super) position: Option<(Option<AxisName>, Vec<f64>)>,
    /// Notes for a person on how the file was read.
    pub(super) notes: Vec<String>,
}

/// The axis whose positions a column holds, where it names one.
struct Moved {
    axis: Option<AxisName>,
}

/// The axis of a column with positions: `X`, `X_mm`; `position_mm` names none.
fn moved(name: &str) -> Option<Moved> {
    if name == "position_mm" {
        return Some(Moved { axis: None });
    }
    let axis: AxisName = name.strip_suffix("_mm").unwrap_or(name).parse().ok()?;
    (axis.kind() == AxisKind::Linear).then_some(Moved { axis: Some(axis) })
}

/// Reads the column `time_s`, those that end in `_degc`, those that end in `_um` or `_urad`, and the position of an axis.
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
        position: None,
        notes: Vec::new(),
    };
    if let Some(time) = table.column("time_s")? {
        found.time_s = numbers(time)?;
    }
    for (column, name) in table.names() {
        if let Some(sensor) = name.strip_suffix("_degc") {
            found.sensors.push(sensor.to_owned());
            let degc = numbers(column)?;
            if let Some((row, why)) = implausible(&degc)
                && let Some(row) = table.rows().nth(row)
            {
                return Err(row.cell(column).error(why).into());
            }
            found.degc.push(degc);
        } else if name.ends_with("_um") || name.ends_with("_urad") {
            found
                .displacements
                .push((name.to_owned(), numbers(column)?));
        } else if let Some(Moved { axis }) = moved(name) {
            let position = numbers(column)?;
            if position.windows(2).all(|pair| pair[0] == pair[1]) {
                continue;
            }
            if found.position.replace((axis, position)).is_some() {
                let message = "found several positions that change, expected one axis that moves";
                return Err(table.header_error(message.to_owned()).into());
            }
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

impl Columns {
    /// The sensors and displacements of another file, in its order; those that it does not have are passed over.
    pub(super) fn in_order_of(mut self, first: &Self, path: &Path) -> Result<Self, Failure> {
        let missing = |name: &str| {
            let message = format!("found no column {name}, which the first file has");
            Failure::in_file(path, message)
        };
        let mut degc = Vec::new();
        for sensor in &first.sensors {
            let place = self.sensors.iter().position(|name| name == sensor);
            let place = place.ok_or_else(|| missing(&format!("{sensor}_degc")))?;
            degc.push(std::mem::take(&mut self.degc[place]));
        }
        let mut displacements = Vec::new();
        for (name, _) in &first.displacements {
            let mut own = self.displacements.iter_mut();
            let own = own.find(|(known, _)| known == name);
            let own = own.ok_or_else(|| missing(name))?;
            displacements.push((name.clone(), std::mem::take(&mut own.1)));
        }
        Ok(Self {
            sensors: first.sensors.clone(),
            degc,
            displacements,
            ..self
        })
    }
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
