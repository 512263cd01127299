//! Several lines of one error side by side: their mean readings at the same targets.

use volcomp_metrology::ReferenceLine;
use volcomp_vocabulary::Direction;

use crate::profile::Profile;

/// Mean readings of several lines at targets that all of them cover, each line without its own zero, which carries
/// nothing; straightness lines without a line of their own.
pub(crate) struct SideBySide {
    /// The direction of travel and the target of each place, mm or deg.
    pub(crate) places: Vec<(Direction, f64)>,
    /// The values of each line, by place, µm or µrad.
    pub(crate) lines: Vec<Vec<f64>>,
    /// Whether a line had to be interpolated, because its targets are others.
    pub(crate) is_interpolated: bool,
}

impl SideBySide {
    /// `None` where the lines have fewer than three targets in common, or no direction.
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

    /// Values by place without their mean, those of straightness without their least-squares line.
    pub(crate) fn without_zero(&self, values: Vec<f64>, is_straightness: bool) -> Vec<f64> {
        let targets = self.places.iter().map(|(_, target)| *target);
        let points: Vec<(f64, f64)> = targets.zip(values.iter().copied()).collect();
        if is_straightness && let Ok(line) = ReferenceLine::least_squares(&points) {
            return line
                .removed_from(&points)
                .into_iter()
                .map(|(_, value)| value)
                .collect();
        }
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        values.into_iter().map(|value| value - mean).collect()
    }
}

/// The value of a profile at a target within it, straight between its own targets, and whether it lies between two.
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
