//! Plausibility checks of readings, environment and files, with limits from tests of machine tools. The checks only
//! report, and remove nothing.

use std::collections::{BTreeMap, BTreeSet, btree_map::Entry};

use volcomp_vocabulary::{AxisName, Direction};

use crate::{DeviationUnit, Environment, Measurement, Quantity, ReferenceLine, StartEnd};

/// A larger deviation is implausible for a machine tool. The limit is 1 mm (in µm) or 1 mrad (in µrad).
pub const LARGEST_PLAUSIBLE: f64 = 1e3;
/// If all deviations are smaller, they are implausible for a machine tool. The limit is 0.1 µm or 0.1 µrad.
pub const SMALLEST_PLAUSIBLE: f64 = 0.1;
/// Maximum plausible length of a linear axis, mm.
const LONGEST_MM: f64 = 200_000.0;

/// Warnings for the user: the notes of the reader, and anomalies. Anomalies are deviations that are all equal, very
/// large or very small; targets beyond any axis; targets in a unit that does not match the axis; a single target; and
/// outlying runs and readings.
pub fn anomalies(measurement: &Measurement) -> Vec<String> {
    let mut odd = measurement.notes.clone();
    let sizes = || measurement.readings.iter().map(|reading| reading.deviation);
    let line = set_up_along(measurement);
    let largest = measurement.readings.iter().fold(0.0_f64, |largest, of| {
        let from = line.map_or(0.0, |line| line.value_um(of.target));
        largest.max((of.deviation - from).abs())
    });
    let unit = with_space(measurement.unit);
    if measurement.unit.is_none() {
        odd.push("the unit of the deviations is not stated".into());
    }
    let several = measurement.readings.len() > 1;
    if several && sizes().all(|size| Some(size) == sizes().next()) {
        let first = sizes().next().unwrap_or_default();
        odd.push(format!("every deviation is {first}{unit}: was anything measured?"));
    } else {
        odd.extend(small(largest, measurement.unit));
    }
    odd.extend(large(largest, measurement.unit));
    let targets = measurement.targets();
    if let [only] = targets[..] {
        odd.push(format!("there is a single target, {only}"));
    }
    if targets.iter().any(|target| target.abs() > LONGEST_MM) {
        odd.push(format!("targets are beyond {LONGEST_MM} mm: are they in another unit?"));
    }
    let axis = measurement.metadata.axis.as_deref().and_then(axis_named);
    if let Some(axis) = axis
        && let Err(error) = measurement.check_targets(axis)
    {
        odd.push(error.to_string());
    }
    let [forward, backward] = Direction::BOTH.map(|direction| measurement.has(direction));
    if forward
        && backward
        && let Err(error) = measurement.check_directions()
    {
        odd.push(error.to_string());
    }
    odd.extend(outlier_hints(measurement).into_iter().map(|hint| hint.text));
    odd
}

/// Least-squares line of a straightness measurement; `None` for other quantities, and for two targets, which leave no
/// deviation from the line. The line depends on the alignment of the optics instead of the machine, so it is removed
/// before the size of the deviations is checked.
fn set_up_along(measurement: &Measurement) -> Option<ReferenceLine> {
    let is_straightness = measurement.quantity == Some(Quantity::Straightness);
    let points = measurement.mean_curve();
    let points = Some(points).filter(|points| is_straightness && points.len() > 2)?;
    ReferenceLine::least_squares(&points).ok()
}

/// Warning if the largest deviation, µm or µrad, is implausibly large or small for a machine tool. Most often the cause
/// is a wrong unit.
pub fn implausible_size(largest: f64, unit: Option<DeviationUnit>) -> Option<String> {
    large(largest, unit).or_else(|| small(largest, unit))
}

fn large(largest: f64, unit: Option<DeviationUnit>) -> Option<String> {
    (largest > LARGEST_PLAUSIBLE).then(|| {
        let unit = with_space(unit);
        format!(
            "deviations of up to {largest:.0}{unit} are large for a machine tool: are they in another unit?"
        )
    })
}

