//! Sensitivity of the volumetric error to each error, over many poses.
//!
//! It lists the errors that cause the same motion, and those that measurements of the tool cannot separate.

use nalgebra::{DMatrix, DVector, Vector3};
use volcomp_kinematics::Chain;
use volcomp_vocabulary::{AxisKind, Component};

use crate::effects::{Effect, Poses, Squares, checked, chunks, effects};
use crate::error::SensitivityError;
use crate::term::{ErrorTerm, Gaps, InGap, twists};

/// Number of poses whose rows are reduced to a triangular factor in one step.
const STACKED: usize = 48;

/// Errors whose effects are proportional at every pose: one motion of the tool.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct DistinctMotion {
    /// The motion by its frame or line: `translation along Y, frame of A`.
    pub name: String,
    /// The errors that cause this motion, in the given order.
    pub terms: Vec<ErrorTerm>,
}

/// The sensitivity of a machine to its errors over a set of poses.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct Sensitivity {
    /// Number of poses.
    #[cfg_attr(feature = "schema", serde(rename = "positions"))]
    pub poses: usize,
    /// Each error, in the given order.
    pub errors: Vec<Effect>,
    /// The distinct motions; errors without effect are in none.
    pub motions: Vec<DistinctMotion>,
    /// Number of independent combinations of errors that the pose of the tool can distinguish.
    pub rank: usize,
    /// Combinations of the errors, in µm and µrad and of unit length, that do not move the tool at any pose.
    #[cfg_attr(
        feature = "schema",
        serde(serialize_with = "as_maps"),
        schemars(with = "Vec<std::collections::BTreeMap<String, f64>>")
    )]
    pub indistinguishable: Vec<Vec<(ErrorTerm, f64)>>,
}

#[cfg(feature = "schema")]
fn as_maps<S: serde::Serializer>(
    nulls: &[Vec<(ErrorTerm, f64)>],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let named = nulls.iter().map(|null| {
        let weights = null.iter().map(|(term, weight)| (term.coefficient(), *weight));
        weights.collect::<std::collections::BTreeMap<_, _>>()
    });
    serializer.collect_seq(named)
}

/// Analyses errors of a chain over poses to first order, on all cores.
///
/// # Errors
/// [`SensitivityError`].
pub fn sensitivity(
    chain: &Chain,
    terms: &[ErrorTerm],
    poses: &Poses,
) -> Result<Sensitivity, SensitivityError> {
    sensitivity_with_progress(chain, terms, poses, |_, _| {})
}

