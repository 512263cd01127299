//! Runs and directions of approach from the order in which targets were visited.

use crate::Direction;

/// Run and direction of approach of each target, for targets in the order of travel. The number of a run counts the
/// runs of its direction, from 1.
///
/// A target is approached in the direction of the move towards it. If a target is repeated, its second approach is from
/// the other side, as after an overrun at the end of the travel. A single move back over several targets, after which
/// the axis continues in the first direction, is the return of a unidirectional test. The target of this move begins
/// the next run.
pub(crate) fn runs_by_travel(targets: &[f64]) -> Vec<(u32, Direction)> {
    let directions = directions(targets);
    let mut runs = [0_u32; 2];
    let mut result: Vec<(u32, Direction)> = Vec::with_capacity(targets.len());
    for (index, (direction, begins)) in directions.iter().enumerate() {
        let is_new = index == 0 || *begins || directions[index - 1].0 != *direction;
        let run = &mut runs[usize::from(*direction == Direction::Negative)];
        *run += u32::from(is_new);
        result.push((*run, *direction));
    }
    result
}

/// Direction of each approach, and whether the approach begins a new run in the same direction.
fn directions(targets: &[f64]) -> Vec<(Direction, bool)> {
    let toward = |from: f64, to: f64| {
        if to > from { Direction::Positive } else { Direction::Negative }
    };
    let Some(moved) = targets.windows(2).position(|pair| pair[0] != pair[1]) else {
        return vec![(Direction::Positive, true); targets.len()];
    };
    let first = toward(targets[moved], targets[moved + 1]);
    let mut found: Vec<(Direction, bool)> = (0..=moved)
        .map(|index| match (moved - index) % 2 {
            0 => (first, false),
            _ => (-first, false),
        })
        .collect();
    for index in moved + 1..targets.len() {
        let direction = if targets[index] == targets[index - 1] {
            -found[index - 1].0
        } else {
            toward(targets[index - 1], targets[index])
        };
        found.push((direction, false));
    }
    let mut sorted: Vec<f64> = targets.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    let place = |target: f64| sorted.partition_point(|other| *other < target);
    for index in 1..found.len().saturating_sub(1) {
        let steps = place(targets[index]).abs_diff(place(targets[index - 1]));
        let alone = found[index].0 != found[index - 1].0 && found[index].0 != found[index + 1].0;
        if alone && steps > 1 {
            found[index] = (found[index + 1].0, true);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(targets: &[f64]) -> String {
        let found = runs_by_travel(targets);
        let one = |(run, direction): &(u32, Direction)| {
            let sign = if *direction == Direction::Positive { '+' } else { '-' };
            format!("{sign}{run}")
        };
        found.iter().map(one).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn the_order_of_travel_gives_runs_and_directions() {
        // A bidirectional test with an overrun at both ends.
        assert_eq!(
            shown(&[0.0, 1.0, 2.0, 2.0, 1.0, 0.0, 0.0, 1.0, 2.0]),
            "+1 +1 +1 -1 -1 -1 +2 +2 +2"
        );
        // Without an overrun, the last target is approached once.
        assert_eq!(shown(&[0.0, 1.0, 2.0, 1.0, 0.0]), "+1 +1 +1 -1 -1");
        // A unidirectional test whose return is not measured.
        assert_eq!(shown(&[0.0, 1.0, 2.0, 0.0, 1.0, 2.0]), "+1 +1 +1 +2 +2 +2");
        assert_eq!(shown(&[2.0, 1.0, 0.0, 2.0, 1.0, 0.0]), "-1 -1 -1 -2 -2 -2");
        // The first target is repeated, so it is approached from both sides.
        assert_eq!(shown(&[0.0, 0.0, 1.0]), "-1 +1 +1");
        assert_eq!(shown(&[5.0]), "+1");
        assert_eq!(shown(&[]), "");
    }
}
