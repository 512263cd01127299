//! Automatic choice of a curve. The same rule serves all callers.

use crate::between::Band;
use crate::candidates::{Candidate, candidates};
use crate::{AutoFit, Choice, Fit, FitError, FitOptions, Noise, Reason, Score, readings};

/// Candidates whose leave-one-out RMS exceeds this multiple of the smallest RMS are rejected. Such a candidate may
/// follow the readings better at the targets, but is far worse between them.
const FAR: f64 = 2.0;
/// A simpler candidate replaces the best candidate only if its leave-one-out RMS is at most this multiple of the best
/// RMS. With few targets the rule of one standard error alone would be too generous. Of the values 1.0 to 1.25, this
/// value comes closest to the true curves of `examples/automatic.rs`.
const AT_MOST: f64 = 1.1;

/// Chooses a curve for readings `u` at `x` by [`choose`], and fits it.
///
/// # Errors
/// Same as [`choose`].
pub fn fit_auto(x: &[f64], u: &[f64], options: &FitOptions) -> Result<AutoFit, FitError> {
    let (choice, mut fits) = choose_and_fit(&[(x, u)], options)?;
    // There is one set, and so one fit.
    let fit = fits.pop().ok_or(FitError::Undetermined { coefficients: 1 })?;
    Ok(AutoFit { fit, choice })
}

/// Chooses one method for several sets of readings, such as both directions of a measured line. The choice is by
/// leave-one-out errors: each target is left out with all its readings, and predicted from the other targets.
///
/// Candidates are:
///
/// - Polynomials in powers up to order 8, and Chebyshev series up to order 15. The order is also at most twice the
///   square root of the number of targets, because beyond this order a polynomial through evenly spaced targets
///   oscillates at its ends, and at most the number of targets less 2.
/// - The two tables, which need 3 targets, the smoothing B-spline, which needs 4, and moving least squares of shape 3
///   in a few settings, which need 7.
/// - With a period, Fourier series if the targets cover at least half of the period.
///
/// If any candidates meet the required residual, only these are considered. The rules are:
///
/// 1. Candidates whose leave-one-out RMS is more than twice the smallest are rejected. Then candidates whose residuals
///    exceed the scatter are rejected, unless none would remain. This is a statistical test, which one in a hundred
///    true curves fails. The scatter is from repeated readings of the same target or from the options; if it is
///    unknown, all candidates remain. Leave-one-out errors cannot separate scatter from a real error at a single
///    target, but several runs can.
/// 2. The best candidate has the smallest leave-one-out RMS over the inner targets. The first and the last target of a
///    set are not left out, because the curve is never evaluated beyond them, and some kinds of curve cannot predict
///    them.
/// 3. A candidate counts as good as the best under two conditions. First, its squared leave-one-out errors, compared
///    target by target, exceed those of the best by at most one standard error on average. Second, its leave-one-out
///    RMS is at most 1.1 times that of the best. The simplest such candidate is chosen, which is the one with the
///    fewest coefficients (trace of the hat matrix).
/// 4. If the curve of the chosen candidate leaves the range of the mean readings between targets by more than a quarter
///    of its height, the candidate is rejected, and the rules are applied again to the others.
///
/// One target gives a constant, two targets give a line. Three targets give a line, or a table if the residuals of the
/// line exceed the scatter of the readings. With a period and targets that cover the full period, the only candidates
/// are a constant, Fourier series and, if the last reading equals the first, tables, because no other kind is periodic.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, no set, a set without a reading, or a required residual or period that
/// is not positive.
pub fn choose(sets: &[(&[f64], &[f64])], options: &FitOptions) -> Result<Choice, FitError> {
    choose_and_fit(sets, options).map(|(choice, _)| choice)
}

