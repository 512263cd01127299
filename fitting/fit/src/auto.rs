use volcomp_curve::Curve;

use crate::fit::beats;
use crate::{Fit, FitError, fit_mls_auto, fit_polynomial, readings};

const SHAPE: f64 = 3.0;
const MLS_TARGETS: usize = 7;
const MAX_ORDER: usize = 8;

/// Chooses the curve: moving least squares in the automatic mode (shape 3) from 7 different targets
/// on, as far as it has a candidate; else the polynomial of an order up to the number of targets
/// less 2 (at most 8) with the smallest leave-one-out RMS among those that meet the required
/// residual; two targets give a line, one a constant.
///
/// Periodic readings of a rotary axis are better served by [`fit_fourier`](crate::fit_fourier).
///
/// # Errors
/// Unequal lengths, numbers that are not finite, no reading, a required residual that is not
/// positive.
pub fn fit_auto(x: &[f64], u: &[f64], required_residual: Option<f64>) -> Result<Fit, FitError> {
    readings::check(x, u)?;
    if let Some(value) = required_residual.filter(|r| !(*r > 0.0 && r.is_finite())) {
        let (what, expected) = ("required residual", "a positive finite number");
        return Err(FitError::Parameter {
            what,
            value,
            expected,
        });
    }
    let targets = readings::targets(x, u);
    readings::require(&targets, 1, "a curve")?;
    if targets.len() >= MLS_TARGETS {
        match fit_mls_auto(x, u, SHAPE, required_residual) {
            Err(FitError::NoCandidate { .. }) => {}
            result => return result,
        }
    }
    if let [[_, mean]] = targets[..] {
        let mut fit = Fit::new(Curve::constant(mean)?, x, u, f64::INFINITY);
        fit.meets_required = required_residual.map(|_| true);
        return Ok(fit);
    }
    best_polynomial(&targets, x, u, required_residual)
}

fn best_polynomial(
    targets: &[[f64; 2]],
    x: &[f64],
    u: &[f64],
    required_residual: Option<f64>,
) -> Result<Fit, FitError> {
    let domain = [targets[0][0], targets[targets.len() - 1][0]];
    let orders = if targets.len() == 2 {
        1..=1
    } else {
        0..=(targets.len() - 2).min(MAX_ORDER)
    };
    let magnitude = readings::magnitude(u.iter().copied());
    let mut best: Option<Fit> = None;
    let mut refusal = None;
    for order in orders {
        let mut fit = match fit_polynomial(x, u, order, domain) {
            Ok(fit) => fit,
            // Higher orders lose more; what was found below still stands.
            Err(error) => {
                refusal = Some(error);
                break;
            }
        };
        let worst = targets.iter().map(|t| t[1] - fit.curve.value(t[0]));
        let worst = readings::magnitude(worst);
        fit.meets_required = required_residual.map(|required| worst <= required);
        let better = best.as_ref().is_none_or(|best| {
            match (
                fit.meets_required == Some(true),
                best.meets_required == Some(true),
            ) {
                (true, false) => true,
                (false, true) => false,
                _ => beats(fit.leave_one_out_rms, best.leave_one_out_rms, magnitude),
            }
        });
        if better {
            best = Some(fit);
        }
    }
    let none = FitError::Undetermined { coefficients: 1 };
    best.ok_or_else(|| refusal.unwrap_or(none))
}
