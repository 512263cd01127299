//! Linear axes that are dependent because rotary axes between them make them parallel: opposite moves of such axes
//! leave the tip in place.

use arrayvec::ArrayVec;
use nalgebra::SMatrix;

use crate::{chain::Chain, source::State};
use volcomp_vocabulary::{AxisKind, MAX_AXES, PerAxis};

/// Maximum tip displacement of a dependent move, relative to the move: 1 µm per metre.
const DEPENDENT_BELOW: f64 = 1e-6;
/// Three sets of rotary angles, rad, at which the largest rank of the linear axes is determined: machine zero, and two
/// sets of arbitrary angles at which no axes are parallel.
const GENERIC_ANGLES_RAD: [[f64; MAX_AXES]; 3] = [
    [0.0; MAX_AXES],
    [0.37, 0.83, 1.21, 0.59, 1.07, 0.71, 1.33, 0.47, 0.97],
    [-1.13, 0.61, -0.43, 1.27, -0.79, 0.53, -1.01, 0.89, -0.67],
];

impl Chain {
    /// Moves of the linear axes that leave the ideal tip in place at the rotary angles of `state`. Components are in
    /// the order of the chain, scaled so that the largest is 1. Empty if there are as many such moves at all rotary
    /// angles, as on a machine with two axes in one direction (U parallel to X).
    pub fn dependent_moves(&self, state: &State) -> ArrayVec<PerAxis<f64>, MAX_AXES> {
        let found = self.moves_of_nothing(state);
        let elsewhere = GENERIC_ANGLES_RAD.map(|q| {
            let mut at = State::default();
            for (at, q) in at.q.iter_mut().zip(q) {
                *at = q;
            }
            self.moves_of_nothing(&at).len()
        });
        let [a, b, c] = elsewhere;
        if found.len() > a.min(b).min(c) { found } else { ArrayVec::new() }
    }

    fn moves_of_nothing(&self, state: &State) -> ArrayVec<PerAxis<f64>, MAX_AXES> {
        let columns = self.linear_columns(state);
        let is_linear = |place: usize| {
            let joint = self.joints().get(place);
            joint.is_some_and(|joint| joint.kind == AxisKind::Linear)
        };
        // An axis that cannot move gets the separate eigenvalue 1.
        let gram = SMatrix::<f64, MAX_AXES, MAX_AXES>::from_fn(|i, j| {
            if is_linear(i) && is_linear(j) {
                columns[i].dot(&columns[j])
            } else {
                f64::from(u8::from(i == j))
            }
        });
        let eigen = gram.symmetric_eigen();
        let mut found = ArrayVec::new();
        for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value >= DEPENDENT_BELOW * DEPENDENT_BELOW {
                continue;
            }
            // The first component of maximum magnitude is scaled to +1.
            let most = vector.amax();
            let first = vector.iter().find(|move_| move_.abs() > 0.999_999 * most);
            let scale = first.copied().unwrap_or(1.0);
            let moves = |place: usize| {
                let share = vector[place] / scale;
                if share.abs() < 1e-9 { 0.0 } else { share }
            };
            found.push(PerAxis::from_fn(moves)); // at most one per axis
        }
        found
    }
}