fn small(largest: f64, unit: Option<DeviationUnit>) -> Option<String> {
    (largest < SMALLEST_PLAUSIBLE).then(|| {
        let unit = with_space(unit);
        format!("every deviation is below {SMALLEST_PLAUSIBLE}{unit}: are they in another unit?")
    })
}

fn with_space(unit: Option<DeviationUnit>) -> String {
    unit.map_or(String::new(), |unit| format!(" {unit}"))
}

/// Axis that is named in a text such as `X`, `x-axis` or `Axis Y`; `None` if the text names no axis or different axes.
pub fn axis_named(text: &str) -> Option<AxisName> {
    let words = text.split(|c: char| !c.is_alphanumeric());
    let mut letters = words.filter_map(|word| word.to_uppercase().parse::<AxisName>().ok());
    let first = letters.next()?;
    letters.all(|other| other == first).then_some(first)
}

/// An outlying run or reading.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OutlierHint {
    /// Number of the run, counted within its direction, from 1.
    pub run: u32,
    /// Direction of the run.
    pub direction: Direction,
    /// The target of a single reading, mm or deg; `None` for a whole run.
    pub target: Option<f64>,
    /// Difference from the median of the runs, in the measurement's unit: signed for a reading, root mean square
    /// over the targets for a run.
    pub size: f64,
    /// Description of the outlier.
    pub text: String,
}

/// A reading is reported if it differs from the median of the runs by more than this multiple of the scatter.
const READING_LIMIT: f64 = 6.0;

/// Minimum number of runs for identifying an outlying run.
const FEWEST_RUNS: usize = 3;

/// Reports outlying runs, and single outlying readings of the other runs.
///
/// Each reading is compared with the median of all runs at its target and direction. The scatter is estimated from the
/// lower quartile of the differences between runs, so that one bad run of three does not hide itself, and is at least
/// the resolution of the readings. The limit is 6 times the scatter for a reading, and 2 + 4/√targets times the scatter
/// for the root mean square of a run. For Gaussian readings of 5 runs each way at 21 targets, 99 % of tests give no
/// hint. Directions with fewer than three runs are skipped.
pub fn outlier_hints(measurement: &Measurement) -> Vec<OutlierHint> {
    let residuals = residuals(measurement);
    let Some(scatter) = scatter(measurement) else {
        return Vec::new();
    };
    let mut runs: BTreeMap<(Direction, u32), Vec<&Residual>> = BTreeMap::new();
    for residual in &residuals {
        runs.entry((residual.direction, residual.run)).or_default().push(residual);
    }
    let unit = measurement.unit.map(|u| format!(" {u}")).unwrap_or_default();
    let mut hints = Vec::new();
    for ((direction, run), residuals) in runs {
        let count = residuals.len() as f64;
        let rms = (residuals.iter().map(|r| r.value.powi(2)).sum::<f64>() / count).sqrt();
        if rms > (2.0 + 4.0 / count.sqrt()) * scatter {
            let text = format!(
                "{} run {run} differs from the other runs by {rms:.2}{unit} (root mean square; usual scatter {scatter:.2}{unit})",
                direction.name()
            );
            hints.push(OutlierHint { run, direction, target: None, size: rms, text });
            continue;
        }
        for residual in residuals.iter().filter(|r| r.value.abs() > READING_LIMIT * scatter) {
            let Residual { target, value, .. } = residual;
            let text = format!(
                "target {target} in {} run {run} differs from the other runs by {value:.2}{unit} (usual scatter {scatter:.2}{unit})",
                direction.name()
            );
            hints.push(OutlierHint { run, direction, target: Some(*target), size: *value, text });
        }
    }
    hints
}

struct Residual {
    target: f64,
    run: u32,
    direction: Direction,
    value: f64,
}

