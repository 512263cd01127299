//! Checks for wrong thermal terms: disconnected sensors, files of opposite sign, rows too far apart.

use std::path::{Path, PathBuf};

use volcomp_fit::{ThermalGap, ThermalRecord, ThermalRun, ThermalSearch, search_thermal};

use super::columns::{Channel, Columns, is_angular};
use crate::commands::{fixed, range};

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
