//! The automatic choice of a curve: one rule for all callers.

use crate::between::Band;
use crate::candidates::{Candidate, candidates};
use crate::{AutoFit, Choice, Fit, FitError, FitOptions, Noise, Reason, Score, readings};

/// Candidates whose leave-one-out RMS is more than this many times the smallest are put aside, though they may follow the readings
/// better at the targets: what they do between these is worse by far.
const FAR: f64 = 2.0;
/// A simpler candidate is taken for the best only if its leave-one-out RMS is at most this many times the best one: with few
/// targets one standard error is much. On the generated curves of `examples/automatic.rs` this comes nearest to the truth, of 1.0 to 1.25.
const AT_MOST: f64 = 1.1;

/// Chooses a curve for readings `u` at `x` by [`choose`] and fits it.
///
/// # Errors
/// Those of [`choose`].
pub fn fit_auto(x: &[f64], u: &[f64], options: &FitOptions) -> Result<AutoFit, FitError> {
    let (choice, mut fits) = choose_and_fit(&[(x, u)], options)?;
    // One set, one fit.
    let fit = fits
        .pop()
        .ok_or(FitError::Undetermined { coefficients: 1 })?;
    Ok(AutoFit { fit, choice })
}

/// Chooses one method for several sets of readings, such as those of both directions of a measured line, by what it misses of
/// whole targets that are left out with all their readings.
///
/// Candidates are polynomials in powers up to order 8 and Chebyshev series up to order 15, both up to twice the root of the number of targets
/// (beyond it a polynomial through evenly spaced targets swings at its ends) and up to that number less 2; from 3 targets on both tables,
/// from 4 on the smoothing B-spline, from 7 on moving least squares in a few settings of
/// shape 3; with a period Fourier series. Of those that meet the required residual, if any do:
///
/// 1. Put aside are those whose leave-one-out RMS is more than twice the smallest; then, if any are left without them, those that leave more of the readings than
///    these scatter (a test of the residuals against the scatter, which one of a hundred true curves fails). The scatter is that of the
///    readings of the same target, or what the options state; without it all stay. Leaving out sees no difference between scatter and what is true of a
///    single target; several runs do.
/// 2. The best is the one with the smallest leave-one-out RMS over the inner targets. The first and the last target of a set are not left
///    out: the curve is never asked beyond them, and not every kind can be.
/// 3. Taken is the simplest, the one with the fewest coefficients (trace of the hat matrix), whose squared leave-one-out errors
///    exceed those of the best, target by target, in the mean by no more than one standard error of that mean, and whose
///    leave-one-out RMS is at most 1.1 times that of the best.
/// 4. A candidate whose curve leaves, between targets, the band of the mean readings by more than a quarter of its height is put aside,
///    and the rule begins anew without it.
///
/// One target gives a constant, two give a line; three give a line, or a table where the line leaves more than the readings scatter. With a period, where the targets go all the way round, only a constant, Fourier series and, if the
/// last reading is that of the first, tables are candidates: nothing else closes.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, no set, a set without a reading, a required residual or a period that is not positive.
pub fn choose(sets: &[(&[f64], &[f64])], options: &FitOptions) -> Result<Choice, FitError> {
    choose_and_fit(sets, options).map(|(choice, _)| choice)
}

/// Chooses one method for several sets of readings by [`choose`], with the fit of each set: the choice has made them already.
///
/// # Errors
/// Those of [`choose`].
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
            Some(before) => before
                .into_iter()
                .filter_map(|candidate| candidate.with(&own))
                .collect(),
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
    let meets = |c: &Candidate| {
        options
            .required_residual
            .is_none_or(|r| c.largest_residual <= r)
    };
    let follows = |c: &Candidate| noise.is_none_or(|n| n.explains(c.squares, c.freedom));
    let mut swings = vec![false; candidates.len()];
    let mut refusal = FitError::TooFewTargets {
        purpose: "a curve",
        found: 0,
        needed: 1,
    };
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
                // The last one left stays in any case.
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
            let choice = Choice {
                method,
                reason,
                scores: scores.collect(),
            };
            return Ok((choice, fits));
        }
        // `place` is found: the method comes from the candidates.
        swings[place.unwrap_or_default()] = true;
    }
}

/// Rules 1 to 3, of candidates that are sorted by their coefficients.
fn simplest<'a>(
    candidates: &[&'a Candidate],
    follows: &dyn Fn(&Candidate) -> bool,
    magnitude: f64,
) -> Option<(&'a Candidate, Reason)> {
    let rounding = 1e-9 * magnitude;
    let first = *candidates.first()?;
    // Without an inner target nothing is judged: the constant of one target, the line of two.
    if first.errors.is_empty() {
        let most = candidates.iter().copied().reduce(|most, c| {
            if c.coefficients > most.coefficients + 0.5 {
                c
            } else {
                most
            }
        });
        return Some((most?, Reason::FewTargets));
    }
    let least = |of: &mut dyn Iterator<Item = &&'a Candidate>| {
        of.map(|c| c.leave_one_out_rms())
            .fold(f64::INFINITY, f64::min)
    };
    let smallest = least(&mut candidates.iter());
    let near = |c: &&Candidate| c.leave_one_out_rms() <= FAR * smallest + rounding;
    let near: Vec<&Candidate> = candidates.iter().copied().filter(near).collect();
    let following = near.iter().copied().filter(|c| follows(c));
    let following: Vec<&Candidate> = following.collect();
    let candidates = if following.is_empty() {
        &near
    } else {
        &following
    };
    let smallest = least(&mut candidates.iter());
    let best = *candidates
        .iter()
        .find(|c| c.leave_one_out_rms() <= smallest + rounding)?;
    let as_good = |c: &&&Candidate| {
        c.method == best.method
            || c.leave_one_out_rms() <= AT_MOST * smallest + rounding && within_one_error(c, best)
    };
    let taken = *candidates.iter().find(as_good)?;
    let reason = if taken.method == best.method {
        Reason::Smallest
    } else {
        Reason::Simplest
    };
    Some((taken, reason))
}

/// Whether the squares of the errors exceed those of the best in the mean by no more than one standard error of the mean.
fn within_one_error(candidate: &Candidate, best: &Candidate) -> bool {
    let pairs = candidate.errors.iter().zip(&best.errors);
    let differences: Vec<f64> = pairs.map(|(own, best)| own * own - best * best).collect();
    let count = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / count;
    let squares: f64 = differences.iter().map(|d| (d - mean).powi(2)).sum();
    let error = if count > 1.0 {
        (squares / (count - 1.0) / count).sqrt()
    } else {
        0.0
    };
    mean <= error
}
