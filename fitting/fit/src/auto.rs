use volcomp_curve::Curve;

use crate::fit::Judged;
use crate::{Fit, FitError, fit_bspline, fit_mls, fit_polynomial, readings};

const SHAPE: f64 = 3.0;
const MLS_TARGETS: usize = 7;
const MAX_ORDER: usize = 8;
/// Orders and supports of moving least squares tried: the published pair and stiffer and looser ones. Few on purpose: of
/// the whole grid of the automatic mode the leave-one-out error picks what follows the scatter of the readings, and
/// the calibration of the demonstration loses a third of its accuracy.
const MLS_TRIED: [(usize, f64); 4] = [(4, 1.0 / 3.0), (3, 0.3), (2, 0.25), (4, 0.5)];
/// Chooses the curve with the smallest leave-one-out RMS, those first that meet the required
/// residual: of polynomials of an order up to the number of targets less 2 (at most 8), and from 7
/// different targets on of moving least squares (four fixed settings, shape 3)
/// and the smoothing B-spline; two targets give a line, one a constant.
///
/// Periodic readings of a rotary axis are better served by [`fit_fourier`](crate::fit_fourier).
///
/// # Errors
/// Unequal lengths, numbers that are not finite, no reading, a required residual that is not
/// positive.
pub fn fit_auto(x: &[f64], u: &[f64], required_residual: Option<f64>) -> Result<Fit, FitError> {
    let targets = readings::checked_targets(x, u, 1, "a curve")?;
    readings::check_required(required_residual)?;
    if let [[_, mean]] = targets[..] {
        let mut fit = Fit::new(Curve::constant(mean)?, x, u, f64::INFINITY);
        fit.meets_required = required_residual.map(|_| true);
        return Ok(fit);
    }
    let mut best = Best::new(&targets, u, required_residual);
    let refusal = best.try_polynomials(x, u);
    if targets.len() >= MLS_TARGETS {
        // A setting that these targets cannot carry is no candidate.
        for (order, support) in MLS_TRIED {
            best.consider(fit_mls(x, u, order, support, SHAPE).ok());
        }
        best.consider(fit_bspline(x, u).ok());
    }
    let none = FitError::Undetermined { coefficients: 1 };
    best.fit.ok_or_else(|| refusal.unwrap_or(none))
}

/// The best candidate so far.
struct Best<'a> {
    targets: &'a [[f64; 2]],
    magnitude: f64,
    required_residual: Option<f64>,
    fit: Option<Fit>,
}

impl<'a> Best<'a> {
    fn new(targets: &'a [[f64; 2]], u: &[f64], required_residual: Option<f64>) -> Self {
        Self {
            targets,
            magnitude: readings::magnitude(u.iter().copied()),
            required_residual,
            fit: None,
        }
    }

    fn consider(&mut self, candidate: Option<Fit>) {
        let Some(mut fit) = candidate else {
            return;
        };
        let misses = self.targets.iter().map(|t| t[1] - fit.curve.value(t[0]));
        let worst = readings::magnitude(misses);
        fit.meets_required = self.required_residual.map(|required| worst <= required);
        let judged = |fit: &Fit| Judged {
            meets: fit.meets_required == Some(true),
            leave_one_out_rms: fit.leave_one_out_rms,
        };
        let better = judged(&fit).beats(self.fit.as_ref().map(judged), self.magnitude);
        if better {
            self.fit = Some(fit);
        }
    }

    /// Every order, until one is refused; that refusal.
    fn try_polynomials(&mut self, x: &[f64], u: &[f64]) -> Option<FitError> {
        let count = self.targets.len();
        let domain = [self.targets[0][0], self.targets[count - 1][0]];
        let orders = if count == 2 {
            1..=1
        } else {
            0..=(count - 2).min(MAX_ORDER)
        };
        for order in orders {
            match fit_polynomial(x, u, order, domain) {
                Ok(fit) => self.consider(Some(fit)),
                // Higher orders lose more; what was found below still stands.
                Err(error) => return Some(error),
            }
        }
        None
    }
}