fn residuals(measurement: &Measurement) -> Vec<Residual> {
    let mut residuals = Vec::new();
    for at_target in measurement.by_target() {
        for direction in Direction::BOTH {
            let readings = at_target.of(direction);
            if readings.len() < FEWEST_RUNS {
                continue;
            }
            let median = median(at_target.deviations(direction));
            residuals.extend(readings.iter().map(|(run, deviation)| Residual {
                target: at_target.target,
                run: *run,
                direction,
                value: deviation - median,
            }));
        }
    }
    residuals
}

/// Standard deviation of a reading about the mean of its target. It is robust against single outlying runs and
/// readings.
fn scatter(measurement: &Measurement) -> Option<f64> {
    // This covers all pairs of five runs. With more runs only near neighbours are compared, so that the effort stays
    // linear.
    const FARTHEST_RUN: usize = 4;
    // Lower quartile of |a − b| for two Gaussian readings a and b with standard deviation 1.
    const QUARTILE_OF_GAUSSIAN: f64 = 0.450_624;
    let mut differences: Vec<f64> = Vec::new();
    for at_target in measurement.by_target() {
        for direction in Direction::BOTH {
            let deviations = at_target.deviations(direction);
            if deviations.len() < FEWEST_RUNS {
                continue;
            }
            for apart in 1..=FARTHEST_RUN {
                let pairs = deviations.iter().zip(deviations.iter().skip(apart));
                differences.extend(pairs.map(|(a, b)| (a - b).abs()));
            }
        }
    }
    differences.sort_by(f64::total_cmp);
    let quartile = differences.get(differences.len() / 4)?;
    Some((quartile / QUARTILE_OF_GAUSSIAN).max(smallest_scatter(measurement)))
}

/// Lower bound of the scatter. Rounded readings often coincide, so the bound is a fraction of the rounding step, and at
/// least 0.05 µm or µrad.
fn smallest_scatter(measurement: &Measurement) -> f64 {
    const STEPS: [f64; 4] = [10.0, 1.0, 0.1, 0.01];
    const SHARE: f64 = 0.6;
    const SMALLEST: f64 = 0.05;
    let is_multiple = |x: f64, step: f64| (x / step - (x / step).round()).abs() < 1e-6;
    let all_are =
        |step: &&f64| measurement.readings.iter().all(|r| is_multiple(r.deviation, **step));
    STEPS.iter().find(all_are).map_or(SMALLEST, |step| (SHARE * step).max(SMALLEST))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let upper = values.len() / 2;
    if values.len().is_multiple_of(2) {
        f64::midpoint(values[upper - 1], values[upper])
    } else {
        values[upper]
    }
}

/// Reference temperature of lengths (ISO 1), °C.
pub const REFERENCE_DEGC: f64 = 20.0;

/// Maximum deviation of a material temperature from 20 °C without a note, K. Steel with 11 µm/(m·K) then expands by 11
/// µm/m, which exceeds the error of a laser and is about the error of a good scale.
pub const MATERIAL_WITHIN_K: f64 = 1.0;

/// Plausible range of the temperature in a workshop, °C.
const ROOM_DEGC: [f64; 2] = [-5.0, 60.0];
/// Plausible range of expansion coefficients, from Invar to plastics, µm/(m·K).
const COEFFICIENTS: [f64; 2] = [0.0, 100.0];

