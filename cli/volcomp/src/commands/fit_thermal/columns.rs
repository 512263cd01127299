//! Columns of a file with temperatures and displacements over time.
//!
//! Each column of displacements names the error that it measures. Checks find implausible temperatures and wrong
//! thermal terms.

use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

use volcomp_document::{Column, CsvTable, quoted, read_text, split_head, split_unit};
use volcomp_fit::{
    JudgedThermal, ThermalGap, ThermalRecord, ThermalRun, ThermalSearch, search_thermal,
};
use volcomp_model::axis_of_head;
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName};

use crate::{
    commands::{fixed, range},
    failure::Failure,
};

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

/// Plausible temperatures of a machine, °C. Values in kelvin and the fault codes of loggers are outside this range.
const PLAUSIBLE: RangeInclusive<f64> = -60.0..=200.0;
const WARMEST_SHOP: f64 = 60.0;
/// Minimum step between rows of an outlier, K.
const LEAST_JUMP_K: f64 = 5.0;
/// Factor over the 95 % quantile of the steps between rows, by which a step must additionally exceed `LEAST_JUMP_K`
/// to be an outlier.
const TIMES_USUAL: f64 = 8.0;
/// An outlier spans at most one in this many rows; a longer excursion is a real change.
const ROWS_PER_OUTLIER: usize = 10;

/// The index of the first implausible row, and the reason.
pub(super) fn implausible(degc: &[f64]) -> Option<(usize, String)> {
    if let Some(row) = degc.iter().position(|value| !PLAUSIBLE.contains(value)) {
        let why = format!(
            "found {} °C, expected {} to {} °C",
            degc[row],
            PLAUSIBLE.start(),
            PLAUSIBLE.end()
        );
        return Some((row, why));
    }
    let (from, to) = excursion(degc, LEAST_JUMP_K + TIMES_USUAL * usual_step(degc))?;
    let rows = match to - from {
        1 => "in this row alone".to_owned(),
        count => format!("in {count} rows from here on"),
    };
    let beside = match from.checked_sub(1) {
        Some(before) => degc[before],
        None => degc[to],
    };
    let why = format!(
        "found {} °C {rows}, between rows of about {beside} °C, expected no jump there and back: take these rows out of the file",
        degc[from]
    );
    Some((from, why))
}

fn never_cold(sensor: &str, degc: &[f64]) -> Option<String> {
    let coldest = degc.iter().copied().reduce(f64::min)?;
    (coldest > WARMEST_SHOP).then(|| {
        format!(
            "{sensor}_degc is {coldest} °C at the lowest, expected a start below {WARMEST_SHOP} °C, that of a machine in its shop: are these °C?"
        )
    })
}

/// The 95 % quantile of the steps between rows, K.
fn usual_step(degc: &[f64]) -> f64 {
    let steps = degc.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let mut steps: Vec<f64> = steps.collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() * 95 / 100).copied().unwrap_or(0.0)
}

/// The rows from a jump to the jump back, as a half-open range. At an end of the record a single jump suffices.
fn excursion(degc: &[f64], jump_k: f64) -> Option<(usize, usize)> {
    let most = (degc.len() / ROWS_PER_OUTLIER).max(1);
    let is_jump = |row: usize| (degc[row] - degc[row - 1]).abs() > jump_k;
    let jumps: Vec<usize> = (1..degc.len()).filter(|row| is_jump(*row)).collect();
    let goes_back = |out: usize, back: usize| {
        let way = degc[out] - degc[out - 1];
        let returns = degc[back] - degc[back - 1];
        way * returns < 0.0 && (degc[back] - degc[out - 1]).abs() < 0.5 * way.abs()
    };
    for (place, &out) in jumps.iter().enumerate() {
        if let Some(&back) = jumps.get(place + 1)
            && back - out <= most
            && goes_back(out, back)
        {
            return Some((out, back));
        }
        // The sensor had not measured yet at the start, or was removed at the end.
        if place == 0 && out <= most.min(3) {
            return Some((0, out));
        }
        if out == degc.len() - 1 {
            return Some((out, degc.len()));
        }
    }
    None
}

/// Minimum temperature change for the checks of units, K. Such a change takes longer than [`SHORTEST_S`] and moves a
/// machine by at least [`LEAST_MOTION`].
const CHANGE_K: f64 = 5.0;
/// Displacement below which the unit is probably wrong, µm or µrad.
const LEAST_MOTION: f64 = 0.5;
const SHORTEST_S: f64 = 1800.0;

