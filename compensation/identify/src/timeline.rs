//! Order of the rows: their time for the drift, and the approach direction of each axis, which is unknown before the
//! first move of the axis if the file does not state it.
//!
//! Before its first move an axis had been approached from one of its two sides. In all rows before this move its errors
//! were therefore the mean of both directions, plus or minus half the reversal value. The sign is described by one number for each run of the machine
//! and each axis, with mean 0 and standard uncertainty 1, in units of half the reversal value. The numbers are not
//! results: they are eliminated from the equations. The elimination leaves the other unknowns unchanged and makes the
//! equations independent again (generalised least squares, A. C. Aitken, Proceedings of the Royal Society of Edinburgh
//! 55, 1935). If the reversal value is unknown itself, each error has a separate number, and half the reversal value
//! has its identified size, or the size that its uncertainty allows.

use std::collections::BTreeMap;

use volcomp_kinematics::State;
use volcomp_kinematics::nalgebra::{DMatrix, DVector};
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

/// Run, axis, and coefficient of the unknown reversal value (`None` if the reversal value is known) to which a number belongs.
pub(crate) type Key = (usize, usize, Option<usize>);

#[derive(Clone, Debug, Default)]
pub(crate) struct Sides(BTreeMap<Key, BTreeMap<usize, f64>>);

struct Run {
    equations: Vec<usize>,
    columns: DMatrix<f64>,
}

impl Sides {
    pub(crate) fn add(&mut self, key: Key, equation: usize, by: f64) {
        *self.0.entry(key).or_default().entry(equation).or_default() += by;
    }

    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    pub(crate) fn has_unknown(&self) -> bool {
        self.0.keys().any(|(_, _, unknown)| unknown.is_some())
    }

    pub(crate) fn scale(&mut self, by: impl Fn(usize) -> f64) {
        for (equation, value) in self.0.values_mut().flatten() {
            *value *= by(*equation);
        }
    }

    /// Dense columns of all numbers, or only of the numbers of unknown reversal values, with `equations` rows.
    pub(crate) fn columns(&self, equations: usize, of_unknown: bool) -> DMatrix<f64> {
        let selected = self.0.iter().filter(|(key, _)| !of_unknown || key.2.is_some());
        let columns: Vec<DVector<f64>> = selected
            .map(|(_, column)| {
                let mut dense = DVector::zeros(equations);
                for (&equation, &by) in column {
                    dense[equation] = by;
                }
                dense
            })
            .collect();
        if columns.is_empty() {
            DMatrix::zeros(equations, 0)
        } else {
            DMatrix::from_columns(&columns)
        }
    }

    pub(crate) fn add_to(&self, residuals: &mut DVector<f64>, values: &DVector<f64>) {
        for (column, value) in self.0.values().zip(values) {
            for (&equation, by) in column {
                residuals[equation] += by * value;
            }
        }
    }

    fn runs(&self) -> Vec<Run> {
        let mut runs: BTreeMap<usize, Vec<&BTreeMap<usize, f64>>> = BTreeMap::new();
        for (key, column) in &self.0 {
            runs.entry(key.0).or_default().push(column);
        }
        let of_run = |columns: Vec<&BTreeMap<usize, f64>>| {
            let mut equations: Vec<usize> =
                columns.iter().flat_map(|c| c.keys().copied()).collect();
            equations.sort_unstable();
            equations.dedup();
            let at = |row: usize, column: usize| {
                let of_column: &BTreeMap<usize, f64> = columns[column];
                of_column.get(&equations[row]).copied().unwrap_or(0.0)
            };
            let columns = DMatrix::from_fn(equations.len(), columns.len(), at);
            Run { equations, columns }
        };
        runs.into_values().map(of_run).collect()
    }

    /// Eliminates the numbers: transforms a matrix, whose columns are derivatives or residuals, so that its rows belong
    /// to independent readings of variance 1.
    pub(crate) fn eliminate(&self, matrix: &mut DMatrix<f64>) {
        for Run { equations, columns } in self.runs() {
            // (1 + G·Gᵀ)^(-1/2) from the eigenvectors of Gᵀ·G, which are few.
            let eigen = (columns.transpose() * &columns).symmetric_eigen();
            let largest = eigen.eigenvalues.max();
            let mut own = matrix.select_rows(&equations);
            for (vector, &square) in eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues) {
                if square > 1e-12 * largest {
                    let along = &columns * vector / square.sqrt();
                    let less = 1.0 - 1.0 / (1.0 + square).sqrt();
                    let part = along.transpose() * &own * less;
                    own -= along * part;
                }
            }
            for (row, &equation) in equations.iter().enumerate() {
                matrix.row_mut(equation).copy_from(&own.row(row));
            }
        }
    }

    /// Like [`Sides::eliminate`], for a single column.
    pub(crate) fn eliminate_from(&self, column: &mut DVector<f64>) {
        let mut matrix = DMatrix::from_column_slice(column.len(), 1, column.as_slice());
        self.eliminate(&mut matrix);
        column.copy_from(&matrix.column(0));
    }

    pub(crate) fn estimate(&self, residuals: &DVector<f64>) -> DVector<f64> {
        let mut found = Vec::with_capacity(self.len());
        for Run { equations, columns } in self.runs() {
            let own = residuals.select_rows(&equations);
            let count = columns.ncols();
            let normal = columns.transpose() * &columns + DMatrix::identity(count, count);
            let right = -(columns.transpose() * own);
            // The matrix is positive definite unless a value is NaN.
            let values = normal.cholesky().map(|normal| normal.solve(&right));
            found.extend(values.unwrap_or_else(|| DVector::zeros(count)).iter());
        }
        DVector::from_vec(found)
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

    #[test]
    fn elimination_equals_the_full_covariance() {
        let mut sides = Sides::default();
        for (key, equation, by) in [
            ((0, 0, None), 0, 3.0),
            ((0, 0, None), 2, -1.0),
            ((0, 1, Some(4)), 2, 0.5),
            ((0, 1, Some(4)), 3, 700.0),
            ((1, 0, None), 1, 2.0),
        ] {
            sides.add(key, equation, by);
        }
        let columns = sides.columns(5, false);
        assert_eq!(sides.columns(5, true).ncols(), 1);
        let covariance = DMatrix::identity(5, 5) + &columns * columns.transpose();
        let residuals = DVector::from_vec(vec![1.0, -2.0, 0.7, 3.0, 0.1]);
        let inverse = covariance.try_inverse().expect("positive definite");
        let expected = residuals.dot(&(inverse * &residuals));
        let mut matrix = DMatrix::from_columns(std::slice::from_ref(&residuals));
        sides.eliminate(&mut matrix);
        assert!((matrix.norm_squared() - expected).abs() < 1e-9 * expected);
        let values = sides.estimate(&residuals);
        let mut left = residuals.clone();
        sides.add_to(&mut left, &values);
        let squares = left.norm_squared() + values.norm_squared();
        assert!((squares - expected).abs() < 1e-9 * expected);
    }
}