/// Notes on the environment of a test. For positioning, they report material that is more than 1 K from 20 °C or
/// changes by more than 1 K during the test, with the effect of the expansion coefficient. For all quantities they
/// report values that are implausible for a workshop.
pub fn environment_notes(environment: &Environment, quantity: Quantity) -> Vec<String> {
    let is_length = quantity == Quantity::Positioning;
    let mut notes = Vec::new();
    for (index, sensor) in environment.material_temperature.iter().enumerate() {
        let Some(degc) = sensor else { continue };
        let name = format!("material temperature {}", index + 1);
        let of_length = || is_length.then(|| material(&name, degc, environment)).flatten();
        notes.extend(room(&name, degc).or_else(of_length));
    }
    if let Some(air) = &environment.air_temperature {
        notes.extend(room("air temperature", air));
    }
    if let Some(coefficient) = &environment.expansion_coefficient {
        let [least, most] = COEFFICIENTS;
        let found = coefficient.start;
        if !(least..=most).contains(&found) {
            notes.push(format!(
                "the expansion coefficient is stated as {found} µm/(m·K), expected {least} to {most}: check its unit"
            ));
        }
    }
    notes
}

/// Describes for the user which data for a correction to 20 °C the file contains: expansion coefficient and material
/// temperatures.
pub fn material_compensation(environment: &Environment) -> String {
    let sensors = environment.material_temperature.iter().flatten().count();
    let coefficient = environment.expansion_coefficient.map(|c| c.start);
    match (coefficient, sensors) {
        (None, _) => "not stated: no expansion coefficient".to_owned(),
        (Some(0.0), _) => "none: the expansion coefficient is 0".to_owned(),
        (Some(coefficient), 0) => {
            format!("{coefficient} µm/(m·K) stated, but no material temperature")
        }
        (Some(coefficient), 1) => {
            format!("{coefficient} µm/(m·K) and one material temperature stated")
        }
        (Some(coefficient), several) => {
            format!("{coefficient} µm/(m·K) and {several} material temperatures stated")
        }
    }
}

fn room(name: &str, degc: &StartEnd) -> Option<String> {
    let [least, most] = ROOM_DEGC;
    let is_room = |value: f64| (least..=most).contains(&value);
    (!is_room(degc.start) || !is_room(degc.end)).then(|| {
        format!(
            "{name} is stated as {} to {} °C, expected {least} to {most} °C: check its unit and sensor",
            degc.start, degc.end
        )
    })
}

fn material(name: &str, degc: &StartEnd, environment: &Environment) -> Option<String> {
    let farthest = [degc.start, degc.end]
        .map(|value| value - REFERENCE_DEGC)
        .into_iter()
        .max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let change = degc.end - degc.start;
    let mut odd = Vec::new();
    if farthest.abs() > MATERIAL_WITHIN_K {
        odd.push(format!("farther than {MATERIAL_WITHIN_K} K from 20 °C"));
    }
    if change.abs() > MATERIAL_WITHIN_K {
        odd.push(format!("changing by {change:.2} K during the test"));
    }
    if odd.is_empty() {
        return None;
    }
    let coefficient = environment.expansion_coefficient.map(|c| c.start);
    let hangs = match coefficient {
        Some(coefficient) if coefficient != 0.0 => format!(
            "with {coefficient} µm/(m·K) the material is {:.1} µm/m from its length at 20 °C; whether the readings were compensated for it the file does not say",
            coefficient * farthest
        ),
        Some(_) => {
            "the expansion coefficient is 0, so the readings are not brought to 20 °C".to_owned()
        }
        None => "no expansion coefficient is stated, so it is not known whether the readings are brought to 20 °C".to_owned(),
    };
    let [start, end] = [degc.start, degc.end].map(|degc| format!("{degc:.2}"));
    let span = if start == end { start } else { format!("{start} to {end}") };
    Some(format!("{name} was {span} °C, {}: {hangs}", odd.join(" and ")))
}

/// Minimum number of different deviations for identifying a test. With fewer, two tests may agree by chance.
const FEWEST_DIFFERENT: usize = 3;

/// Readings of earlier tests, for detecting duplicates. Two tests never have the same scatter, so a second test with
/// the same readings is most likely the same test under another name.
#[derive(Debug, Clone)]
pub struct KnownReadings<T> {
    /// Target, run, direction and magnitude of the deviation of each reading of a test, and the label of the first test
    /// with these readings.
    first: BTreeMap<Vec<[u64; 4]>, T>,
}

