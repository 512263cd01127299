//! Gauss–Newton search for the unknowns on the exact model, with or without penalties of curves.
//!
//! The weights of the penalties are chosen so that the observations are most probable (restricted maximum likelihood),
//! by the fixed point of Wood and Fasiolo, Biometrics 73 (2017).

use volcomp_kinematics::nalgebra::{DMatrix, DVector};

use crate::coefficients::{Role, micro};
use crate::equation::{Equations, HUBER, weight};
use crate::error::IdentifyError;
use crate::params::{Param, Values};
use crate::rank::{inverse, triangle};
use crate::system::{Rows, System};
use crate::timeline::Sides;

/// Required accuracy of a search; it selects the convergence limit on the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Exactness {
    Rough,
    Full,
}

/// Convergence limit on the step of least squares, in standard uncertainties.
const CONVERGED: f64 = 1e-9;
/// Convergence limit with robust weights, which change in every step.
const CONVERGED_ROBUST: f64 = 1e-6;
/// Convergence limit with penalties, whose weights are chosen as well, and for start values.
const CONVERGED_ROUGH: f64 = 1e-2;
const PENALTY_STEPS: usize = 3;
/// Number of steps in which the assumed reversal values of axes with unknown approach direction are updated.
const SIDE_STEPS: usize = 4;
/// Assumed maximum reversal value, µm or µrad, while it is not identified.
const MAX_REVERSAL: f64 = 1e3;
const MAX_STEPS: usize = 60;
const MAX_STEPS_ROBUST: usize = 400;
/// Maximum multiple of a step in a search with robust weights.
const MAX_STEP_FACTOR: f64 = 64.0;
/// Maximum last step, in standard uncertainties, at which a robust search counts as converged after its last permitted step.
const SMALL_ROBUST: f64 = 1e-3;

#[derive(Clone, Debug)]
pub(crate) struct Solution {
    pub(crate) values: Values,
    /// Covariance of the kept parameters, mm and rad.
    pub(crate) covariance: DMatrix<f64>,
    /// Covariance for readings with the stated scatter and penalties as weak as the
    /// observations allow.
    pub(crate) of_unit_variance: DMatrix<f64>,
    /// Variance of a reading on which `covariance` is based, relative to the stated variance; 1 if the covariance
    /// follows from the stated uncertainties alone.
    pub(crate) counted: f64,
    /// Whether `covariance` follows from the residuals: with penalties, and with robust weights.
    pub(crate) counts_residuals: bool,
    /// Variance of the residuals relative to the stated variance.
    pub(crate) variance: f64,
    /// Effective number of parameters that the observations determine; fractional with penalties.
    pub(crate) degrees: f64,
    /// Degrees of freedom: number of readings minus `degrees`.
    pub(crate) freedom: f64,
}

impl Solution {
    fn at(
        values: Values,
        equations: &Equations,
        sides: &DVector<f64>,
        step: Step,
        search: Search<'_>,
    ) -> Self {
        let left = left(equations, sides);
        let count = left.len() as f64;
        let freedom = (count - step.degrees).max(1.0);
        let counted =
            if search.robust { huber_variance(&left, step.degrees) } else { step.counted };
        // The robust weights enlarged the covariance as if all readings had the mean weight; the factor removes this.
        let mean_weight = if search.robust {
            left.iter().map(|r| weight(*r)).sum::<f64>() / count.max(1.0)
        } else {
            1.0
        };
        let of_unit_variance = step.covariance / step.counted;
        Self {
            values,
            covariance: &of_unit_variance * (counted * mean_weight),
            of_unit_variance,
            counted,
            counts_residuals: search.robust || search.penalised,
            variance: step.square / freedom,
            degrees: step.degrees,
            freedom,
        }
    }

    /// Ratio of residuals to stated uncertainties; `None` if chance explains the ratio: the variance of n readings
    /// scatters by √(2/n) about 1. The uncertainties are too small by at least this ratio (R. T. Birge, Physical Review
    /// 40, 1932).
    pub(crate) fn excess(&self) -> Option<f64> {
        let by_chance = max_squares_by_chance(self.freedom) / self.freedom;
        (self.variance > by_chance).then(|| self.variance.sqrt())
    }

