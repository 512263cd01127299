//! Penalty weights of curves, chosen so that the observations are most probable (restricted
//! maximum likelihood), by the fixed point of Wood and Fasiolo, Biometrics 73 (2017).

use volcomp_kinematics::nalgebra::{DMatrix, DVector};

use crate::{system::System, triangle::inverse};

/// Convergence limit on the change of the effective number of coefficients of any group.
const CONVERGED: f64 = 0.01;
const MAX_STEPS: usize = 100;
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
    pub(crate) members: Vec<Option<(usize, f64)>>,
    /// ln λ of each group; `None` before the first step.
    pub(crate) log_lambda: Option<Vec<f64>>,
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
pub(crate) fn choose(
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
    let max_steps = if penalty.held { 1 } else { MAX_STEPS };
    for attempt in 0..max_steps {
        let of = equations.at(&log_lambda)?;
        let change = of.used.iter().zip(&before).map(|(a, b)| (a - b).abs());
        let change = change.fold(0.0, f64::max);
        if change < CONVERGED || attempt + 1 == max_steps {
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
