//! Checks against wrong thermal terms: implausible temperatures, disconnected sensors, files of the opposite sign, rows too far apart.

use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

use volcomp_fit::{ThermalGap, ThermalRecord, ThermalRun, ThermalSearch, search_thermal};

use super::{Channel, columns::Columns, is_angular};
use crate::commands::{fixed, range};

/// Plausible temperatures of a machine, °C. Kelvin values and the fault codes of loggers are outside.
const PLAUSIBLE: RangeInclusive<f64> = -60.0..=200.0;
/// Maximum temperature of a workshop, °C.
const WARMEST_SHOP: f64 = 60.0;
/// Minimum step between rows that counts as an outlier, K.
const LEAST_JUMP_K: f64 = 5.0;
/// Factor over the 95 % quantile of the steps between rows that makes an outlier.
const TIMES_USUAL: f64 = 8.0;
/// Outliers span at most one in this many rows: anything longer is a real change.
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

/// A note on a sensor whose lowest temperature is too high for any workshop.
pub(super) fn never_cold(sensor: &str, degc: &[f64]) -> Option<String> {
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

/// The rows from a jump to the jump back; at an end of the record a single jump suffices.
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
        // A sensor not yet measuring, or removed at the end.
        if place == 0 && out <= most.min(3) {
            return Some((0, out));
        }
        if out == degc.len() - 1 {
            return Some((out, degc.len()));
        }
    }
    None
}

/// Temperature change, K, that moves a machine by more than [`LEAST_MOTION`] and takes longer than [`SHORTEST_S`].
const CHANGE_K: f64 = 5.0;
/// Minimum motion for that change, µm or µrad.
const LEAST_MOTION: f64 = 0.5;
const SHORTEST_S: f64 = 1800.0;

/// Notes on times and displacements that are too small for the temperature change.
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

/// Maximum minus minimum; 0 for no values.
fn spread(values: &[f64]) -> f64 {
    range(values.iter().copied()).max(0.0)
}

/// The sensors whose temperature is constant in all rows of all files.
pub(super) fn still_sensors(files: &[Columns]) -> Vec<String> {
    // clap requires at least one file.
    let sensors = files.first().map_or(&[][..], |file| &file.sensors[..]);
    let still = (sensors.iter().enumerate())
        .filter(|(sensor, _)| is_still(files.iter().flat_map(|file| &file.degc[*sensor])));
    still.map(|(_, name)| format!("{name}_degc")).collect()
}

/// A note on sensors that are constant throughout one file but not in others.
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

/// Minimum unpredicted share of a file's displacement for the file to be checked.
const NOT_PREDICTED: f64 = 0.5;
/// A file looks inverted if the opposite sign leaves no more than this share of the prediction error.
const EXPLAINED: f64 = 0.3;

/// A note for each file that is predicted by terms from the others only with the opposite sign.
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

/// A note on gaps in a file, for terms with these time constants, s.
pub(super) fn gaps(path: &Path, columns: &Columns, lags_s: &[f64]) -> Option<String> {
    let record = ThermalRecord {
        time_s: columns.time_s.clone(),
        ..ThermalRecord::default()
    };
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

/// A note if the rows are so far apart that temperature changes between them could affect the prediction error.
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
    fn a_machine_begins_at_the_temperature_of_a_shop() {
        assert_eq!(never_cold("spindle", &warming()), None);
        let fahrenheit: Vec<f64> = warming().iter().map(|degc| 1.8 * degc + 32.0).collect();
        let said = never_cold("spindle", &fahrenheit).expect("no shop is at 71 °C");
        assert!(said.starts_with("spindle_degc is 71"), "{said}");
    }

    #[test]
    fn faults_of_sensors_are_refused() {
        for (value, rows, says) in [
            // Before its first measurement, at the end, without a sensor, a single outlier.
            (85.0, 0..1, "there and back"),
            (85.0, 60..61, "there and back"),
            (-10.0, 179..180, "there and back"),
            (0.0, 17..18, "in this row alone"),
            (0.0, 40..45, "in 5 rows from here on"),
            // Without contact, kelvin, a broken wire.
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
