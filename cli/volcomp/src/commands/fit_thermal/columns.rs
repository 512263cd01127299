//! Columns of a file with temperatures and displacements over time, and the error that each displacement measures.

use std::path::Path;

use volcomp_document::{Column, CsvTable, quoted, read_text, split_head, split_unit};
use volcomp_fit::JudgedThermal;
use volcomp_model::axis_of_head;
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName};

use super::temperatures::{implausible, never_cold};
use crate::failure::Failure;

/// The columns of a thermal test. All columns have one entry per row.
pub(super) struct Columns {
    pub(super) time_s: Vec<f64>,
    /// Names of the temperature columns, without `_degc`.
    pub(super) sensors: Vec<String>,
    pub(super) degc: Vec<Vec<f64>>,
    /// Name of each displacement column with its unit, and its values.
    pub(super) displacements: Vec<(String, Vec<f64>)>,
    /// Position of the moved axis in each row, mm, and the name of the axis if the column states it.
    pub(super) position: Option<(Option<AxisName>, Vec<f64>)>,
    pub(super) notes: Vec<String>,
}

pub(super) struct Channel {
    pub(super) name: String,
    /// The error that the displacement measures; `None` if the command line does not state it.
    pub(super) error: Option<ErrorName>,
    pub(super) judged: JudgedThermal,
}

impl Channel {
    /// True for a rotation in µrad, false for a translation in µm.
    pub(super) fn is_angular(&self) -> bool {
        is_angular(&self.name)
    }

    pub(super) fn symbol(&self) -> &'static str {
        if self.is_angular() { "µrad" } else { "µm" }
    }
}

/// True if a column is a rotation in µrad, false for a translation in µm.
pub(super) fn is_angular(column: &str) -> bool {
    column.ends_with("_urad")
}

enum Head {
    Time,
    Sensor(String),
    Displacement(String),
    Position(Option<AxisName>),
    NotRead,
}

impl Head {
    fn of(head: &str) -> Self {
        let axis = axis_of_head(head).filter(|axis| axis.kind() == AxisKind::Linear);
        match (split_unit(head), split_head(head)) {
            (_, ("time", "s")) => Self::Time,
            _ if axis.is_some() => Self::Position(axis),
            (Some(("position", "mm")), _) => Self::Position(None),
            (Some((name, "degc")), _) => Self::Sensor(name.to_owned()),
            (Some((_, "um" | "urad")), _) => Self::Displacement(displacement(head)),
            _ => Self::NotRead,
        }
    }
}

/// The canonical name of a displacement: `dz_um` for `dz µm` and `dz [µm]`.
pub(super) fn displacement(head: &str) -> String {
    split_unit(head).map_or_else(|| head.to_owned(), |(name, unit)| format!("{name}_{unit}"))
}

/// Reads the column `time_s`, the temperature columns (°C), the displacement columns (µm or µrad), and the axis
/// position.
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
    let mut not_read: Vec<&str> = Vec::new();
    let mut has_time = false;
    for (column, head) in table.names() {
        let twice = |is_twice: bool| {
            let message = format!("found two columns {}, expected one", quoted(head));
            is_twice.then(|| table.header_error(message)).map_or(Ok(()), Err)
        };
        match Head::of(head) {
            Head::Time => {
                twice(has_time)?;
                has_time = true;
                found.time_s = numbers(column)?;
            }
            Head::Sensor(sensor) => {
                twice(found.sensors.contains(&sensor))?;
                found.sensors.push(sensor.clone());
                let degc = numbers(column)?;
                if let Some((row, why)) = implausible(&degc)
                    && let Some(row) = table.rows().nth(row)
                {
                    return Err(row.cell(column).error(why).into());
                }
                found.notes.extend(never_cold(&sensor, &degc));
                found.degc.push(degc);
            }
            Head::Displacement(name) => {
                twice(found.displacements.iter().any(|(known, _)| *known == name))?;
                found.displacements.push((name, numbers(column)?));
            }
            Head::Position(axis) => {
                let position = numbers(column)?;
                if position.windows(2).all(|pair| pair[0] == pair[1]) {
                    continue;
                }
                if found.position.replace((axis, position)).is_some() {
                    let message =
                        "found several positions that change, expected one axis that moves";
                    return Err(table.header_error(message.to_owned()).into());
                }
            }
            Head::NotRead => not_read.push(head),
        }
    }
    if !not_read.is_empty() {
        let note = format!("columns that are not read: {}", not_read.join(", "));
        found.notes.push(note);
    }
    let missing = if found.time_s.is_empty() {
        "column time_s with a time in each row"
    } else if found.sensors.is_empty() {
        "temperature: a column in °C, whose head ends in _degc or °C"
    } else if found.displacements.is_empty() {
        "displacement: a column in µm or µrad, whose head ends in _um or _urad"
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
    /// Puts sensors and displacements into the order of the file `first`, and drops columns that `first` does not have.
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
        Ok(Self { sensors: first.sensors.clone(), degc, displacements, ..self })
    }
}

