//! Reduces the number of points without a visible difference.

/// Maximum number of drawn points of one plot.
pub const MOST_POINTS: usize = 6000;

/// Reduces points in ascending x to about `most`. The range is divided into equal parts, of which the first, smallest, largest and last value are
/// kept, so that peaks remain. Points that are not finite are removed.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "held between 0 and the number of parts"
)]
pub fn thinned(points: &[(f64, f64)], most: usize) -> Vec<(f64, f64)> {
    let is_finite = |(x, y): &&(f64, f64)| x.is_finite() && y.is_finite();
    let finite: Vec<(f64, f64)> = points.iter().filter(is_finite).copied().collect();
    if finite.len() <= most.max(8) {
        return finite;
    }
    let parts = (most / 4).max(2);
    let (low, high) =
        finite.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (x, _)| {
            (low.min(*x), high.max(*x))
        });
    let width = (high - low) / parts as f64;
    let part_of = |x: f64| {
        if width > 0.0 && width.is_finite() {
            // Between 0 and `parts` for any x.
            (((x - low) / width).clamp(0.0, parts as f64 - 1.0)) as usize
        } else {
            0
        }
    };
    let mut kept = Vec::new();
    for part in finite.chunk_by(|a, b| part_of(a.0) == part_of(b.0)) {
        let by_value = |a: &usize, b: &usize| part[*a].1.total_cmp(&part[*b].1);
        let mut places = vec![0, part.len() - 1];
        places.extend((0..part.len()).min_by(by_value));
        places.extend((0..part.len()).max_by(by_value));
        places.sort_unstable();
        places.dedup();
        kept.extend(places.into_iter().map(|place| part[place]));
    }
    kept
}

/// Drops points of a path that are not finite, and points that are nearer than `least` to the previous kept point.
/// Finite points that begin a line, and a finite last point, are kept.
pub(super) fn spaced(
    points: &[([f64; 2], bool)],
    least: f64,
) -> impl Iterator<Item = ([f64; 2], bool)> {
    let mut before: Option<[f64; 2]> = None;
    let last = points.len().saturating_sub(1);
    let kept = points.iter().enumerate().filter(move |(place, (at, begins))| {
        if !(at[0].is_finite() && at[1].is_finite()) {
            return false;
        }
        let near = before.is_some_and(|from| (at[0] - from[0]).hypot(at[1] - from[1]) < least);
        let keeps = !near || *begins || *place == last;
        if keeps {
            before = Some(*at);
        }
        keeps
    });
    kept.map(|(_, point)| *point)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_at_one_place_and_few_points_are_no_trouble() {
        let same = vec![(5.0, 1.0); 100];
        assert!(!thinned(&same, 10).is_empty());
        assert_eq!(thinned(&[(1.0, 2.0)], 100), [(1.0, 2.0)]);
        assert!(thinned(&[], 100).is_empty());
    }
}