    /// Factor by which uncertainties from `covariance` must be multiplied because of [`Self::excess`]; 1 if the covariance already
    /// includes the residuals.
    pub(crate) fn excess_of_covariance(&self) -> f64 {
        let ratio = self.excess().filter(|_| !self.counts_residuals);
        ratio.unwrap_or(1.0)
    }
}

/// Largest sum of the squares of `freedom` numbers of variance 1 that is attributed to chance: four standard deviations above the mean.
pub(crate) fn max_squares_by_chance(freedom: f64) -> f64 {
    const CHANCE: f64 = 4.0;
    freedom + CHANCE * (2.0 * freedom).sqrt()
}

/// Searches for the kept parameters. With groups of penalties, the weights of the penalties are chosen as well.
pub(crate) fn solve(
    system: &System,
    rows: &Rows,
    start: Values,
    kept: &[usize],
    robust: bool,
    penalised: bool,
    exactness: Exactness,
) -> Result<Solution, IdentifyError> {
    let (tolerance, max_steps) = match exactness {
        Exactness::Rough => (CONVERGED_ROUGH, MAX_STEPS),
        Exactness::Full if robust => (CONVERGED_ROBUST, MAX_STEPS_ROBUST),
        Exactness::Full => (CONVERGED, MAX_STEPS),
    };
    let search = Search { system, rows, kept, robust, penalised };
    let mut values = start;
    let mut penalty = Penalty::none(system, kept);
    let mut last = f64::INFINITY;
    let columns = kept.last().map_or(0, |last| {
        let setup = system.params.setup();
        if *last < setup { setup } else { system.params.len() }
    });
    let at = |values: &Values| {
        let mut equations = system.equations_in(columns, rows, values, false);
        if exactness == Exactness::Rough {
            equations.sides = Sides::default();
        }
        equations
    };
    if exactness == Exactness::Full {
        values.reversals = search.reversals(&values, None);
    }
    let mut equations = at(&values);
    let mut sides = DVector::zeros(equations.sides.len());
    for count in 0..max_steps {
        // The equations are nearly linear: after a few steps the weights are frozen, so that the search can converge.
        penalty.held = count >= PENALTY_STEPS;
        let step = search.step(&equations, &sides, &values, &mut penalty)?;
        last = step.largest();
        let is_open = count < SIDE_STEPS && equations.sides.has_unknown();
        if last < tolerance && !is_open {
            penalty.ends = true;
            let step = if penalised {
                search.step(&equations, &sides, &values, &mut penalty)?
            } else {
                step
            };
            return Ok(Solution::at(values, &equations, &sides, step, search));
        }
        // The step is halved while the cost increases: far from the solution the equations are not linear.
        let before = cost(&equations, &sides, robust);
        let to = |share: f64| {
            let step_by = spread(&step.by, kept, system.params.len(), share);
            let tried = values.moved(&system.params, &step_by);
            let trial = at(&tried);
            let on_sides = &sides + (&step.sides - &sides) * share;
            let cost = cost(&trial, &on_sides, robust);
            (cost, (tried, trial, on_sides))
        };
        let mut share = 1.0;
        let (mut least, mut reached) = to(share);
        // Costs that differ only by rounding count as equal.
        while least > before * (1.0 + 1e-9) + 1e-20 && share >= 1e-3 && !penalised {
            share *= 0.5;
            (least, reached) = to(share);
        }
        // Robust weights follow the residuals slowly if many are large, so the step is extended.
        while robust && !penalised && (1.0..MAX_STEP_FACTOR).contains(&share) {
            let (cost, further) = to(2.0 * share);
            if cost >= least {
                break;
            }
            share *= 2.0;
            (least, reached) = (cost, further);
        }
        (values, equations, sides) = reached;
        if is_open {
            values.reversals = search.reversals(&values, Some(&step.covariance));
            equations = at(&values);
            sides = equations.sides.estimate(&equations.residuals);
        }
    }
    // The last steps are below the resolution of the readings. Robust weights may still change slightly.
    let small = if robust { SMALL_ROBUST } else { 1e-5 };
    if last < small || exactness == Exactness::Rough {
        penalty.ends = true;
        let step = search.step(&equations, &sides, &values, &mut penalty)?;
        return Ok(Solution::at(values, &equations, &sides, step, search));
    }
    Err(IdentifyError::NotConverged {
        steps: max_steps,
        last,
        numbers: equations.residuals.len(),
        unknowns: system.params.len(),
        rank: kept.len(),
    })
}