/// Chooses one method for several sets of readings by [`choose`]. Also returns the fit of each set, which was computed
/// for the choice.
///
/// # Errors
///
/// Same as [`choose`].
pub fn choose_and_fit(
    sets: &[(&[f64], &[f64])],
    options: &FitOptions,
) -> Result<(Choice, Vec<Fit>), FitError> {
    readings::check_required(options.required_residual)?;
    if let Some(value) = options.period.filter(|p| !(*p > 0.0 && p.is_finite())) {
        return Err(FitError::Parameter {
            what: "period",
            value,
            expected: "a positive finite number",
        });
    }
    let mut together: Option<Vec<Candidate>> = None;
    let mut magnitude = 0.0_f64;
    let (mut bands, mut all_targets) = (Vec::new(), Vec::new());
    for (x, u) in sets {
        readings::check(x, u)?;
        let targets = readings::counted(x, u);
        magnitude = magnitude.max(readings::magnitude(targets.iter().map(|t| t.mean)));
        let own = candidates(&targets, options)?;
        together = Some(match together {
            None => own,
            Some(before) => {
                before.into_iter().filter_map(|candidate| candidate.with(&own)).collect()
            }
        });
        bands.push(Band::of(&targets));
        all_targets.extend(targets);
    }
    let noise = options.noise.or_else(|| Noise::pooled(&all_targets));
    let mut candidates = together.unwrap_or_default();
    candidates.sort_by(|a, b| {
        let rounded = |c: &Candidate| (c.coefficients * 1e6).round();
        rounded(a).total_cmp(&rounded(b))
    });
    let meets = |c: &Candidate| options.required_residual.is_none_or(|r| c.largest_residual <= r);
    let follows = |c: &Candidate| noise.is_none_or(|n| n.explains(c.squares, c.freedom));
    let mut swings = vec![false; candidates.len()];
    let mut refusal = FitError::TooFewTargets { purpose: "a curve", found: 0, needed: 1 };
    loop {
        let left: Vec<&Candidate> = candidates
            .iter()
            .zip(&swings)
            .filter_map(|(candidate, swings)| (!swings).then_some(candidate))
            .collect();
        let any = left.iter().any(|c| meets(c));
        let left: Vec<&Candidate> = left.into_iter().filter(|c| !any || meets(c)).collect();
        let Some((taken, reason)) = simplest(&left, &follows, magnitude) else {
            return Err(refusal);
        };
        let method = taken.method;
        let place = candidates.iter().position(|c| c.method == method);
        let mut made = taken.moving.iter();
        let fit = |(x, u): &(&[f64], &[f64])| match made.next() {
            Some(moving) => Ok(moving.clone().fit(x, u)),
            None => method.fit(x, u),
        };
        let fits: Result<Vec<Fit>, FitError> = sets.iter().map(fit).collect();
        let stays = match fits {
            Ok(mut fits) => {
                let mut pairs = fits.iter().zip(&bands);
                let holds = pairs.all(|(fit, band)| band.holds(&fit.curve));
                // The last candidate is kept even if it leaves the range.
                if holds || left.len() == 1 {
                    for fit in &mut fits {
                        fit.meets_required = options.required_residual.map(|_| any);
                    }
                    Some(fits)
                } else {
                    None
                }
            }
            Err(error) => {
                refusal = error;
                None
            }
        };
        if let Some(fits) = stays {
            let scores = candidates.iter().zip(&swings).map(|(c, &swings)| Score {
                method: c.method,
                coefficients: c.coefficients,
                leave_one_out_rms: c.leave_one_out_rms(),
                largest_residual: c.largest_residual,
                meets_required: meets(c),
                follows: follows(c),
                swings,
            });
            let choice = Choice { method, reason, scores: scores.collect() };
            return Ok((choice, fits));
        }
        // The method is from the candidates, so the index exists.
        swings[place.unwrap_or_default()] = true;
    }
}

/// Applies rules 1 to 3 of [`choose`] to candidates that are sorted by their number of coefficients.
fn simplest<'a>(
    candidates: &[&'a Candidate],
    follows: &dyn Fn(&Candidate) -> bool,
    magnitude: f64,
) -> Option<(&'a Candidate, Reason)> {
    let rounding = 1e-9 * magnitude;
    let first = *candidates.first()?;
    // Without an inner target there are no errors to compare. One target gives the constant, two give the line.
    if first.errors.is_empty() {
        let most = candidates
            .iter()
            .copied()
            .reduce(|most, c| if c.coefficients > most.coefficients + 0.5 { c } else { most });
        return Some((most?, Reason::FewTargets));
    }
    let least = |of: &mut dyn Iterator<Item = &&'a Candidate>| {
        of.map(|c| c.leave_one_out_rms()).fold(f64::INFINITY, f64::min)
    };
    let smallest = least(&mut candidates.iter());
    let near = |c: &&Candidate| c.leave_one_out_rms() <= FAR * smallest + rounding;
    let near: Vec<&Candidate> = candidates.iter().copied().filter(near).collect();
    let following = near.iter().copied().filter(|c| follows(c));
    let following: Vec<&Candidate> = following.collect();
    let candidates = if following.is_empty() { &near } else { &following };
    let smallest = least(&mut candidates.iter());
    let best = *candidates.iter().find(|c| c.leave_one_out_rms() <= smallest + rounding)?;
    let as_good = |c: &&&Candidate| {
        c.method == best.method
            || c.leave_one_out_rms() <= AT_MOST * smallest + rounding && within_one_error(c, best)
    };
    let taken = *candidates.iter().find(as_good)?;
    let reason = if taken.method == best.method { Reason::Smallest } else { Reason::Simplest };
    Some((taken, reason))
}

/// Whether the squared errors of a candidate exceed those of the best on average by at most one standard error of the
/// mean.
fn within_one_error(candidate: &Candidate, best: &Candidate) -> bool {
    let pairs = candidate.errors.iter().zip(&best.errors);
    let differences: Vec<f64> = pairs.map(|(own, best)| own * own - best * best).collect();
    let count = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / count;
    let squares: f64 = differences.iter().map(|d| (d - mean).powi(2)).sum();
    let error = if count > 1.0 { (squares / (count - 1.0) / count).sqrt() } else { 0.0 };
    mean <= error
}
