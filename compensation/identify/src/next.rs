//! What to measure next: of many poses the one that makes the largest uncertainty smallest.

use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, MAX_AXES};

use crate::{
    design::bring,
    identify::Fitted,
    observations::{Observations, Row, Seen},
    prepared::Rows,
    system::{Equations, System},
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
    /// The error coefficient that is least certain in its effect on the observations; of those that are not determined,
    /// where there are any, the one that the pose tells most of.
    pub parameter: String,
    /// Its standard uncertainty now as a part of what it is after the pose; above 1. `None` where it is not determined yet.
    pub improvement: Option<f64>,
}

/// The pose that helps most. Where unknowns are not determined, though another measurement could, it is the one that tells most
/// of them; else the one after which the largest uncertainty of any error coefficient, in its effect on the observations so
/// far, is smallest. Candidates are poses at which the same instrument can read.
pub(crate) fn next(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Option<Next> {
    let values = &fitted.solution.values;
    let candidates: Vec<Candidate> = (1..=CANDIDATES)
        .filter_map(|k| candidate(system, observations, k))
        .collect();
    let prepared = system.prepare(candidates.iter().map(|candidate| &candidate.row));
    let ahead = system.equations(&prepared, values, true);
    let left = fitted.rank.left_at_zero();
    let missing: Vec<usize> = left
        .filter(|column| system.is_convention(*column) == Some(false))
        .collect();
    let now = system.equations(rows, values, false).jacobian;
    let (place, parameter, improvement) = if missing.is_empty() {
        surest(system, rows.len(), &now, fitted, &ahead)?
    } else {
        let (place, parameter) = most_told(system, &now, &ahead, &missing)?;
        (place, parameter, None)
    };
    let Candidate { row, file } = &candidates[place];
    let axes = system.machine.axes().iter().zip(&row.stand.state.q);
    Some(Next {
        pose: axes
            .map(|(axis, &q)| {
                let at = Displacement::new(axis.name.kind(), q).mm_or_deg();
                // What is left of the way to radians and back.
                (axis.name, (at * 1e6).round() / 1e6)
            })
            .collect(),
        file: file.clone(),
        parameter: system.name(parameter),
        improvement,
    })
}

/// The candidate after which the largest uncertainty is smallest, the parameter that is least certain now, and how much
/// more certain it becomes.
fn surest(
    system: &System,
    rows: usize,
    now: &DMatrix<f64>,
    fitted: &Fitted,
    ahead: &Equations,
) -> Option<(usize, usize, Option<f64>)> {
    let kept = &fitted.rank.kept;
    // The effect of one unit of each coefficient; set-ups are no errors of the machine.
    let count = rows as f64;
    let effect: Vec<f64> = kept
        .iter()
        .map(|&param| {
            if param < system.params.setup() {
                0.0
            } else {
                now.column(param).norm() / count.sqrt()
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
    let jacobian = ahead.jacobian.select_columns(kept);
    let variance = fitted.solution.variance.max(1.0);
    let mut best: Option<(f64, f64, usize)> = None;
    for (place, &(first, size)) in ahead.places.iter().enumerate() {
        let rows = jacobian.rows(first, size);
        let carried = covariance * rows.transpose();
        let inner = rows * &carried + DMatrix::identity(size, size) * variance;
        let Some(inverse) = inner.try_inverse() else {
            continue;
        };
        let gain = &carried * inverse;
        let after = DVector::from_fn(kept.len(), |k, _| {
            covariance[(k, k)] - gain.row(k).dot(&carried.row(k))
        });
        let (_, largest) = uncertain(&after);
        let own = effect[worst] * after[worst].max(0.0).sqrt();
        if best.is_none_or(|(least, ..)| largest < least) {
            best = Some((largest, own, place));
        }
    }
    let (_, own, place) = best?;
    let improvement = before / own.max(f64::MIN_POSITIVE);
    Some((place, kept[worst], Some(improvement)))
}

/// The candidate that tells most of what is not determined, and the unknown of which it tells most. What is not known yet is
/// taken to be of a usual size for an error, so that everything has a covariance.
fn most_told(
    system: &System,
    now: &DMatrix<f64>,
    ahead: &Equations,
    missing: &[usize],
) -> Option<(usize, usize)> {
    /// mm and rad: a large error of a machine.
    const USUAL: f64 = 1e-1;
    /// mm and rad: where a set-up may be.
    const ANYWHERE: f64 = 1e3;
    /// Poses that tell less are no better than chance.
    const LEAST: f64 = 2.0;
    let sizes = DVector::from_fn(system.params.len(), |column, _| {
        if column < system.params.setup() {
            ANYWHERE
        } else {
            USUAL
        }
    });
    let scaled = |jacobian: &DMatrix<f64>| {
        let mut scaled = jacobian.clone();
        for (mut column, size) in scaled.column_iter_mut().zip(&sizes) {
            column *= *size;
        }
        scaled
    };
    let now = scaled(now);
    let count = sizes.len();
    let information = now.transpose() * &now + DMatrix::identity(count, count);
    let covariance = information.cholesky()?.inverse();
    let jacobian = scaled(&ahead.jacobian);
    let mut best: Option<(f64, usize, usize)> = None;
    for (place, &(first, size)) in ahead.places.iter().enumerate() {
        let rows = jacobian.rows(first, size);
        let carried = &covariance * rows.transpose();
        let inner = rows * &carried + DMatrix::identity(size, size);
        let Some(inverse) = inner.try_inverse() else {
            continue;
        };
        let gain = &carried * inverse;
        // How many times more certain each becomes.
        let times = missing.iter().map(|&column| {
            let before = covariance[(column, column)];
            let after = before - gain.row(column).dot(&carried.row(column));
            (before / after.max(f64::MIN_POSITIVE), column)
        });
        let told: Vec<(f64, usize)> = times.collect();
        let sum: f64 = told.iter().map(|(times, _)| times.ln()).sum();
        let Some(&(times, most)) = told.iter().max_by(|a, b| a.0.total_cmp(&b.0)) else {
            continue;
        };
        if times > LEAST && best.is_none_or(|(largest, ..)| sum > largest) {
            best = Some((sum, place, most));
        }
    }
    best.map(|(_, place, most)| (place, most))
}

/// A pose that could be measured, as a row like those of a file.
struct Candidate {
    row: Row,
    file: String,
}

/// Candidate number `k`: like one of the rows, which take turns. A target is seen from its tracker wherever the machine stands
/// within its travel. A sphere, a ball and a ballbar's other end stay where they are: the tip stands at the same point of the
/// workpiece, with other coordinates of the rotary axes. A line of sight stays, too: the machine stands between two of its
/// places. `None` where the axes do not get there.
fn candidate(system: &System, observations: &Observations, k: usize) -> Option<Candidate> {
    const PRIMES: [usize; MAX_AXES] = [2, 3, 5, 7, 11, 13, 17, 19, 23];
    const PRIME_OF_ROWS: usize = 29;
    const PRIME_OF_OTHERS: usize = 31;
    // Rounded so that a person can type it.
    const STEP_MM: f64 = 1e-3;
    let fitted = observations.fitted().map(|(observation, _)| observation);
    let fitted: Vec<_> = fitted.filter(|o| !o.rows.is_empty()).collect();
    let of = |rows: &[Row], prime: usize| rows.get(k * prime % rows.len().max(1)).cloned();
    let observation = fitted.get(k % fitted.len().max(1))?;
    let mut row = of(&observation.rows, PRIME_OF_ROWS)?;
    let chain = system.machine.chain();
    let tip = row.stand.ideal_tip_mm(chain);
    let axes = || system.machine.axes().iter().zip(PRIMES).enumerate();
    match row.seen {
        Seen::Line { .. } | Seen::Pair { .. } => {
            let other = of(&observation.rows, PRIME_OF_OTHERS)?;
            let share = (10.0 * radical_inverse(k, PRIMES[0])).round() / 10.0;
            for (q, to) in row.stand.state.q.iter_mut().zip(other.stand.state.q) {
                *q += share * (to - *q);
            }
        }
        Seen::Point { .. } | Seen::Sphere { .. } | Seen::Ball { .. } | Seen::Distance { .. } => {
            let stays = !matches!(row.seen, Seen::Point { .. });
            for (place, (axis, prime)) in axes() {
                if stays && axis.name.kind() == AxisKind::Linear {
                    continue;
                }
                let [low, high] = axis.travel;
                let at = (low + (high - low) * radical_inverse(k, prime)).round();
                row.stand.state.q[place] =
                    Displacement::from_coordinate(axis.name.kind(), at.clamp(low, high))
                        .mm_or_rad();
            }
            if stays && !bring(system, &mut row.stand, tip) {
                return None;
            }
        }
    }
    for (place, (axis, _)) in axes() {
        let q = &mut row.stand.state.q[place];
        if axis.name.kind() == AxisKind::Linear {
            *q = (*q / STEP_MM).round() * STEP_MM;
        }
        let at = Displacement::new(axis.name.kind(), *q).mm_or_deg();
        if axis.modulo.is_none() && !axis.contains(at) {
            return None;
        }
    }
    Some(Candidate {
        row,
        file: observation.file.clone(),
    })
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