/// Expands a step of the kept parameters to all parameters.
pub(crate) fn spread(
    step: &DVector<f64>,
    kept: &[usize],
    count: usize,
    share: f64,
) -> DVector<f64> {
    let mut all = DVector::zeros(count);
    for (&column, by) in kept.iter().zip(step) {
        all[column] = by * share;
    }
    all
}

/// Variance of a reading with which the covariance of least squares becomes the covariance of Huber's estimate: the
/// mean of ψ² divided by the squared mean of ψ', with the correction for the number of unknowns (P. J. Huber, Annals of
/// Statistics 1, 1973). It is at least the variance for readings that scatter as stated.
fn huber_variance(residuals: &DVector<f64>, degrees: f64) -> f64 {
    /// Variance for normal readings with the stated uncertainty: 1 divided by the efficiency of 95 %.
    const NORMAL: f64 = 1.0 / 0.95;
    let count = residuals.len() as f64;
    let psi = residuals.iter().map(|r| r.abs().min(HUBER).powi(2));
    let square = psi.sum::<f64>() / (count - degrees).max(1.0);
    let inside = residuals.iter().filter(|r| r.abs() <= HUBER).count();
    // At least one reading counts as inside, so that the slope is not zero.
    let slope = (inside as f64).max(1.0) / count.max(1.0);
    let correction = 1.0 + degrees / count.max(1.0) * (1.0 - slope) / slope;
    (correction * correction * square / (slope * slope)).max(NORMAL)
}

fn left(equations: &Equations, sides: &DVector<f64>) -> DVector<f64> {
    let mut left = equations.residuals.clone();
    equations.sides.add_to(&mut left, sides);
    left
}

fn cost(equations: &Equations, sides: &DVector<f64>, robust: bool) -> f64 {
    let of = |r: &f64| {
        let size = r.abs();
        if robust && size > HUBER { 2.0 * HUBER * size - HUBER * HUBER } else { r * r }
    };
    left(equations, sides).iter().map(of).sum::<f64>() + sides.norm_squared()
}

struct Step {
    by: DVector<f64>,
    sides: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Variance of a reading on which `covariance` is based, relative to the stated variance.
    counted: f64,
    square: f64,
    degrees: f64,
}

#[derive(Clone, Copy)]
struct Search<'a> {
    system: &'a System,
    rows: &'a Rows,
    kept: &'a [usize],
    robust: bool,
    penalised: bool,
}

