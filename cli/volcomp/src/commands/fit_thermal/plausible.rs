//! Temperatures that no sensor of a machine has seen: values with which sensors report a fault, other units, single rows.

use std::{ops::RangeInclusive, path::Path};

use super::{columns::Columns, is_angular};

/// What a sensor on a machine may show, °C.
const ON_A_MACHINE: RangeInclusive<f64> = -60.0..=200.0;
/// A row counts as a jump from this on, K, beside what the sensor changes by anyway from row to row.
const JUMP_K: f64 = 5.0;
/// So many times what 95 % of the steps from row to row stay below.
const TIMES_USUAL: f64 = 8.0;
/// A fault that lasts longer than this share of the rows is not told from a change.
const SHORT: usize = 10;

/// Values with which sensors report that they have not measured, °C.
const REPORTS: [(f64, &str); 8] = [
    (
        -127.0,
        "what digital sensors (DS18B20) report without contact",
    ),
    (
        85.0,
        "what digital sensors (DS18B20) report before their first measurement",
    ),
    (-242.0, "what inputs for PT100 report with a short circuit"),
    (-200.0, "what inputs for PT100 report with a short circuit"),
    (850.0, "what inputs for PT100 report with a broken wire"),
    (
        -10.0,
        "what laser systems write where no sensor is connected",
    ),
    (0.0, "what many inputs report without a sensor"),
    (-999.0, "what data loggers write for a missing value"),
];
/// A reading is such a value within half of what its last digit may be.
const REPORTED_WITHIN_K: f64 = 0.06;

/// A thermal test lasts longer, s.
const SHORT_TEST_S: f64 = 1800.0;
/// A temperature that changes by so much, K, moves a machine by more than this, µm or µrad, and takes longer than a short test.
const CHANGE_K: f64 = 5.0;
const MOVES_BY: f64 = 0.5;

/// Notes where all files look as if one quantity were in another unit than its head says.
pub(super) fn of_all(files: &[Columns]) -> Vec<String> {
    let mut notes = Vec::new();
    let Some(first) = files.first() else {
        return notes;
    };
    let change = |sensor: usize| {
        let changes = files.iter().map(|file| spread(&file.degc[sensor]));
        changes.fold(0.0, f64::max)
    };
    let changes = (0..first.sensors.len()).map(change);
    let most = changes.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
    let Some((sensor, change_k)) = most.filter(|(_, change)| *change >= CHANGE_K) else {
        return notes;
    };
    let name = &first.sensors[sensor];
    let lasts_s = files.iter().map(|file| spread(&file.time_s));
    let lasts_s = lasts_s.fold(0.0, f64::max);
    if lasts_s < SHORT_TEST_S {
        notes.push(format!(
            "time_s: the longest file lasts {lasts_s} s, and {name} changes by {change_k:.1} K: is the time in seconds, not in minutes? Time constants, rates and what is seen would be wrong with it"
        ));
    }
    for (place, (name_of, _)) in first.displacements.iter().enumerate() {
        let sizes = files
            .iter()
            .map(|file| spread(&file.displacements[place].1));
        let size = sizes.fold(0.0, f64::max);
        let (unit, other) = if is_angular(name_of) {
            ("µrad", "mrad or rad")
        } else {
            ("µm", "mm")
        };
        if size > 0.0 && size < MOVES_BY {
            notes.push(format!(
                "{name_of}: moves by {size:.2e} {unit} at the most, while {name} changes by {change_k:.1} K: is it in {other}? Its head says {unit}"
            ));
        }
    }
    notes
}

/// A note on sensors that show one value in the whole of one file, and others in others.
pub(super) fn still_in(path: &Path, file: &Columns, files: &[Columns]) -> Option<String> {
    let is_still = |(sensor, _): &(usize, &String)| {
        let first = file.degc[*sensor].first();
        let moves = |other: &Columns| other.degc[*sensor].iter().any(|degc| Some(degc) != first);
        spread(&file.degc[*sensor]) == 0.0 && files.iter().any(moves)
    };
    let still = file.sensors.iter().enumerate().filter(is_still);
    let still: Vec<String> = still
        .filter_map(|(sensor, name)| {
            let degc = file.degc[sensor].first()?;
            Some(format!("{name}_degc ({degc} °C)"))
        })
        .collect();
    (!still.is_empty()).then(|| {
        format!(
            "{}: the same value in all rows of {}, but not in those of the other files: does the sensor measure there? Terms that are found with it are wrong",
            path.display(),
            still.join(", ")
        )
    })
}

/// The largest less the smallest of some values; 0 of none.
fn spread(values: &[f64]) -> f64 {
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (most - least).max(0.0)
}