pub(super) fn too_small(files: &[Columns]) -> Vec<String> {
    let largest = |of: &dyn Fn(&Columns) -> f64| files.iter().map(of).fold(0.0, f64::max);
    // clap requires at least one file.
    let Some(first) = files.first() else {
        return Vec::new();
    };
    let sensors = 0..first.sensors.len();
    let change_k = largest(&|file| {
        let changes = sensors.clone().map(|sensor| spread(&file.degc[sensor]));
        changes.fold(0.0, f64::max)
    });
    if change_k < CHANGE_K {
        return Vec::new();
    }
    let mut notes = Vec::new();
    let lasts_s = largest(&|file| spread(&file.time_s));
    if lasts_s < SHORTEST_S {
        notes.push(format!(
            "time_s: the longest file lasts {lasts_s} s, and a temperature changes by {change_k:.1} K: expected seconds"
        ));
    }
    for (place, (name, _)) in first.displacements.iter().enumerate() {
        let moves = largest(&|file| spread(&file.displacements[place].1));
        if moves > 0.0 && moves < LEAST_MOTION {
            let unit = if is_angular(name) { "µrad" } else { "µm" };
            notes.push(format!(
                "{name}: moves by {moves:.2e} {unit} at most, and a temperature changes by {change_k:.1} K: expected {unit}"
            ));
        }
    }
    notes
}

fn spread(values: &[f64]) -> f64 {
    range(values.iter().copied()).max(0.0)
}

pub(super) fn still_sensors(files: &[Columns]) -> Vec<String> {
    // clap requires at least one file.
    let sensors = files.first().map_or(&[][..], |file| &file.sensors[..]);
    let still = (sensors.iter().enumerate())
        .filter(|(sensor, _)| is_still(files.iter().flat_map(|file| &file.degc[*sensor])));
    still.map(|(_, name)| format!("{name}_degc")).collect()
}

pub(super) fn still_in(path: &Path, file: &Columns, files: &[Columns]) -> Option<String> {
    let still = file.sensors.iter().enumerate().filter(|(sensor, _)| {
        let all = files.iter().flat_map(|file| &file.degc[*sensor]);
        is_still(&file.degc[*sensor]) && !is_still(all)
    });
    let still: Vec<String> = still
        .filter_map(|(sensor, name)| {
            let degc = file.degc[sensor].first()?;
            Some(format!("{name}_degc ({degc} °C)"))
        })
        .collect();
    (!still.is_empty()).then(|| {
        format!(
            "{}: the same value in all rows of {}, but not in those of the other files: terms of a sensor that does not measure are wrong",
            path.display(),
            still.join(", ")
        )
    })
}

fn is_still<'a>(values: impl IntoIterator<Item = &'a f64>) -> bool {
    let mut values = values.into_iter();
    let first = values.next();
    values.all(|value| Some(value) == first)
}

/// A file is checked only if the prediction error exceeds this fraction of its displacement (RMS).
const NOT_PREDICTED: f64 = 0.5;
/// A file looks inverted if the prediction with the opposite sign leaves at most this fraction of the prediction error.
const EXPLAINED: f64 = 0.3;

/// Notes on files that the terms of the other files predict only with the opposite sign.
pub(super) fn inverted(
    channel: &Channel,
    runs: &[ThermalRun],
    files: &[PathBuf],
    search: &ThermalSearch,
) -> Vec<String> {
    let mut notes = Vec::new();
    for (place, (left, run)) in channel.judged.left_out.iter().zip(runs).enumerate() {
        let size = run.rms_from_start();
        if *left <= NOT_PREDICTED * size {
            continue;
        }
        let mut others = runs.to_vec();
        others.remove(place);
        let Ok(terms) = search_thermal(&others, search) else {
            continue;
        };
        let mut turned = run.clone();
        for displacement in &mut turned.record.displacement {
            *displacement = -*displacement;
        }
        let better = terms.rms_from_start(&turned);
        if better >= EXPLAINED * left || better >= NOT_PREDICTED * size {
            continue;
        }
        let mut named = files[place].display().to_string();
        if let [_, _] = runs {
            named = format!("{named} or {}", files[1 - place].display());
        }
        let unit = channel.symbol();
        notes.push(format!(
            "{}: {named} looks inverted: with the opposite sign {} {unit} would be left of its prediction from the others in place of {} {unit}",
            channel.name,
            fixed(better, 2),
            fixed(*left, 2)
        ));
        if let [_, _] = runs {
            break;
        }
    }
    notes
}