impl Search<'_> {
    /// Assumed size of the reversal value of each coefficient: the root of the sum of the squared identified value and
    /// its variance; `MAX_REVERSAL` while the value is not identified.
    fn reversals(self, values: &Values, covariance: Option<&DMatrix<f64>>) -> Vec<f64> {
        let Self { system, kept, .. } = self;
        let listed = system.unknowns.coefficients.iter().enumerate();
        let sizes = listed.map(|(place, coefficient)| {
            if coefficient.role != Role::Reversal {
                return 0.0;
            }
            let largest = MAX_REVERSAL / micro(coefficient.error.component);
            let is_of = |&column: &usize| system.params.at(column) == Param::Coefficient(place);
            let variance = kept.iter().position(is_of).zip(covariance);
            variance.map_or(largest, |(at, covariance)| {
                let square = values.coefficients[place].powi(2) + covariance[(at, at)];
                square.sqrt().min(largest)
            })
        });
        sizes.collect()
    }

    fn step(
        self,
        equations: &Equations,
        sides: &DVector<f64>,
        values: &Values,
        penalty: &mut Penalty,
    ) -> Result<Step, IdentifyError> {
        let Self { system, rows, kept, robust, penalised } = self;
        let mut jacobian = equations.jacobian.select_columns(kept);
        let mut residuals = equations.residuals.clone();
        let square = cost(equations, sides, robust);
        let mut weighted_sides = equations.sides.clone();
        if robust {
            let roots = left(equations, sides).map(|residual| weight(residual).sqrt());
            for (row, residual) in residuals.iter_mut().enumerate() {
                *residual *= roots[row];
                jacobian.row_mut(row).scale_mut(roots[row]);
            }
            weighted_sides.scale(|row| roots[row]);
        }
        let with_sides = (weighted_sides.len() > 0).then(|| {
            let plain = (jacobian.clone(), residuals.clone());
            weighted_sides.eliminate(&mut jacobian);
            weighted_sides.eliminate_from(&mut residuals);
            plain
        });
        let mut scale = DVector::from_element(kept.len(), 1.0);
        for (place, mut column) in jacobian.column_iter_mut().enumerate() {
            let length = column.norm();
            if length > 0.0 {
                scale[place] = 1.0 / length;
                column.scale_mut(scale[place]);
            }
        }
        let failed = || IdentifyError::TooFew {
            poses: rows.poses().1,
            numbers: equations.residuals.len(),
            unknowns: system.params.len(),
            rank: kept.len(),
        };
        let (step, mut covariance, degrees, counted) = if penalised {
            let now = DVector::from_iterator(
                kept.len(),
                kept.iter().map(|&column| values.of(system.params.at(column))),
            );
            let chosen = choose(&jacobian, &residuals, &scale, &now, penalty).ok_or_else(failed)?;
            (chosen.step, chosen.covariance, chosen.degrees, chosen.variance)
        } else {
            let count = kept.len();
            let mut columns = jacobian.resize_horizontally(count + 1, 0.0);
            columns.set_column(count, &residuals);
            let triangle = triangle(columns);
            let r = triangle.view((0, 0), (count, count)).into_owned();
            let inverse = inverse(&r).ok_or_else(failed)?;
            let right = -triangle.column(count).rows(0, count);
            let step = r.solve_upper_triangular(&right).ok_or_else(failed)?;
            (step, &inverse * inverse.transpose(), count as f64, 1.0)
        };
        for (place, factor) in scale.iter().enumerate() {
            covariance.row_mut(place).scale_mut(*factor);
            covariance.column_mut(place).scale_mut(*factor);
        }
        let by = step.component_mul(&scale);
        let sides = with_sides.map_or_else(
            || DVector::zeros(0),
            |(jacobian, residuals)| weighted_sides.estimate(&(residuals + jacobian * &by)),
        );
        Ok(Step { by, sides, covariance, counted, square, degrees })
    }
}

impl Step {
    fn largest(&self) -> f64 {
        let variances = self.covariance.diagonal();
        let steps = self.by.iter().zip(&variances);
        let sizes = steps.map(|(step, variance)| {
            if *variance > 0.0 {
                step.abs() / variance.sqrt()
            } else if *variance == 0.0 {
                0.0
            } else {
                // A negative or NaN variance must not appear as convergence.
                f64::INFINITY
            }
        });
        sizes.fold(
            0.0,
            |largest: f64, size| {
                if size.is_nan() { f64::INFINITY } else { largest.max(size) }
            },
        )
    }
}

/// Convergence limit on the change of the effective number of coefficients of any group.
const WEIGHTS_CONVERGED: f64 = 0.01;
const MAX_WEIGHT_STEPS: usize = 100;
/// Number of coefficients of a group below which one whole coefficient is excluded from the estimate of their size: so
/// few coefficients do not show their typical size, and a zero estimate by chance would shrink all of them to zero. In
/// a larger group, the fraction `SMALL_GROUP` / (number of coefficients) of one coefficient is excluded.
const SMALL_GROUP: f64 = 2.0;
/// For the uncertainties, the squared size of coefficients is enlarged by this multiple of their sampling variance,
/// that is by twice their standard uncertainty. If the observations hardly determine a size, the penalty then has no
/// effect, and the uncertainty equals the uncertainty without a penalty.
const SIZE_WITHIN: f64 = 4.0;
/// Convergence limit on the change of the logarithm of the weights used for the uncertainties.
const FOUND: f64 = 0.05;
const MAX_WEAKER_STEPS: usize = 30;

#[derive(Clone, Debug)]
pub(crate) struct Penalty {
    members: Vec<Option<(usize, f64)>>,
    /// ln λ of each group; `None` before the first step.
    log_lambda: Option<Vec<f64>>,
    pub(crate) held: bool,
    /// Whether the step is the last one, whose covariance includes the uncertainty of the weights.
    pub(crate) ends: bool,
    groups: usize,
}