impl<T> Default for KnownReadings<T> {
    fn default() -> Self {
        Self { first: BTreeMap::new() }
    }
}

impl<T> KnownReadings<T> {
    /// Compares a test with the earlier tests. If an earlier test has the same readings, apart from the signs of the
    /// deviations, returns its label. Otherwise stores the test with the label `this`, and returns `None`. Readings
    /// with fewer than three different deviations identify no test.
    pub fn before(&mut self, measurement: &Measurement, this: T) -> Option<&T> {
        let key: Vec<[u64; 4]> = (measurement.readings.iter())
            .map(|reading| {
                [
                    // Adding 0 turns −0 into 0, which is the same target.
                    (reading.target + 0.0).to_bits(),
                    u64::from(reading.run),
                    u64::from(reading.direction == Direction::Negative),
                    reading.deviation.abs().to_bits(),
                ]
            })
            .collect();
        let different: BTreeSet<u64> = key.iter().map(|of| of[3]).collect();
        if different.len() < FEWEST_DIFFERENT {
            return None;
        }
        match self.first.entry(key) {
            Entry::Occupied(known) => Some(known.into_mut()),
            Entry::Vacant(place) => {
                place.insert(this);
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse_csv;

    #[test]
    fn axes_are_found_in_words() {
        for (text, axis) in [
            ("X", Some(AxisName::X)),
            (" y-axis", Some(AxisName::Y)),
            ("Axis c", Some(AxisName::C)),
            ("X to Y", None),
            ("Table", None),
            ("", None),
        ] {
            assert_eq!(axis_named(text), axis, "{text}");
        }
    }

    #[test]
    fn implausible_readings_are_reported() {
        let said = |text: &str| anomalies(&parse_csv(text.as_bytes(), "x.csv").unwrap()).join("\n");
        for (text, expected) in [
            ("target,deviation_um\n0,0\n1,0\n", "every deviation is 0 µm"),
            ("target,deviation_um\n0,0.001\n1,0.002\n", "every deviation is below 0.1 µm"),
            ("target,deviation_um\n0,2500\n1,0\n", "up to 2500 µm"),
            ("target,deviation_um\n5,2\n", "a single target, 5"),
            ("target,deviation_um\n0,2\n9000000,3\n", "targets are beyond"),
            ("target,deviation\n0,2\n9,3\n", "not stated"),
        ] {
            assert!(said(text).contains(expected), "{text}: {}", said(text));
        }
        assert_eq!(said("target,deviation_um\n0,2\n9,3\n"), "");
    }

    #[test]
    fn duplicate_readings_are_found_regardless_of_sign() {
        let mut seen = KnownReadings::default();
        let mut before = |name: &'static str, rows: &str| {
            let text = format!("target,run,direction,deviation\n{rows}");
            let measurement = parse_csv(text.as_bytes(), name).unwrap();
            seen.before(&measurement, name).copied()
        };
        assert_eq!(before("a", "0,1,+,1\n10,1,+,2\n20,1,+,4\n"), None);
        assert_eq!(before("b", "0,1,+,-1\n10,1,+,-2\n20,1,+,-4\n"), Some("a"));
        assert_eq!(before("c", "0,1,+,1\n10,1,+,2\n20,1,+,4\n"), Some("a"));
        // The first test differs in the direction, the second in a deviation.
        assert_eq!(before("d", "20,1,-,4\n10,1,-,2\n0,1,-,1\n"), None);
        assert_eq!(before("e", "0,1,+,1\n10,1,+,2\n20,1,+,4.1\n"), None);
        // Tests with only two different deviations often agree by chance.
        assert_eq!(before("f", "0,1,+,0\n10,1,+,1\n20,1,+,1\n"), None);
        assert_eq!(before("g", "0,1,+,0\n10,1,+,1\n20,1,+,1\n"), None);
    }
}
