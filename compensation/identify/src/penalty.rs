//! How much a curve may bend, chosen from the observations: the weights of the penalties at which the observations are
//! most probable (restricted maximum likelihood), by the fixed point of Wood and Fasiolo, Biometrics 73 (2017).

use volcomp_kinematics::nalgebra::{DMatrix, DVector};

use crate::system::System;

/// When no group's effective number of coefficients changes by more, the weights are found.
const CONVERGED: f64 = 0.01;
const MOST_STEPS: usize = 100;

/// The penalties of the kept parameters.
#[derive(Clone, Debug)]
pub(crate) struct Penalty {
    /// Group and weight of each kept parameter.
    pub(crate) members: Vec<Option<(usize, f64)>>,
    /// The logarithm of λ of each group, once chosen.
    pub(crate) log_lambda: Option<Vec<f64>>,
    /// Whether the weights are no longer changed.
    pub(crate) held: bool,
    groups: usize,
}

/// A penalised step.
pub(crate) struct Chosen {
    pub(crate) step: DVector<f64>,
    /// Scaled by the variance of what is left.
    pub(crate) covariance: DMatrix<f64>,
    pub(crate) variance: f64,
    pub(crate) degrees: f64,
}

impl Penalty {
    /// The groups of the kept parameters, weights not yet chosen.
    pub(crate) fn none(system: &System, kept: &[usize]) -> Self {
        Self {
            members: kept.iter().map(|&column| system.group(column)).collect(),
            log_lambda: None,
            held: false,
            groups: system.groups,
        }
    }
}

/// Chooses the weights for columns of unit length (`scale` made them so) and takes the step from the values `now`.
pub(crate) fn choose(
    jacobian: &DMatrix<f64>,
    residuals: &DVector<f64>,
    scale: &DVector<f64>,
    now: &DVector<f64>,
    penalty: &mut Penalty,
) -> Option<Chosen> {
    let count = jacobian.ncols();
    let normal = jacobian.transpose() * jacobian;
    let right = -(jacobian.transpose() * residuals);
    let now = now.component_div(scale);
    // Weight of each coefficient in the units of its scaled column.
    let weights: Vec<f64> = penalty
        .members
        .iter()
        .zip(scale)
        .map(|(member, scale)| member.map_or(0.0, |(_, weight)| weight * scale * scale))
        .collect();
    let mut ranks = vec![0.0; penalty.groups];
    let mut means = vec![0.0; penalty.groups];
    for (member, weight) in penalty.members.iter().zip(&weights) {
        if let Some((group, _)) = member {
            ranks[*group] += 1.0;
            means[*group] += weight;
        }
    }
    let mut log_lambda = penalty.log_lambda.clone().unwrap_or_else(|| {
        // Begins where a penalty and the observations weigh about the same.
        let starts = means.iter().zip(&ranks);
        starts
            .map(|(mean, rank)| {
                if *mean > 0.0 {
                    (0.1 * rank / mean).ln()
                } else {
                    0.0
                }
            })
            .collect()
    });
    let equations = residuals.len() as f64;
    let square = residuals.norm_squared();
    let mut before = vec![f64::INFINITY; penalty.groups];
    let most = if penalty.held { 1 } else { MOST_STEPS };
    for attempt in 0..most {
        let lambda = |place: usize| {
            penalty.members[place]
                .map_or(0.0, |(group, _)| log_lambda[group].exp() * weights[place])
        };
        let diagonal = DVector::from_fn(count, |place, _| lambda(place));
        let mut matrix = normal.clone();
        for place in 0..count {
            matrix[(place, place)] += diagonal[place];
        }
        let factor = matrix.cholesky()?;
        let step = factor.solve(&(&right - diagonal.component_mul(&now)));
        let inverse = factor.inverse();
        let found = &now + &step;
        let mut used = vec![0.0; penalty.groups];
        let mut sizes = vec![0.0; penalty.groups];
        let mut degrees = count as f64;
        for (place, member) in penalty.members.iter().enumerate() {
            let Some((group, _)) = member else { continue };
            let shrunk = inverse[(place, place)] * diagonal[place];
            used[*group] += 1.0 - shrunk;
            degrees -= shrunk;
            sizes[*group] += weights[place] * found[place] * found[place];
        }
        // ‖r + Jx‖² = ‖r‖² − 2 rightᵀx + xᵀNx
        let left = square - 2.0 * right.dot(&step) + step.dot(&(&normal * &step));
        let variance = (left / (equations - degrees).max(1.0)).max(1e-30);
        let change = used.iter().zip(&before).map(|(a, b)| (a - b).abs());
        let change = change.fold(0.0, f64::max);
        if change < CONVERGED || attempt + 1 == most {
            tracing::debug!(
                "penalties chosen in {attempt} steps, {degrees:.1} of {count} coefficients, variance {variance:.3}"
            );
            penalty.log_lambda = Some(log_lambda);
            return Some(Chosen {
                step,
                covariance: inverse * variance,
                variance,
                degrees,
            });
        }
        before.clone_from(&used);
        for group in 0..penalty.groups {
            if ranks[group] == 0.0 {
                continue;
            }
            let now = log_lambda[group].exp();
            let wanted = variance * used[group].max(1e-12) / sizes[group].max(1e-300);
            // The fixed point creeps where a curve wants to be straight: a longer step in the logarithm.
            let ratio = (1.6 * (wanted / now).ln()).clamp(-6.0, 6.0);
            log_lambda[group] = (log_lambda[group] + ratio).clamp(-60.0, 60.0);
        }
    }
    None
}
