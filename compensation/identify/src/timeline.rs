//! Order of the rows: their time for the drift, and the approach direction of each axis.

use volcomp_kinematics::State;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, Direction, MAX_AXES, TURNED_AFTER, TURNED_AFTER_ROTARY};

use crate::observations::{Observation, Row, RowReading};

pub(crate) struct OrderedObservation {
    pub(crate) observation: Observation,
    pub(crate) orders: Vec<f64>,
    pub(crate) has_order: bool,
    pub(crate) has_drift: bool,
}

fn frame_of(observation: &Observation) -> Option<usize> {
    observation.rows.first().and_then(|row| match row.reading {
        RowReading::Point { frame, .. } => Some(frame),
        _ => None,
    })
}

/// Sets time and approach direction of every row. Files with the column `order` and the same frame form one run; each
/// other file is a separate run. The rows of a predicted file use the time scale of the fitted rows.
pub(crate) fn set_times(
    mut timed: Vec<OrderedObservation>,
    machine: &Machine,
    notes: &mut Vec<String>,
) -> Vec<Observation> {
    for place in 0..timed.len() {
        let frame = frame_of(&timed[place].observation);
        let has_order = timed[place].has_order;
        let together = |other: &OrderedObservation| {
            frame.is_some() && frame_of(&other.observation) == frame && other.has_order == has_order
        };
        let range_of = |timed: &[OrderedObservation], fitted: bool| {
            let runs = timed.iter().enumerate();
            let runs = runs.filter(|(index, run)| {
                (*index == place || together(run)) && !(fitted && run.observation.judge)
            });
            let orders = runs.flat_map(|(_, run)| run.orders.iter().copied());
            orders.fold([f64::INFINITY, f64::NEG_INFINITY], |r, o| [r[0].min(o), r[1].max(o)])
        };
        let mut range = range_of(&timed, true);
        if range[0] > range[1] {
            range = range_of(&timed, false);
        }
        let orders = timed[place].orders.clone();
        let rows = &mut timed[place].observation.rows;
        for (row, order) in rows.iter_mut().zip(orders) {
            let width = range[1] - range[0];
            let time = if width > 0.0 { 2.0 * (order - range[0]) / width - 1.0 } else { 0.0 };
            row.time = time.clamp(-1.0, 1.0);
        }
        if timed[place].observation.judge
            && !has_order
            && timed.iter().any(|t| t.has_drift && !t.observation.judge)
        {
            notes.push(format!(
                "{}: without a column `order`, its rows get the drift of the same row numbers of the fitted file",
                timed[place].observation.file
            ));
        }
    }
    // The rows of each run in their order, with the index of their file and row.
    let mut done = vec![false; timed.len()];
    for first in 0..timed.len() {
        if done[first] {
            continue;
        }
        let frame = frame_of(&timed[first].observation);
        let run: Vec<usize> = (first..timed.len())
            .filter(|&other| {
                let same = frame.is_some() && frame_of(&timed[other].observation) == frame;
                other == first || (same && timed[first].has_order && timed[other].has_order)
            })
            .collect();
        let mut places: Vec<(f64, usize, usize)> = Vec::new();
        for &index in &run {
            done[index] = true;
            let orders = timed[index].orders.iter().enumerate();
            places.extend(orders.map(|(row, &order)| (order, index, row)));
        }
        places.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut approach = Approach::default();
        for (_, index, row) in places {
            let row: &mut Row = &mut timed[index].observation.rows[row];
            row.run = Some(first);
            // The directions of these poses were set when the rows were read, from the order in which the poses are
            // listed.
            if let RowReading::Pair { .. } = row.reading {
                continue;
            }
            approach.to(&mut row.pose.state, machine);
        }
    }
    timed.into_iter().map(|timed| timed.observation).collect()
}

/// Displacement of an axis. For a periodic axis it is the displacement over the shorter way, which may pass the end of
/// the period.
fn shortest_travel(travelled: f64, period: Option<f64>) -> f64 {
    match period {
        // A travel of exactly half a period keeps its stated sign.
        Some(period) if travelled.abs() > 0.5 * period * (1.0 + 1e-9) => {
            travelled - period * (travelled / period).round()
        }
        _ => travelled,
    }
}

/// Tracks the approach direction of each axis over successive poses. A reversal counts after travel beyond [`TURNED_AFTER`]
/// or [`TURNED_AFTER_ROTARY`] from the last turning point. An axis with `modulo` takes the shorter way: from 270 to 0
/// deg it continues in the positive direction.
#[derive(Clone, Debug, Default)]
pub struct Approach {
    /// Last turning point of each axis, mm or rad.
    extreme: Option<[f64; MAX_AXES]>,
    direction: [Option<Direction>; MAX_AXES],
}

impl Approach {
    /// Starts with these approach directions, in chain order; `None`: unknown.
    #[must_use]
    pub fn from_sides(direction: [Option<Direction>; MAX_AXES]) -> Self {
        Self { extreme: None, direction }
    }

    /// Moves to a state of the machine and sets its approach directions; `None` for an axis that
    /// has not moved yet and whose direction is unknown.
    pub fn to(&mut self, state: &mut State, machine: &Machine) {
        let extreme = self.extreme.get_or_insert(state.q.0);
        for (axis, (described, &q)) in machine.axes().iter().zip(&state.q).enumerate() {
            let threshold = match described.name.kind() {
                AxisKind::Linear => TURNED_AFTER.0,
                AxisKind::Rotary => TURNED_AFTER_ROTARY.to_rad().0,
            };
            let travelled =
                shortest_travel(q - extreme[axis], described.modulo.map(f64::to_radians));
            let now = Direction::of(travelled);
            if travelled.abs() > threshold {
                self.direction[axis] = now;
                extreme[axis] = q;
            } else if now.is_some() && now == self.direction[axis] {
                extreme[axis] = q;
            }
        }
        for (place, direction) in state.approach.iter_mut().zip(self.direction) {
            *place = direction;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_with_modulo_takes_the_shorter_way() {
        let machine = |modulo: &str| {
            let text = format!(
                "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [0, 1]\nY.travel = [0, 1]\nZ.travel = [0, 1]\nC = {{ travel = [0, 360]{modulo} }}\n"
            );
            Machine::parse(&text, "m.toml").expect("a good machine")
        };
        let sides = |modulo: &str, places: &[f64]| -> Vec<Option<Direction>> {
            let machine = machine(modulo);
            let mut approach = Approach::default();
            let side = |deg: &f64| {
                let mut state = State::default();
                state.q[0] = deg.to_radians();
                approach.to(&mut state, &machine);
                state.approach[0]
            };
            places.iter().map(side).collect()
        };
        let [up, down] = [1.0, -1.0].map(Direction::of);
        let rounds = [0.0, 90.0, 180.0, 270.0, 0.0, 90.0];
        assert_eq!(sides(", modulo = 360", &rounds), [None, up, up, up, up, up]);
        assert_eq!(sides("", &rounds), [None, up, up, up, down, up]);
        assert_eq!(sides(", modulo = 360", &[0.0, 180.0, 0.0, 270.0]), [None, up, down, down]);
    }
}