pub(crate) struct Chosen {
    pub(crate) step: DVector<f64>,
    /// Covariance, scaled by the residual variance. In the last step it is computed with the weakest weights that the
    /// observations do not contradict.
    pub(crate) covariance: DMatrix<f64>,
    pub(crate) variance: f64,
    pub(crate) degrees: f64,
}

impl Penalty {
    pub(crate) fn none(system: &System, kept: &[usize]) -> Self {
        Self {
            members: kept.iter().map(|&column| system.group(column)).collect(),
            log_lambda: None,
            held: false,
            ends: false,
            groups: system.groups,
        }
    }
}

/// Equations of a step, scaled to columns of unit length, and the penalty weight of each coefficient at that scale.
struct Penalised<'a> {
    normal: DMatrix<f64>,
    right: DVector<f64>,
    now: DVector<f64>,
    weights: Vec<f64>,
    members: &'a [Option<(usize, f64)>],
    ranks: Vec<f64>,
    equations: f64,
    square: f64,
}

struct At {
    step: DVector<f64>,
    /// Root of the inverse of the penalised normal equations, which is `root · rootᵀ`.
    root: DMatrix<f64>,
    /// By group: effective number of coefficients, weighted sum of their squares, weighted sum of their sampling variances.
    used: Vec<f64>,
    sizes: Vec<f64>,
    scatter: Vec<f64>,
    degrees: f64,
    variance: f64,
}

impl Penalised<'_> {
    fn at(&self, log_lambda: &[f64]) -> Option<At> {
        let groups = self.ranks.len();
        let lambda = |place: usize| {
            self.members[place]
                .map_or(0.0, |(group, _)| log_lambda[group].exp() * self.weights[place])
        };
        let count = self.members.len();
        let diagonal = DVector::from_fn(count, |place, _| lambda(place));
        let mut matrix = self.normal.clone();
        for place in 0..count {
            matrix[(place, place)] += diagonal[place];
        }
        let factor = matrix.cholesky()?;
        let step = factor.solve(&(&self.right - diagonal.component_mul(&self.now)));
        let mut of = At {
            root: inverse(&factor.unpack().transpose())?,
            used: vec![0.0; groups],
            sizes: vec![0.0; groups],
            scatter: vec![0.0; groups],
            degrees: count as f64,
            variance: 0.0,
            step,
        };
        for (place, member) in self.members.iter().enumerate() {
            let Some((group, _)) = member else { continue };
            let own = of.root.row(place).norm_squared();
            let shrunk = own * diagonal[place];
            let found = self.now[place] + of.step[place];
            of.used[*group] += 1.0 - shrunk;
            of.degrees -= shrunk;
            of.sizes[*group] += self.weights[place] * found * found;
            of.scatter[*group] += self.weights[place] * own * (1.0 - shrunk);
        }
        // ‖r + Jx‖² = ‖r‖² − 2 rightᵀx + xᵀNx
        let step = &of.step;
        let left = self.square - 2.0 * self.right.dot(step) + step.dot(&(&self.normal * step));
        of.variance = (left / (self.equations - of.degrees).max(1.0)).max(1e-30);
        Some(of)
    }

    /// ln λ of each group at which the penalty and the observations have a similar influence.
    fn balanced(&self) -> Vec<f64> {
        let mut means = vec![0.0; self.ranks.len()];
        for (member, weight) in self.members.iter().zip(&self.weights) {
            if let Some((group, _)) = member {
                means[*group] += weight;
            }
        }
        let groups = means.iter().zip(&self.ranks);
        groups
            .map(|(mean, rank)| if *mean > 0.0 { (0.1 * rank / mean).ln() } else { 0.0 })
            .collect()
    }

    /// Covariance with weaker penalties, with which the coefficients are as large as the result permits. With the most
    /// probable weights, a curve that was shrunk to zero would have an uncertainty of zero.
    fn covariance(&self, chosen: &At, log_lambda: &[f64]) -> DMatrix<f64> {
        let starts = self.balanced().into_iter().zip(log_lambda);
        let mut weaker: Vec<f64> = starts.map(|(start, found)| start.min(*found)).collect();
        let mut root = chosen.root.clone();
        for _ in 0..MAX_WEAKER_STEPS {
            let Some(there) = self.at(&weaker) else { break };
            root = there.root;
            let mut change = 0.0_f64;
            for (group, rank) in self.ranks.iter().enumerate() {
                if *rank == 0.0 {
                    continue;
                }
                let size =
                    chosen.sizes[group] + SIZE_WITHIN * chosen.variance * there.scatter[group];
                let target = chosen.variance * there.used[group].max(1e-12) / size.max(1e-300);
                let target = target.ln().min(log_lambda[group]).max(-60.0);
                change = change.max((target - weaker[group]).abs());
                weaker[group] = target;
            }
            if change < FOUND {
                break;
            }
        }
        &root * root.transpose() * chosen.variance
    }
}

