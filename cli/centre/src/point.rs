//! Points of the history: made of a condition, and means of several.

use std::collections::BTreeMap;

use volcomp_fleet::Condition;

use crate::records::Point;

/// The states of the guard, the best first: of several the last one counts.
const STATES: [&str; 7] = [
    "compensating",
    "disarmed",
    "arming",
    "holding",
    "ramping-out",
    "unknown",
    "faulted",
];

/// How bad a state is; one that is not known is worse than `unknown`.
fn badness(state: &str) -> usize {
    let place = STATES.iter().position(|one| *one == state);
    place.unwrap_or(STATES.len() - 1)
}

/// Three digits behind the point are more than any instrument has told.
fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3 + 0.0
}

/// A number that is still one when it is rounded: JSON has no other, and a row that holds another is never read again.
fn finite(value: f64) -> Option<f64> {
    Some(round(value)).filter(|value| value.is_finite())
}

/// The point of one condition.
pub(crate) fn of(condition: &Condition, at_s: f64) -> Point {
    let known = condition.residual_um.and_then(finite);
    Point {
        at_s: round(at_s),
        count: 1,
        state: condition.state.clone(),
        residual_um: known,
        residual_max_um: known,
        correction_um: rounded(&condition.correction_um),
        correction_urad: rounded(&condition.correction_urad),
        temperatures_degc: (condition.temperatures_degc.iter())
            .filter_map(|(name, degc)| Some((name.clone(), finite((*degc)?)?)))
            .collect(),
        cycle_p99_us: finite(condition.cycle_p99_us).unwrap_or(0.0),
        overruns: condition.overruns,
        faults: condition.faults,
    }
}

fn rounded<K: Ord + Clone>(values: &BTreeMap<K, f64>) -> BTreeMap<K, f64> {
    let known = |(key, value): (&K, &f64)| Some((key.clone(), finite(*value)?));
    values.iter().filter_map(known).collect()
}

/// One point for several, in rising order of time: means weighted by their counts, over the points in which the value is
/// known. `None`: there are none.
pub(crate) fn mean(points: &[Point], at_s: f64) -> Option<Point> {
    let last = points.last()?;
    let worst = points.iter().max_by_key(|point| badness(&point.state))?;
    let residuals = points
        .iter()
        .filter_map(|point| Some((point.count, point.residual_um?)));
    let largest = points.iter().filter_map(|point| point.residual_max_um);
    Some(Point {
        at_s,
        count: points.iter().map(|point| point.count).sum(),
        state: worst.state.clone(),
        residual_um: weighted(residuals),
        residual_max_um: largest.reduce(f64::max),
        correction_um: by_name(points, |point| &point.correction_um),
        correction_urad: by_name(points, |point| &point.correction_urad),
        temperatures_degc: by_name(points, |point| &point.temperatures_degc),
        cycle_p99_us: (points.iter().map(|point| point.cycle_p99_us)).fold(0.0, f64::max),
        overruns: last.overruns,
        faults: last.faults,
    })
}

fn weighted(values: impl Iterator<Item = (u64, f64)>) -> Option<f64> {
    let (mut weight, mut sum) = (0.0, 0.0);
    for (count, value) in values {
        weight += count as f64;
        sum += count as f64 * value;
    }
    finite(sum / weight)
}

fn by_name<K: Ord + Clone>(
    points: &[Point],
    values: impl Fn(&Point) -> &BTreeMap<K, f64>,
) -> BTreeMap<K, f64> {
    let mut sums: BTreeMap<K, (f64, f64)> = BTreeMap::new();
    for point in points {
        for (name, value) in values(point) {
            let (weight, sum) = sums.entry(name.clone()).or_default();
            *weight += point.count as f64;
            *sum += point.count as f64 * value;
        }
    }
    let known = |(name, (weight, sum)): (K, (f64, f64))| Some((name, finite(sum / weight)?));
    sums.into_iter().filter_map(known).collect()
}
