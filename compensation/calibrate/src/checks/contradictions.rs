//! Lines of one error that contradict each other after the tilts of their axis have been removed.

use std::collections::BTreeMap;

use volcomp_fit::unevenness;
use volcomp_metrology::{MotionKind, ReferenceLine};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{Component, Direction, ErrorName};

use crate::{
    abbe::Lever,
    profile::{Points, Profile},
};

const TIMES_NOISE: f64 = 3.0;
/// Differences up to this value are insignificant for any machine tool, µm or µrad.
const NEVER_BELOW: f64 = 0.5;
/// Minimum noise of an instrument, µm or µrad.
const LEAST_NOISE: f64 = 0.01;

pub(crate) struct Tilts<'a> {
    pub(crate) machine: &'a Machine,
    /// Standard deviation of each tilt at a target, µrad. Tilts without a value are treated as
    /// exact.
    pub(crate) noise_urad: &'a BTreeMap<ErrorName, f64>,
    /// See `Angular::found_from`.
    pub(crate) found_from: &'a BTreeMap<ErrorName, [Points; 2]>,
}

/// Notes on the lines of an error that disagree beyond their noise, after the contributions of tilts and locations are removed. `tilts` is `None` if
/// no tilt acts on the error.
pub(crate) fn contradictions(
    error: ErrorName,
    cleared: &[Profile<'_>],
    tilts: Option<&Tilts<'_>>,
) -> Result<Vec<(ErrorName, String)>, ModelError> {
    let mut notes = Vec::new();
    for (second, line_2) in cleared.iter().enumerate() {
        for line_1 in cleared.iter().take(second) {
            let note = contradiction(error, [line_1, line_2], tilts)?;
            notes.extend(note.map(|note| (error, note)));
        }
    }
    Ok(notes)
}

fn contradiction(
    error: ErrorName,
    cleared: [&Profile<'_>; 2],
    tilts: Option<&Tilts<'_>>,
) -> Result<Option<String>, ModelError> {
    let is_straightness = MotionKind::of(error) == MotionKind::Straightness;
    let Some(beside) = ParallelReadings::of(&cleared, is_straightness) else {
        return Ok(None);
    };
    let pairs = beside.lines[0].iter().zip(&beside.lines[1]);
    let difference: Vec<f64> = pairs.map(|(first, second)| first - second).collect();
    let Some(noise) = noise(cleared, &beside) else {
        return Ok(None);
    };
    let of_tilts = tilts.map_or(Ok(0.0), |tilts| tilts.noise_um(error, cleared, &beside))?;
    let noise = noise.hypot(of_tilts).max(LEAST_NOISE);
    let rms = (difference.iter().map(|d| d * d).sum::<f64>() / difference.len() as f64).sqrt();
    let largest = difference.iter().fold(0.0_f64, |largest, d| largest.max(d.abs()));
    if rms <= TIMES_NOISE * noise || largest <= NEVER_BELOW {
        return Ok(None);
    }
    let unit = error.component.symbol();
    let [first, second] = cleared.map(|profile| profile.line.file.display().to_string());
    Ok(Some(format!(
        "{error}: {first} and {second} contradict each other by up to ±{largest:.1} {unit}, RMS {rms:.1} {unit}, which is {:.0} times their noise of {noise:.2} {unit}: check the files, and their `point`, `at`, `unit` and `sign`",
        rms / noise
    )))
}

impl Tilts<'_> {
    /// Contribution of the noise of the tilts to the difference of two lines, µm: RMS over the
    /// targets of each tilt's noise times the difference of the lines' lever arms.
    fn noise_um(
        &self,
        error: ErrorName,
        lines: [&Profile<'_>; 2],
        beside: &ParallelReadings,
    ) -> Result<f64, ModelError> {
        let [first, second] = lines.map(|profile| Lever::new(profile.line, self.machine));
        let (first, second) = (first?, second?);
        let angular = Component::ALL.into_iter().filter(|c| c.is_angular());
        let noise_urad: Vec<f64> = angular
            .map(|component| {
                let tilt = ErrorName::motion(component, error.axis);
                self.noise_urad.get(&tilt).copied().unwrap_or_default()
            })
            .collect();
        let mut variance = 0.0;
        for (_, target) in &beside.places {
            let [at_first, at_second] = [&first, &second].map(|lever| lever.um_of_mrad(*target));
            for (about, noise_urad) in noise_urad.iter().enumerate() {
                let um_of_urad = (at_first[about] - at_second[about]) * 1e-3;
                variance += (um_of_urad * noise_urad).powi(2);
            }
        }
        Ok((variance / beside.places.len().max(1) as f64).sqrt())
    }
}

/// Standard deviation of the mean of the lines of one error at a target: from repeated runs, otherwise from the
/// unevenness of each line between targets, which is an upper bound. `None` if the noise of one line is unknown.
pub(crate) fn noise_of_lines(profiles: &[Profile<'_>]) -> Option<f64> {
    let mut variance = 0.0;
    for profile in profiles {
        let uneven = || profile.unevenness();
        variance += profile.noise_of_shape().or_else(uneven)?.powi(2);
    }
    (!profiles.is_empty()).then(|| variance.sqrt() / profiles.len() as f64)
}

/// Standard deviation of the difference of two lines: from repeated runs, otherwise from the
/// unevenness of each line between targets, which also covers the error of interpolated targets.
fn noise(profiles: [&Profile<'_>; 2], beside: &ParallelReadings) -> Option<f64> {
    let mut variance = 0.0;
    for (profile, values) in profiles.iter().zip(&beside.lines) {
        let points = beside.places.iter().zip(values);
        // Each direction is evaluated separately: between the end of one direction and the beginning of the other
        // direction, a value jumps by the total slope.
        let uneven = Direction::BOTH.into_iter().filter_map(|direction| {
            let own = points.clone().filter(|((of, _), _)| *of == direction);
            unevenness(&own.map(|((_, at), value)| (*at, *value)).collect::<Vec<_>>())
        });
        let uneven = uneven.reduce(f64::max);
        let own = match profile.noise_of_shape() {
            Some(noise) if !beside.is_interpolated => noise,
            Some(noise) => noise.max(uneven?),
            None => uneven?,
        };
        variance += own * own;
    }
    Some(variance.sqrt())
}

/// Mean readings of parallel lines at their common targets, offset removed (and, for straightness, the fitted slope).
pub(crate) struct ParallelReadings {
    /// Direction of travel and target of each place, mm or deg.
    pub(crate) places: Vec<(Direction, f64)>,
    /// Values of each line, by place, µm or µrad.
    pub(crate) lines: Vec<Vec<f64>>,
    pub(crate) is_interpolated: bool,
}

impl ParallelReadings {
    /// `None` if the lines have fewer than three targets in common or no common direction.
    pub(crate) fn of(profiles: &[&Profile<'_>], is_straightness: bool) -> Option<Self> {
        let mut side_by_side = Self {
            places: Vec::new(),
            lines: vec![Vec::new(); profiles.len()],
            is_interpolated: false,
        };
        for (branch, direction) in Direction::BOTH.into_iter().enumerate() {
            let points = || profiles.iter().map(|profile| &profile.points[branch]);
            if points().any(Vec::is_empty) {
                continue;
            }
            let firsts = points().filter_map(|points| points.first());
            let from = firsts.map(|(q, _)| *q).fold(f64::NEG_INFINITY, f64::max);
            let lasts = points().filter_map(|points| points.last());
            let to = lasts.map(|(q, _)| *q).fold(f64::INFINITY, f64::min);
            let all = points().flatten().map(|(target, _)| *target);
            let mut targets: Vec<f64> = all.filter(|q| (from..=to).contains(q)).collect();
            targets.sort_by(f64::total_cmp);
            targets.dedup();
            for target in targets {
                side_by_side.places.push((direction, target));
                for (values, points) in side_by_side.lines.iter_mut().zip(points()) {
                    let (value, is_between) = value_at(points, target);
                    values.push(value);
                    side_by_side.is_interpolated |= is_between;
                }
            }
        }
        if side_by_side.places.len() < 3 {
            return None;
        }
        for line in 0..side_by_side.lines.len() {
            let values = std::mem::take(&mut side_by_side.lines[line]);
            side_by_side.lines[line] = side_by_side.without_zero(values, is_straightness);
        }
        Some(side_by_side)
    }

    /// Subtracts from the values of a line their mean, or for straightness their least-squares line.
    pub(crate) fn without_zero(&self, values: Vec<f64>, is_straightness: bool) -> Vec<f64> {
        let targets = self.places.iter().map(|(_, target)| *target);
        let points: Vec<(f64, f64)> = targets.zip(values.iter().copied()).collect();
        if is_straightness && let Ok(line) = ReferenceLine::least_squares(&points) {
            return line.removed_from(&points).into_iter().map(|(_, value)| value).collect();
        }
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        values.into_iter().map(|value| value - mean).collect()
    }
}

/// Value of a profile at a target within its range, and whether the value is linearly interpolated between two targets
/// of the profile.
fn value_at(points: &[(f64, f64)], target: f64) -> (f64, bool) {
    let after = points.partition_point(|(q, _)| *q < target);
    match (points.get(after.wrapping_sub(1)), points.get(after)) {
        (_, Some((q, value))) if *q == target => (*value, false),
        (Some((q_0, x_0)), Some((q_1, x_1))) => {
            (x_0 + (x_1 - x_0) * (target - q_0) / (q_1 - q_0), true)
        }
        (Some((_, value)), None) | (None, Some((_, value))) => (*value, true),
        (None, None) => (0.0, true),
    }
}