/// Chooses the weights for columns of unit length (scaled by `scale`) and computes the step from the values `now`.
fn choose(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    scale: &DVector<f64>,
    now: &DVector<f64>,
    penalty: &mut Penalty,
) -> Option<Chosen> {
    let members = penalty.members.clone();
    let mut ranks = vec![0.0; penalty.groups];
    for (group, _) in members.iter().flatten() {
        ranks[*group] += 1.0;
    }
    let equations = Penalised {
        normal: jacobian.transpose() * jacobian,
        right: -(jacobian.transpose() * residuals),
        now: now.component_div(scale),
        // Weight of each coefficient for its column of unit length.
        weights: members
            .iter()
            .zip(scale)
            .map(|(member, scale)| member.map_or(0.0, |(_, weight)| weight * scale * scale))
            .collect(),
        members: &members,
        ranks,
        equations: residuals.len() as f64,
        square: residuals.norm_squared(),
    };
    let mut log_lambda = penalty.log_lambda.clone().unwrap_or_else(|| equations.balanced());
    let mut before = vec![f64::INFINITY; penalty.groups];
    let max_steps = if penalty.held { 1 } else { MAX_WEIGHT_STEPS };
    for attempt in 0..max_steps {
        let of = equations.at(&log_lambda)?;
        let change = of.used.iter().zip(&before).map(|(a, b)| (a - b).abs());
        let change = change.fold(0.0, f64::max);
        if change < WEIGHTS_CONVERGED || attempt + 1 == max_steps {
            tracing::debug!(
                "penalties chosen in {attempt} steps, {:.1} of {} coefficients, variance {:.3}",
                of.degrees,
                members.len(),
                of.variance
            );
            let covariance = if penalty.ends {
                equations.covariance(&of, &log_lambda)
            } else {
                &of.root * of.root.transpose() * of.variance
            };
            penalty.log_lambda = Some(log_lambda);
            return Some(Chosen {
                step: of.step,
                covariance,
                variance: of.variance,
                degrees: of.degrees,
            });
        }
        before.clone_from(&of.used);
        for (group, rank) in equations.ranks.iter().enumerate() {
            if *rank == 0.0 {
                continue;
            }
            let now = log_lambda[group].exp();
            let used = of.used[group] - (SMALL_GROUP / rank).min(1.0);
            let target = of.variance * used.max(1e-12) / of.sizes[group].max(1e-300);
            // The fixed point converges slowly if a curve tends to a straight line, so the step in the logarithm is
            // lengthened.
            let ratio = (1.6 * (target / now).ln()).clamp(-6.0, 6.0);
            log_lambda[group] = (log_lambda[group] + ratio).clamp(-60.0, 60.0);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_variances_that_are_not_finite_do_not_converge() {
        let largest = |by: [f64; 2], variances: [f64; 2]| {
            let step = Step {
                by: DVector::from_row_slice(&by),
                sides: DVector::zeros(0),
                covariance: DMatrix::from_diagonal(&DVector::from_row_slice(&variances)),
                counted: 1.0,
                square: 0.0,
                degrees: 2.0,
            };
            step.largest()
        };
        assert_eq!(largest([3.0, -8.0], [1.0, 4.0]), 4.0);
        assert_eq!(largest([1.0, 1.0], [0.0, 4.0]), 0.5);
        for step in [
            largest([1.0, 1.0], [f64::NAN, 4.0]),
            largest([1.0, 1.0], [4.0, -1.0]),
            largest([f64::NAN, 1.0], [4.0, 4.0]),
        ] {
            assert_eq!(step, f64::INFINITY);
        }
    }
}