/// Why a column of temperatures cannot be what was measured: the row, counted from 0, and the reason, with what to do.
pub(super) fn implausible(degc: &[f64]) -> Option<(usize, String)> {
    if let Some(reason) = unit(degc) {
        return Some((0, reason));
    }
    let jump_k = JUMP_K + TIMES_USUAL * usual_step(degc);
    let is_out = |row: &usize| !ON_A_MACHINE.contains(&degc[*row]);
    if let Some(row) = (0..degc.len()).find(is_out) {
        return Some((
            row,
            format!(
                "found {} °C, expected {} to {} °C{}",
                degc[row],
                ON_A_MACHINE.start(),
                ON_A_MACHINE.end(),
                meaning(degc[row])
            ),
        ));
    }
    let (from, to) = excursion(degc, jump_k)?;
    let rows = match to - from {
        1 => "in this row alone".to_owned(),
        count => format!("in {count} rows from here on"),
    };
    let beside = match from.checked_sub(1) {
        Some(before) => degc[before],
        None => degc[to],
    };
    Some((
        from,
        format!(
            "found {} °C {rows}, between rows of about {beside} °C: no sensor on a machine goes there and back between two readings{}. Take these rows out of the file, of all columns",
            degc[from],
            meaning(degc[from])
        ),
    ))
}

/// What a value is known to mean, behind a colon.
fn meaning(degc: f64) -> String {
    let known = REPORTS
        .iter()
        .find(|(value, _)| (degc - value).abs() < REPORTED_WITHIN_K);
    known.map_or(String::new(), |(value, what)| {
        format!("; {value} °C is {what}")
    })
}

/// The unit that a column is in, where its values are no °C of a machine.
fn unit(degc: &[f64]) -> Option<String> {
    let mut sorted = degc.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = *sorted.get(sorted.len() / 2)?;
    let found = format!("found {middle} in the middle of this column");
    (230.0..400.0)
        .contains(&middle)
        .then(|| format!("{found}, which looks like kelvin: expected °C, 273.15 less"))
}

/// What 95 % of the steps from row to row stay below, K.
fn usual_step(degc: &[f64]) -> f64 {
    let mut steps: Vec<f64> = degc
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).abs())
        .collect();
    steps.sort_by(f64::total_cmp);
    let place = (steps.len() * 95) / 100;
    steps.get(place).copied().unwrap_or(0.0)
}

/// The first few rows that are off by a jump there and a jump back; at an end of the record there is one jump only.
fn excursion(degc: &[f64], jump_k: f64) -> Option<(usize, usize)> {
    let most = (degc.len() / SHORT).max(1);
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
        // A sensor that has not measured yet, or that is taken off at the end.
        let last = degc.len() - 1;
        if place == 0 && out <= most.min(3) {
            return Some((0, out));
        }
        if out == last {
            return Some((out, degc.len()));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three hours of a spindle that warms up, a reading each minute with some noise.
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
        // Up to 85 °C, little by little.
        let hot: Vec<f64> = warming().iter().map(|t| t * 1.95 - 14.0).collect();
        assert!(hot.iter().any(|t| (t - 85.0).abs() < 0.3));
        assert_eq!(implausible(&hot), None);
        // Coolant is switched on: a step that stays.
        let mut step = warming();
        step[90..].iter_mut().for_each(|t| *t -= 12.0);
        assert_eq!(implausible(&step), None);
        // A sensor in the wind: it goes up and down all the time.
        let windy: Vec<f64> = (0..180)
            .map(|row| 22.0 + 6.0 * f64::from(row % 2))
            .collect();
        assert_eq!(implausible(&windy), None);
        // Frost, and a constant.
        assert_eq!(implausible(&[-3.0; 100]), None);
        assert_eq!(implausible(&[20.0]), None);
        assert_eq!(implausible(&[]), None);
    }

    #[test]
    fn faults_of_sensors_are_named() {
        for (value, row, said) in [
            (85.0, 60, "before their first measurement"),
            (85.0, 0, "before their first measurement"),
            (-10.0, 179, "no sensor is connected"),
            (0.0, 17, "without a sensor"),
            (75.0, 100, "there and back"),
        ] {
            let mut degc = warming();
            degc[row] = value;
            let (found, why) = implausible(&degc).expect("a fault");
            assert_eq!(found, row, "{why}");
            assert!(why.contains(said), "{why}");
        }
        let mut degc = warming();
        degc[40..45].fill(-127.0);
        let (row, why) = implausible(&degc).expect("a fault");
        assert_eq!(row, 40);
        assert!(why.contains("without contact"), "{why}");
        let mut several = warming();
        several[40..45].fill(0.0);
        let (row, why) = implausible(&several).expect("a fault");
        assert!(row == 40 && why.contains("in 5 rows from here on"), "{why}");
    }

    #[test]
    fn kelvin_is_no_degc() {
        let kelvin: Vec<f64> = warming().iter().map(|t| t + 273.15).collect();
        let (_, why) = implausible(&kelvin).expect("kelvin");
        assert!(why.contains("looks like kelvin"), "{why}");
    }
}
