//! What to measure next: of many poses the one that makes the largest uncertainty smallest.

use std::collections::BTreeMap;

use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::{
    candidates::{Candidate, candidates},
    effects::largest_effects,
    identify::Fitted,
    observations::{Kind, Observations, Seen},
    prepared::Rows,
    system::{Equations, System},
};

/// A pose to be measured next.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Next {
    /// The coordinates of every axis, mm or deg.
    pub pose: BTreeMap<AxisName, f64>,
    /// The file whose set-up is to be used.
    pub file: String,
    /// What is to be observed.
    pub kind: Kind,
    /// The sphere, the ball or the target there; `None` where there is nothing to choose.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub target: Option<String>,
    /// The tool in the spindle; `None` where it is that of `[tool]`.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Option::is_none"))]
    pub tool: Option<String>,
    /// The error coefficient that is least certain in its largest effect on the tip in the workspace; of those that are not determined,
    /// where a pose tells of any, the one that it tells most of.
    pub parameter: String,
    /// How many times smaller its standard uncertainty is after the pose than now: 1 or more. `None` where it is not
    /// determined yet.
    pub improvement: Option<f64>,
}

/// The pose that helps most. Where unknowns are not determined and a pose tells of them, it is the one that tells most of
/// them; else the one after which the largest uncertainty of any error coefficient, by its largest effect on the tip in the
/// workspace, is smallest.
pub(crate) fn next(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Option<Next> {
    let values = &fitted.solution.values;
    let candidates = candidates(system, observations, values);
    let prepared = system.prepare(candidates.iter().map(|candidate| &candidate.row));
    let ahead = system.plain_equations(&prepared, values, true);
    let left = fitted.rank.left_at_zero();
    let missing: Vec<usize> = left
        .filter(|column| system.is_convention(*column) == Some(false))
        .collect();
    let now = system.equations(rows, values).jacobian;
    let of_missing = || most_told(system, &now, &ahead, &missing);
    let (place, parameter, improvement) = match of_missing() {
        Some((place, parameter)) => (place, parameter, None),
        None => surest(&largest_effects(system, values), fitted, &ahead)?,
    };
    let Candidate { row, file, kind } = &candidates[place];
    let target = match row.seen {
        Seen::Sphere { centre, .. } => Some(&system.setup.points[centre].name),
        Seen::Ball { distance, .. } => Some(&system.setup.numbers[distance].name),
        Seen::Point {
            target: Some(target),
            ..
        } => Some(&system.setup.points[target].name),
        _ => None,
    };
    let machine = &system.machine;
    let mut tools = machine.tools().keys();
    let is_in_spindle = |name: &&String| {
        machine
            .tip_of(name)
            .is_ok_and(|tip| tip == row.stand.tip_mm)
    };
    let is_of_tool = row.stand.tip_mm == machine.chain().tool_tip_mm();
    let tool = tools.find(is_in_spindle).filter(|_| !is_of_tool);
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
        kind: *kind,
        target: target.cloned(),
        tool: tool.cloned(),
        parameter: system.name(parameter),
        improvement,
    })
}

/// The candidate after which the largest uncertainty is smallest, the parameter that is least certain now, and how much
/// more certain it becomes.
fn surest(
    effects: &DVector<f64>,
    fitted: &Fitted,
    ahead: &Equations,
) -> Option<(usize, usize, Option<f64>)> {
    let kept = &fitted.rank.kept;
    let effect: Vec<f64> = kept.iter().map(|&param| effects[param]).collect();
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
    // A new number has the variance that those have of which the covariance was made.
    let variance = fitted.solution.counted;
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
    // Rounding must not make it worse.
    let improvement = (before / own.max(f64::MIN_POSITIVE)).max(1.0);
    Some((place, kept[worst], Some(improvement)))
}

/// The candidate that tells most of what is not determined, and the unknown of which it tells most. What is not known yet is
/// taken to be of a size that errors and set-ups have, so that everything has a covariance.
fn most_told(
    system: &System,
    now: &DMatrix<f64>,
    ahead: &Equations,
    missing: &[usize],
) -> Option<(usize, usize)> {
    /// mm and rad: larger than the errors of any machine, so that what is assumed of them says nothing beside a reading.
    const LARGEST_ERROR: f64 = 1e-1;
    /// mm and rad: the size of a workspace, in which a set-up may be anywhere.
    const ANYWHERE: f64 = 1e3;
    /// A pose tells of an unknown where it makes the uncertainty that was assumed of it smaller by more than this factor. The
    /// factor stays near 1 for an unknown that does not act at the pose, or that acts like others which are as little known.
    const TOLD: f64 = 2.0;
    let sizes = DVector::from_fn(system.params.len(), |column, _| {
        if column < system.params.setup() {
            ANYWHERE
        } else {
            LARGEST_ERROR
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
        // How many times smaller the variance of each becomes.
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
        if times > TOLD * TOLD && best.is_none_or(|(largest, ..)| sum > largest) {
            best = Some((sum, place, most));
        }
    }
    best.map(|(_, place, most)| (place, most))
}