/// Spreads rows with equal times evenly up to the next time, because some loggers write too few digits. Returns the
/// number of these rows. `Err` holds the index of the row at which the time decreases.
fn spread_repeated(time_s: &mut [f64]) -> Result<usize, usize> {
    if let Some(row) = (1..time_s.len()).find(|&row| time_s[row] < time_s[row - 1]) {
        return Err(row);
    }
    let (mut from, mut repeated, mut spacing_s) = (0, 0, 1.0);
    while from < time_s.len() {
        let same = time_s[from..].iter().take_while(|t| **t == time_s[from]).count();
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

/// Default error of a single displacement: most thermal tests measure a spindle along Z.
const OF_ONE: &str = "EZZ";

/// Parsed `--error`: `EZZ` for every displacement, or `dz_um=EZZ` for the displacement `dz_um`.
pub(super) struct Errors {
    of_all: Option<ErrorName>,
    of_one: Vec<(String, ErrorName)>,
}

impl Errors {
    pub(super) fn read(stated: &[String]) -> Result<Self, Failure> {
        let mut errors = Self { of_all: None, of_one: Vec::new() };
        for text in stated {
            let (column, name) = match text.rsplit_once('=') {
                Some((column, name)) => (Some(displacement(column.trim())), name.trim()),
                None => (None, text.trim()),
            };
            let error: ErrorName =
                name.parse().map_err(|e| Failure::Input(format!("--error: {e}")))?;
            if error.location {
                return Err(Failure::Input(format!(
                    "--error {text}: found a location error, expected an error motion, such as {}: a machine file takes thermal terms of these only",
                    ErrorName::motion(error.component, error.axis)
                )));
            }
            let is_twice = match column {
                Some(column) => {
                    let known = errors.of_one.iter().any(|(known, _)| *known == column);
                    errors.of_one.push((column, error));
                    known
                }
                None => errors.of_all.replace(error).is_some(),
            };
            if is_twice {
                return Err(Failure::Input(format!(
                    "--error {text}: found a second error for the same displacement, expected COLUMN=ERROR once for each"
                )));
            }
        }
        Ok(errors)
    }

    /// The error of each fitted displacement; `None` if the command line does not state it.
    pub(super) fn of(&self, names: &[&str]) -> Result<Vec<Option<ErrorName>>, Failure> {
        let unknown = |(column, _): &&(String, ErrorName)| !names.contains(&column.as_str());
        if let Some((column, error)) = self.of_one.iter().find(unknown) {
            return Err(Failure::Input(format!(
                "--error {column}={error}: found no displacement {column} to fit, expected one of {}",
                names.join(", ")
            )));
        }
        names.iter().map(|name| self.of_column(name, names)).collect()
    }

    fn of_column(&self, name: &str, names: &[&str]) -> Result<Option<ErrorName>, Failure> {
        let fits = |error: &ErrorName| error.component.is_angular() == is_angular(name);
        let own = self.of_one.iter().find(|(column, _)| column == name);
        if let Some(error) = own.map(|(_, error)| *error).or(self.of_all) {
            if fits(&error) {
                return Ok(Some(error));
            }
            if own.is_some() || names.len() == 1 {
                let (found, expected) = if is_angular(name) {
                    ("µrad", "an angular error motion")
                } else {
                    ("µm", "a linear error motion")
                };
                return Err(Failure::Input(format!(
                    "--error: found {error} for {name}, which is in {found}: expected {expected}"
                )));
            }
            return Ok(None);
        }
        let of_one = OF_ONE.parse().ok().filter(fits);
        Ok(of_one.filter(|_| names.len() == 1))
    }

    /// Note if one error is stated for several displacements; otherwise `None`.
    pub(super) fn note(&self, of: &[Option<ErrorName>], names: &[&str]) -> Option<String> {
        let error = self.of_all?;
        let alike = of.iter().filter(|found| **found == Some(error)).count();
        (alike > 1).then(|| {
            format!(
                "{error} is taken for {alike} displacements, and a machine file takes the terms of one of them: name the error of each, `--error {}={error}`",
                names.first().copied().unwrap_or_default()
            )
        })
    }
}

/// Returns the error if an expansion can be fitted to it: a linear error of a linear axis.
pub(super) fn may_expand(error: Option<ErrorName>) -> Option<ErrorName> {
    error.filter(|e| e.axis.kind() == AxisKind::Linear && !e.component.is_angular())
}
