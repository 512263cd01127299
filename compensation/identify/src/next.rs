//! What to measure next: of many poses the one that makes the largest uncertainty smallest.

use volcomp_kinematics::{
    State,
    nalgebra::{DMatrix, DVector},
};
use volcomp_vocabulary::{AxisName, Displacement, MAX_AXES};

use crate::{
    identify::Fitted,
    observations::{Observations, Row, Stand},
    prepared::Rows,
    system::System,
};

/// How many poses are looked at.
const CANDIDATES: usize = 200;

/// A pose to be measured next.
#[derive(Clone, Debug, PartialEq)]
pub struct Next {
    /// Coordinates, mm or deg, in the order of the chain.
    pub pose: Vec<(AxisName, f64)>,
    /// The file whose set-up is to be used.
    pub file: String,
    /// The error coefficient that is least certain in its effect on the observations.
    pub parameter: String,
    /// Its standard uncertainty now as a part of what it is after the pose; above 1.
    pub improvement: f64,
}

/// The pose that helps most: the one after which the largest uncertainty of any error coefficient, in its effect on the
/// observations so far, is smallest. Candidates fill the travel evenly (Halton's sequence).
pub(crate) fn next(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Option<Next> {
    let values = &fitted.solution.values;
    let now = system
        .equations(rows, values, false)
        .jacobian
        .select_columns(&fitted.rank.kept);
    // The effect of one unit of each coefficient; set-ups are no errors of the machine.
    let count = rows.len() as f64;
    let effect: Vec<f64> = fitted
        .rank
        .kept
        .iter()
        .enumerate()
        .map(|(place, &param)| {
            if param < system.params.setup() {
                0.0
            } else {
                now.column(place).norm() / count.sqrt()
            }
        })
        .collect();
    let covariance = &fitted.solution.covariance;
    let uncertain = |covariance: &DVector<f64>| {
        let sizes = effect
            .iter()
            .zip(covariance)
            .map(|(e, v)| e * v.max(0.0).sqrt());
        let sizes = sizes.enumerate();
        sizes.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
    };
    let (worst, before) = uncertain(&covariance.diagonal());
    if before <= 0.0 {
        return None;
    }
    let model = observations
        .observations
        .iter()
        .find(|o| !o.judge && !o.rows.is_empty())?;
    let like = &model.rows[0];
    let candidates: Vec<Row> = (1..=CANDIDATES)
        .map(|k| candidate(system, like, k))
        .collect();
    let prepared = system.prepare(candidates.iter());
    let equations = system.equations(&prepared, values, true);
    let jacobian = equations.jacobian.select_columns(&fitted.rank.kept);
    let variance = fitted.solution.variance.max(1.0);
    let mut best: Option<(f64, f64, usize)> = None;
    for (place, &(first, size)) in equations.places.iter().enumerate() {
        let rows = jacobian.rows(first, size);
        let carried = covariance * rows.transpose();
        let inner = rows * &carried + DMatrix::identity(size, size) * variance;
        let Some(inverse) = inner.try_inverse() else {
            continue;
        };
        let gain = &carried * inverse;
        let after = DVector::from_fn(fitted.rank.kept.len(), |k, _| {
            covariance[(k, k)] - gain.row(k).dot(&carried.row(k))
        });
        let (_, largest) = uncertain(&after);
        let own = effect[worst] * after[worst].max(0.0).sqrt();
        if best.is_none_or(|(least, ..)| largest < least) {
            best = Some((largest, own, place));
        }
    }
    let (_, own, place) = best?;
    let state = &candidates[place].stand.state;
    let axes = system.machine.axes().iter().zip(&state.q);
    Some(Next {
        pose: axes
            .map(|(axis, &q)| {
                let at = Displacement::new(axis.name.kind(), q).mm_or_deg();
                // What is left of the way to radians and back.
                (axis.name, (at * 1e6).round() / 1e6)
            })
            .collect(),
        file: model.file.clone(),
        parameter: system.name(fitted.rank.kept[worst]),
        improvement: before / own.max(f64::MIN_POSITIVE),
    })
}

/// A row like another one at the pose number `k` of the sequence.
fn candidate(system: &System, like: &Row, k: usize) -> Row {
    const PRIMES: [usize; MAX_AXES] = [2, 3, 5, 7, 11, 13, 17, 19, 23];
    let mut state = State::default();
    let axes = system.machine.axes().iter().zip(PRIMES);
    for (place, (axis, prime)) in axes.enumerate() {
        let [low, high] = axis.travel;
        // Rounded so that a person can type it.
        let at = (low + (high - low) * radical_inverse(k, prime)).round();
        state.q[place] =
            Displacement::from_coordinate(axis.name.kind(), at.clamp(low, high)).mm_or_rad();
    }
    Row {
        stand: Stand {
            state,
            tip_mm: like.stand.tip_mm,
        },
        ..like.clone()
    }
}

/// The digits of a number behind the point in reverse order.
fn radical_inverse(mut number: usize, base: usize) -> f64 {
    let (mut value, mut part) = (0.0, 1.0 / base as f64);
    while number > 0 {
        value += part * (number % base) as f64;
        number /= base;
        part /= base as f64;
    }
    value
}