/// Like [`sensitivity()`]; `progress` receives, from any thread, the number of finished poses and their total number.
///
/// # Errors
/// [`SensitivityError`].
pub fn sensitivity_with_progress(
    chain: &Chain,
    terms: &[ErrorTerm],
    poses: &Poses,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<Sensitivity, SensitivityError> {
    let count = checked(chain, terms, poses)?;
    let made_of: Vec<Vec<InGap>> = terms.iter().map(|&term| twists(chain, term)).collect();
    let basis = Basis::new(chain, poses, count);
    let parts: Vec<Sums> = chunks(count, &progress, |places| {
        let mut sums = Sums::new(terms.len(), basis.columns);
        sums.take(chain, poses, places, &made_of, &basis);
        sums
    });
    let mut sums = Sums::new(terms.len(), basis.columns);
    for part in &parts {
        sums.join(part);
    }
    let columns = &sums.triangle * basis.combinations(&made_of);
    let dependence = Dependence::of(&columns);
    let named = |null: Vec<(usize, f64)>| {
        let named = null.into_iter().map(|(place, weight)| (terms[place], weight));
        in_micro(named.collect())
    };
    Ok(Sensitivity {
        poses: count,
        errors: effects(terms, &sums.effects, count, in_micro_units)?,
        motions: motions(chain, terms, &made_of, &columns),
        rank: dependence.rank(),
        indistinguishable: dependence.null.into_iter().map(named).collect(),
    })
}

/// Value of 1 µm or 1 µrad of an error, in mm or rad.
fn in_micro_units(term: ErrorTerm) -> f64 {
    if term.component().is_angular() { 1e-6 } else { 1e-3 }
}

/// Converts a combination in mm and rad to one of unit length in µm and µrad.
fn in_micro(mut combination: Vec<(ErrorTerm, f64)>) -> Vec<(ErrorTerm, f64)> {
    let micro = |term: &ErrorTerm| {
        if term.component().is_angular() { 1e6 } else { 1e3 }
    };
    for (term, weight) in &mut combination {
        *weight *= micro(term);
    }
    let length = combination.iter().map(|(_, weight)| weight * weight).sum::<f64>().sqrt();
    for (_, weight) in &mut combination {
        *weight /= length;
    }
    combination
}

/// Columns for the twists of the gaps. Twists that are equal at every pose share a column: translations are unchanged across a linear axis.
struct Basis {
    place: Vec<[usize; 6]>,
    columns: usize,
    /// Lever arm by which displacements are divided to compare them with rotations, mm.
    lever_mm: f64,
}

impl Basis {
    fn new(chain: &Chain, poses: &Poses, count: usize) -> Self {
        let mut place: Vec<[usize; 6]> = vec![[0, 1, 2, 3, 4, 5]];
        let mut columns = 6;
        for joint in chain.joints() {
            let before = place[place.len() - 1];
            let mut here = [0; 6];
            for (k, here) in here.iter_mut().enumerate() {
                *here = if k < 3 && joint.kind == AxisKind::Linear {
                    before[k]
                } else {
                    columns += 1;
                    columns - 1
                };
            }
            place.push(here);
        }
        // Only the order of magnitude of the lever arm matters.
        let lever = |at: usize| {
            let gaps = Gaps::at(chain, &poses.state(at));
            let levers = gaps.tip_mm[..=chain.joints().len()].iter().map(Vector3::norm);
            levers.fold(1.0, f64::max)
        };
        Self { place, columns, lever_mm: lever(0).max(lever(count - 1)) }
    }

    fn write_rows(&self, gaps: &Gaps, rows: &mut DMatrix<f64>, from: usize) {
        for (gap, place) in self.place.iter().enumerate() {
            let (turned, tip) = (&gaps.turned[gap], gaps.tip_mm[gap] / self.lever_mm);
            for k in 0..3 {
                let along: Vector3<f64> = turned.column(k).into();
                let mut unit = Vector3::zeros();
                unit[k] = 1.0;
                let moved = turned * unit.cross(&tip);
                for row in 0..3 {
                    rows[(from + row, place[k])] = along[row];
                    rows[(from + row, place[k + 3])] = moved[row];
                    rows[(from + 3 + row, place[k + 3])] = along[row];
                }
            }
        }
    }

    fn combinations(&self, made_of: &[Vec<InGap>]) -> DMatrix<f64> {
        let mut combinations = DMatrix::zeros(self.columns, made_of.len());
        for (column, twists) in made_of.iter().enumerate() {
            for twist in twists {
                let place = self.place[twist.gap];
                for k in 0..3 {
                    combinations[(place[k], column)] += twist.linear[k] / self.lever_mm;
                    combinations[(place[k + 3], column)] += twist.angular[k];
                }
            }
        }
        combinations
    }
}

struct Sums {
    /// Squares of the effect of each error per mm or rad.
    effects: Vec<Squares>,
    triangle: DMatrix<f64>,
}

impl Sums {
    fn new(terms: usize, columns: usize) -> Self {
        Self {
            effects: vec![Squares::default(); terms],
            triangle: DMatrix::zeros(columns, columns),
        }
    }

    fn take(
        &mut self,
        chain: &Chain,
        poses: &Poses,
        places: std::ops::Range<usize>,
        made_of: &[Vec<InGap>],
        basis: &Basis,
    ) {
        let columns = basis.columns;
        let mut from = places.start;
        while from < places.end {
            let to = places.end.min(from + STACKED);
            let mut stacked = DMatrix::zeros(columns + 6 * (to - from), columns);
            stacked.view_mut((0, 0), (columns, columns)).copy_from(&self.triangle);
            for place in from..to {
                let gaps = Gaps::at(chain, &poses.state(place));
                for (sums, twists) in self.effects.iter_mut().zip(made_of) {
                    sums.take(gaps.effect(twists));
                }
                basis.write_rows(&gaps, &mut stacked, columns + 6 * (place - from));
            }
            self.triangle = stacked.qr().unpack_r();
            from = to;
        }
    }

    fn join(&mut self, other: &Self) {
        for (sums, other) in self.effects.iter_mut().zip(&other.effects) {
            sums.join(other);
        }
        let columns = self.triangle.ncols();
        let mut stacked = DMatrix::zeros(2 * columns, columns);
        stacked.view_mut((0, 0), (columns, columns)).copy_from(&self.triangle);
        stacked.view_mut((columns, 0), (columns, columns)).copy_from(&other.triangle);
        self.triangle = stacked.qr().unpack_r();
    }
}

/// Groups errors with proportional columns; columns of zeros are omitted.
fn motions(
    chain: &Chain,
    terms: &[ErrorTerm],
    made_of: &[Vec<InGap>],
    columns: &DMatrix<f64>,
) -> Vec<DistinctMotion> {
    let units: Vec<_> = columns
        .column_iter()
        .map(|column| {
            let norm = column.norm();
            (norm > 0.0).then(|| column / norm)
        })
        .collect();
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (place, unit) in units.iter().enumerate() {
        let Some(unit) = unit else { continue };
        let is_same = |group: &&mut Vec<usize>| {
            units[group[0]]
                .as_ref()
                .is_some_and(|other| (unit - other * other.dot(unit)).norm() < DEPENDENT_BELOW)
        };
        match groups.iter_mut().find(is_same) {
            Some(group) => group.push(place),
            None => groups.push(vec![place]),
        }
    }
    let named = |group: Vec<usize>| DistinctMotion {
        name: name(chain, terms, made_of, &group),
        terms: group.iter().map(|&place| terms[place]).collect(),
    };
    groups.into_iter().map(named).collect()
}

/// Name of a motion, which is derived from the error whose gap is nearest to the workpiece.
fn name(chain: &Chain, terms: &[ErrorTerm], made_of: &[Vec<InGap>], group: &[usize]) -> String {
    let single = group.iter().filter(|&&place| made_of[place].len() == 1);
    let Some(&place) = single.min_by_key(|&&place| made_of[place][0].gap) else {
        // All errors displace axis lines; these consist of two twists each.
        let names: Vec<String> = group.iter().map(|&place| terms[place].to_string()).collect();
        return format!("line of an axis: {}", names.join(", "));
    };
    let gap = made_of[place][0].gap;
    let before = &chain.joints()[..gap];
    let along = match terms[place].component() {
        Component::EX | Component::EA => "X",
        Component::EY | Component::EB => "Y",
        Component::EZ | Component::EC => "Z",
    };
    if terms[place].component().is_angular() {
        let carried = before
            .last()
            .map_or_else(|| "the workpiece".to_owned(), |joint| joint.name.to_string());
        format!("rotation about {along}, line carried by {carried}")
    } else {
        let turned = before.iter().rev().find(|joint| joint.kind == AxisKind::Rotary);
        let frame =
            turned.map_or_else(|| "the workpiece".to_owned(), |joint| joint.name.to_string());
        format!("translation along {along}, frame of {frame}")
    }
}

/// A column counts as linearly dependent if no more than this fraction of its length remains after
/// projection onto the previous columns.
pub const DEPENDENT_BELOW: f64 = 1e-9;

/// Weights in a combination below this value, relative to the largest weight, are treated as
/// rounding errors.
const ROUNDING: f64 = 1e-7;

/// Rank of a matrix, and the linear combinations of its columns that are zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependence {
    /// Indices of the columns that are independent of the previous ones, ascending.
    pub kept: Vec<usize>,
    /// For each dependent column, the combination with previous columns that is zero: indices and weights, the
    /// dependent column last. The weights form a vector of unit length; the first one is positive.
    pub null: Vec<Vec<(usize, f64)>>,
}

