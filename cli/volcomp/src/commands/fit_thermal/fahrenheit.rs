//! Temperatures in degrees Fahrenheit whose heads say °C.

use std::path::Path;

use super::columns::Columns;

/// No shop and no machine that has not run is warmer, °C; one of 10 °C is 50 °F.
const NEVER_COLDER_THAN_F: f64 = 50.0;
/// What the coldest moment of a test may be, °C, and how far sensors may be apart then.
const COLD_DEGC: [f64; 2] = [10.0, 40.0];
const APART_K: f64 = 6.0;
/// A jump by less, K, may be one of the machine.
const JUMP_K: f64 = 20.0;
/// A value beside its double in the other unit.
const SAME_K: f64 = 1.0;

fn degc(fahrenheit: f64) -> f64 {
    (fahrenheit - 32.0) / 1.8
}

/// A note on sensors that are never as cold as a shop is, and would be in the other unit: beside the same sensor in other files, or, where
/// it is as warm in all of them, beside the others.
pub(super) fn of_all(files: &[Columns]) -> Option<String> {
    let first = files.first()?;
    let coldest = |file: &Columns, sensor: usize| {
        let values = file.degc.get(sensor).into_iter().flatten();
        values.copied().fold(f64::INFINITY, f64::min)
    };
    let is_warm = |coldest: f64| {
        coldest >= NEVER_COLDER_THAN_F && (COLD_DEGC[0]..=COLD_DEGC[1]).contains(&degc(coldest))
    };
    let middle_of = |mut values: Vec<f64>| {
        values.retain(|t| t.is_finite() && !is_warm(*t));
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let mut found = Vec::new();
    for (sensor, name) in first.sensors.iter().enumerate() {
        let warm: Vec<usize> = (0..files.len())
            .filter(|file| is_warm(coldest(&files[*file], sensor)))
            .collect();
        let own = middle_of(files.iter().map(|file| coldest(file, sensor)).collect());
        let fits = |file: &usize| {
            let others = (0..first.sensors.len()).map(|other| coldest(&files[*file], other));
            let beside = own.or_else(|| middle_of(others.collect()));
            let here = degc(coldest(&files[*file], sensor));
            beside.is_none_or(|other| (here - other).abs() <= APART_K)
        };
        let Some(file) = warm.iter().find(|file| fits(file)) else {
            continue;
        };
        let lowest = coldest(&files[*file], sensor);
        let place = if warm.len() < files.len() {
            format!(" in file {} of {}", file + 1, files.len())
        } else {
            String::new()
        };
        found.push(format!(
            "{name} is never below {lowest:.1}{place}, which would be {:.1} °C",
            degc(lowest)
        ));
    }
    (!found.is_empty()).then(|| {
        format!(
            "may be degrees Fahrenheit under a head that says °C: {}. Terms for 1 K would be 1.8 times too small, and the reference temperature wrong. A motor that is warm all the time looks the same",
            found.join("; ")
        )
    })
}

/// Notes on sensors whose unit changes from one row to the next.
pub(super) fn changes(path: &Path, file: &Columns) -> Vec<String> {
    let mut notes = Vec::new();
    for (name, values) in file.sensors.iter().zip(&file.degc) {
        let is_change = |pair: &[f64]| {
            let is = |from: f64, to: f64| {
                (to - from).abs() > JUMP_K && (1.8 * from + 32.0 - to).abs() < 1.8 * SAME_K
            };
            is(pair[0], pair[1]) || is(pair[1], pair[0])
        };
        if let Some(row) = values.windows(2).position(is_change) {
            notes.push(format!(
                "{}: {name} goes from {} to {} between two rows at {} s, which is one temperature in °C and in °F: did its unit change there?",
                path.display(),
                values[row],
                values[row + 1],
                file.time_s[row + 1]
            ));
        }
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns(sensors: &[(&str, &[f64])]) -> Columns {
        let rows = sensors.first().map_or(0, |(_, values)| values.len());
        Columns {
            time_s: (0..rows).map(|row| 60.0 * row as f64).collect(),
            sensors: sensors.iter().map(|(name, _)| (*name).to_owned()).collect(),
            degc: sensors.iter().map(|(_, values)| values.to_vec()).collect(),
            displacements: Vec::new(),
            position: None,
            notes: Vec::new(),
        }
    }

    #[test]
    fn fahrenheit_is_named_and_warm_machines_are_not() {
        let said = |sensors: &[(&str, &[f64])]| of_all(&[columns(sensors)]).unwrap_or_default();
        // Steel at 68 °F all day.
        assert!(said(&[("bed", &[68.0, 68.1, 68.0])]).contains("would be 20.0 °C"));
        // One of two sensors.
        let one = said(&[("bed", &[68.0, 70.0]), ("spindle", &[20.5, 31.0])]);
        assert!(
            one.contains("bed is never below 68.0") && !one.contains("spindle"),
            "{one}"
        );
        // One file of three, in which all are as warm.
        let files = [[20.0, 22.0], [20.5, 24.0], [68.5, 75.0]]
            .map(|bed| columns(&[("bed", &bed), ("spindle", &bed)]));
        let one = of_all(&files).unwrap_or_default();
        assert!(
            one.contains("bed is never below 68.5 in file 3 of 3, which would be 20.3 °C"),
            "{one}"
        );
        for machine in [
            &[("bed", &[20.0, 22.0][..]), ("spindle", &[20.0, 75.0][..])][..],
            // A spindle that was never let cool: 12 and 43 °C if it were °F.
            &[("bed", &[22.0, 24.0][..]), ("spindle", &[55.0, 60.0][..])],
            &[("bed", &[22.0, 24.0][..]), ("motor", &[110.0, 120.0][..])],
            &[("bed", &[38.0, 40.0][..])],
            &[],
        ] {
            assert_eq!(said(machine), "");
        }
    }

    #[test]
    fn a_change_of_unit_is_named() {
        let said = |values: &[f64]| changes(Path::new("a.csv"), &columns(&[("bed", values)]));
        for values in [[20.0, 20.1, 68.2, 68.4], [68.2, 68.0, 20.0, 20.1]] {
            let notes = said(&values);
            assert_eq!(notes.len(), 1, "{notes:?}");
            assert!(notes[0].contains("at 120 s"), "{notes:?}");
        }
        // Coolant is switched on, and −40 °C is −40 °F.
        assert!(said(&[45.0, 22.0, 21.0]).is_empty());
        assert!(said(&[-40.0, -40.0]).is_empty());
    }
}