/// Note on gaps in a file, for terms with the time constants `lags_s`, s; `None` without gaps.
pub(super) fn gaps(path: &Path, columns: &Columns, lags_s: &[f64]) -> Option<String> {
    let record = ThermalRecord { time_s: columns.time_s.clone(), ..ThermalRecord::default() };
    let gaps = record.gaps(lags_s);
    let length = |gap: &&ThermalGap| gap.to_s - gap.from_s;
    let longest = gaps.iter().max_by(|a, b| length(a).total_cmp(&length(b)))?;
    let rows = 0..record.len();
    let left_out = rows.filter(|row| gaps.iter().any(|gap| gap.left_out.contains(row)));
    let count = match gaps.len() {
        1 => "a gap in the log".to_owned(),
        many => format!("{many} gaps in the log, the longest"),
    };
    Some(format!(
        "{}: {count} from {} to {} s, where rows are usually {} s apart: what the temperatures did there is not known. The {} rows behind {} that the time constants (up to {} s) still let depend on it are left out",
        path.display(),
        longest.from_s,
        longest.to_s,
        fixed(record.usual_interval_s(), 0),
        left_out.count(),
        if gaps.len() == 1 { "it" } else { "them" },
        lags_s.iter().copied().fold(0.0, f64::max),
    ))
}

/// Note if the rows are so far apart that temperature changes between rows could affect the prediction error; otherwise
/// `None`.
pub(super) fn too_coarse(
    channel: &Channel,
    runs: &[ThermalRun],
    files: &[PathBuf],
) -> Option<String> {
    let coarse = channel.judged.coarse_rows(runs)?;
    Some(format!(
        "{}: the rows of {} are {} s apart, and the shortest time constant of the terms is {} s: by how the temperatures bend from row to row, what they did between the rows adds about {} {} to what the terms miss on a machine that reads them in every cycle. It is counted in the error and in the uncertainties. Record the temperatures every {} s or more often, or choose from longer time constants (--lags)",
        channel.name,
        files.get(coarse.run)?.display(),
        fixed(coarse.interval_s, 0),
        coarse.shortest_lag_s,
        fixed(coarse.adds_rms, 2),
        channel.symbol(),
        coarse.enough_s,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three hours of a spindle that warms up, with one noisy reading per minute.
    fn warming() -> Vec<f64> {
        let degc = |row: i32| {
            let hours = f64::from(row) / 60.0;
            let noise = 0.05 * (f64::from(row) * 12.9898).sin();
            22.0 + 30.0 * (1.0 - (-2.0 * hours).exp()) + noise
        };
        (0..180).map(degc).collect()
    }

    #[test]
    fn what_a_machine_does_is_taken() {
        assert_eq!(implausible(&warming()), None);
        // Coolant is switched on: a step that stays.
        let mut step = warming();
        step[90..].iter_mut().for_each(|t| *t -= 12.0);
        assert_eq!(implausible(&step), None);
        // A sensor in moving air: its temperature goes up and down continuously.
        let windy: Vec<f64> = (0..180).map(|row| 22.0 + 6.0 * f64::from(row % 2)).collect();
        assert_eq!(implausible(&windy), None);
        // Constant temperatures, including a temperature below zero.
        assert_eq!(implausible(&[-3.0; 100]), None);
        assert_eq!(implausible(&[20.0]), None);
        assert_eq!(implausible(&[]), None);
    }

    #[test]
    fn a_machine_begins_at_the_temperature_of_a_shop() {
        assert_eq!(never_cold("spindle", &warming()), None);
        let fahrenheit: Vec<f64> = warming().iter().map(|degc| 1.8 * degc + 32.0).collect();
        let said = never_cold("spindle", &fahrenheit).expect("no shop is at 71 °C");
        assert!(said.starts_with("spindle_degc is 71"), "{said}");
    }

    #[test]
    fn faults_of_sensors_are_refused() {
        for (value, rows, says) in [
            // A reading before the first measurement, at the end, without a sensor, and a single outlier.
            (85.0, 0..1, "there and back"),
            (85.0, 60..61, "there and back"),
            (-10.0, 179..180, "there and back"),
            (0.0, 17..18, "in this row alone"),
            (0.0, 40..45, "in 5 rows from here on"),
            // A sensor without contact, values in kelvin, and a broken wire.
            (-127.0, 40..45, "expected -60 to 200 °C"),
            (295.0, 0..180, "expected -60 to 200 °C"),
            (850.0, 3..4, "expected -60 to 200 °C"),
        ] {
            let mut degc = warming();
            degc[rows.clone()].fill(value);
            let (row, why) = implausible(&degc).expect("a fault");
            assert_eq!(row, rows.start, "{why}");
            assert!(why.contains(says), "{why}");
        }
    }
}