impl Dependence {
    /// Number of independent columns.
    pub fn rank(&self) -> usize {
        self.kept.len()
    }

    /// Determines the dependence of the columns of `matrix`, in order; their scale does not matter. Each column is
    /// projected onto the previous ones by twofold orthogonalisation. A column of zeros depends on no other.
    pub fn of(matrix: &DMatrix<f64>) -> Self {
        let mut basis: Vec<DVector<f64>> = Vec::new();
        // Index of each column of the basis, and its coefficients in the basis, both scaled to unit length.
        let mut places: Vec<usize> = Vec::new();
        let mut triangle: Vec<Vec<f64>> = Vec::new();
        let norms: Vec<f64> = matrix.column_iter().map(|column| column.norm()).collect();
        let mut null = Vec::new();
        for (place, column) in matrix.column_iter().enumerate() {
            if norms[place] == 0.0 {
                null.push(vec![(place, 1.0)]);
                continue;
            }
            let mut rest = column / norms[place];
            let mut shares = vec![0.0; basis.len()];
            for _ in 0..2 {
                for (unit, share) in basis.iter().zip(&mut shares) {
                    let part = unit.dot(&rest);
                    rest.axpy(-part, unit, 1.0);
                    *share += part;
                }
            }
            let left = rest.norm();
            if left <= DEPENDENT_BELOW {
                let weights = weights(&triangle, &shares);
                let scaled = places.iter().zip(weights);
                let scaled = scaled.map(|(&place, weight)| (place, -weight)).chain([(place, 1.0)]);
                null.push(combination(scaled.collect(), &norms));
            } else {
                shares.push(left);
                basis.push(rest / left);
                triangle.push(shares);
                places.push(place);
            }
        }
        Self { kept: places, null }
    }
}

/// Weights of the basis columns for a vector with these components (`shares`) along the orthogonalised basis.
fn weights(triangle: &[Vec<f64>], shares: &[f64]) -> Vec<f64> {
    let mut left = shares.to_vec();
    let mut weights = vec![0.0; shares.len()];
    for (place, column) in triangle.iter().enumerate().rev() {
        // The diagonal exceeds the dependence threshold, so it is not zero.
        let weight = left[place] / column[place];
        weights[place] = weight;
        for (left, share) in left.iter_mut().zip(column) {
            *left -= weight * share;
        }
    }
    weights
}

/// Converts a combination of unit-length columns to one of the original columns, of unit length and without rounding errors.
fn combination(scaled: Vec<(usize, f64)>, norms: &[f64]) -> Vec<(usize, f64)> {
    let largest = scaled.iter().fold(0.0_f64, |most, (_, weight)| most.max(weight.abs()));
    let kept = scaled.into_iter().filter(|(_, weight)| weight.abs() > ROUNDING * largest);
    let mut weighted: Vec<(usize, f64)> =
        kept.map(|(place, weight)| (place, weight / norms[place])).collect();
    let length = weighted.iter().map(|(_, weight)| weight * weight).sum::<f64>().sqrt();
    let first = weighted.first().map_or(1.0, |(_, weight)| weight.signum());
    for (_, weight) in &mut weighted {
        *weight /= length * first;
    }
    weighted
}
