//! Plausibility of the temperatures of a sensor.

use std::ops::RangeInclusive;

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
