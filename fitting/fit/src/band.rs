//! Confidence bands of fitted curves by the bootstrap.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_curve::Curve;

use crate::bspline::Problem;
use crate::choose::{Candidate, of_method};
use crate::readings::student_95;
use crate::{FitError, Method, readings};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(default))]
pub struct BandOptions {
    /// Number of resamples, at least 2. If a single run has many targets, fewer residual resamples are drawn.
    pub resamples: u32,
    /// Seed of the resampling. The same seed gives the same band.
    pub seed: u64,
}

impl Default for BandOptions {
    fn default() -> Self {
        Self { resamples: 400, seed: 1 }
    }
}

/// What was resampled to estimate the width of a band.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum BandSource {
    /// Differences between whole runs; if some runs lack targets, the scatter of their readings.
    Runs,
    /// Residuals of the only run; differences between runs are not included.
    Residuals,
}

/// Pointwise 95 % confidence band of a curve.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Band {
    /// Abscissas of the band.
    pub at: Vec<f64>,
    /// Half width of the band at each abscissa. The band spans curve ± half width.
    pub half_width: Vec<f64>,
    /// What was resampled: runs or residuals.
    pub source: BandSource,
}

/// Maximum of resamples × targets in the residual bootstrap.
const MAX_REFITTED: usize = 200_000;
const MIN_RESAMPLES: usize = 20;
/// Maximum number of abscissas of a band. With many targets, fewer abscissas lie between neighbouring targets.
const MAX_POSITIONS: usize = 2000;
/// Weight of the leave-one-out mean square in the band between targets. Leaving a target out doubles the gap that the
/// curve must bridge. For a smooth curve the error in the doubled gap is about four times the error in the real gap,
/// for a curve with kinks twice. For a curve with steps, or with waves shorter than the gap, both errors are about
/// equal. With this weight the 95 % band is also valid between targets of such waves (`examples/bands.rs`).
const OF_LEFT_OUT: f64 = 1.2;
/// Fraction of the residual variance of a single run that is attributed to errors of shape, because one run cannot
/// separate scatter from shape.
const ONE_RUN_SHAPE: f64 = 0.25;

/// 95 % confidence band, at the abscissas `at`, of the curve that `method` fits to the mean of several runs. Each run
/// is a list of targets and a list of readings.
///
/// Whole runs are resampled, so that differences between runs count. Each resample is smoothed like the mean. The
/// scatter of a few runs is poorly known, so Student's t widens the band. The part of the scatter that is common to all
/// targets of a run has (runs − 1) degrees of freedom. The rest is independent from target to target, and has (runs
/// − 1) degrees of freedom for each coefficient of the curve. The bootstrap variances of m runs are too small by (m −
/// 1)/m, and are corrected by this factor. Resampling does not show errors of shape, so two estimates of these are
/// added: the residuals of the mean readings beyond the scatter of the runs, and the larger of the leave-one-out errors
/// of the curve and of linear interpolation.
///
/// With a single run its residuals are resampled, scaled for the degrees of freedom of the fit. A curve that
/// interpolates its readings has no residuals, so its leave-one-out errors are used instead. The method and its
/// settings stay fixed.
///
/// # Errors
/// The errors of the fit, no run, or fewer than two resamples.
pub fn band(
    method: Method,
    runs: &[(&[f64], &[f64])],
    at: &[f64],
    options: &BandOptions,
) -> Result<Band, FitError> {
    if options.resamples < 2 {
        return Err(FitError::Parameter {
            what: "number of resamples",
            value: f64::from(options.resamples),
            expected: "at least 2",
        });
    }
    let x: Vec<f64> = runs.iter().flat_map(|run| run.0).copied().collect();
    let u: Vec<f64> = runs.iter().flat_map(|run| run.1).copied().collect();
    for run in runs {
        readings::check(run.0, run.1)?;
    }
    let whole = Whole::new(method, &x, &u)?;
    let (half_width, source) = if runs.len() > 1 {
        (whole.of_runs(runs, at, options)?, BandSource::Runs)
    } else {
        (whole.of_residuals(at, options)?, BandSource::Residuals)
    };
    Ok(Band { at: at.to_vec(), half_width, source })
}

/// Scatter of the mean readings of targets. It is needed if some runs lack targets, because whole runs cannot be
/// resampled then.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeanScatter {
    /// Independent shifts of the means by the part that is common to each run, its offset or its line. The variance is
    /// the sum of the squared shifts.
    pub of_runs: Vec<Vec<f64>>,
    /// Degrees of freedom of `of_runs`.
    pub run_freedom: f64,
    /// Samples of the shifts of the means that the scatter of the readings causes.
    pub samples: Vec<Vec<f64>>,
    /// Degrees of freedom of the scatter of the readings.
    pub freedom: f64,
}

impl MeanScatter {
    /// Number of samples to draw for a band with this number of targets. It falls if there are many targets.
    pub fn samples_for(targets: usize, options: &BandOptions) -> usize {
        (MAX_REFITTED / targets.max(1)).max(MIN_RESAMPLES).min(options.resamples as usize)
    }
}

/// 95 % confidence band, at the abscissas `at`, of the curve that `method` fits to the means `u` of the ascending
/// targets `x`. `scatter` is the scatter of the means. Errors of shape are included as in [`band`].
///
/// # Errors
///
/// The errors of the fit, or no samples.
pub fn band_of_means(
    method: Method,
    [x, u]: [&[f64]; 2],
    scatter: &MeanScatter,
    at: &[f64],
) -> Result<Band, FitError> {
    if scatter.samples.is_empty() {
        return Err(FitError::Parameter {
            what: "number of samples",
            value: 0.0,
            expected: "at least 1",
        });
    }
    readings::check(x, u)?;
    let whole = Whole::new(method, x, u)?;
    Ok(Band { at: at.to_vec(), half_width: whole.of_means(scatter, at)?, source: BandSource::Runs })
}

/// Abscissas at which a band is plotted with straight lines between them: the ascending `targets`, and abscissas
/// between neighbouring targets.
///
/// Between two targets the band has the shape of half an ellipse, which is steepest next to the targets. The abscissas
/// are cosines of equally spaced angles, so that the error of the straight lines is at most 2 % of the height.
pub fn band_places(targets: &[f64]) -> Vec<f64> {
    let gaps = targets.len().saturating_sub(1).max(1);
    let pieces = (MAX_POSITIONS / gaps).clamp(4, 8);
    let mut places = Vec::with_capacity(gaps * pieces + 1);
    for gap in targets.windows(2) {
        places.extend((0..pieces).map(|piece| {
            let angle = std::f64::consts::PI * piece as f64 / pieces as f64;
            gap[0] + (gap[1] - gap[0]) * (1.0 - angle.cos()) / 2.0
        }));
    }
    places.extend(targets.last());
    places
}

struct Whole {
    method: Method,
    targets: Vec<readings::Target>,
    curve: Curve,
    candidate: Candidate,
    spline: Option<(Problem, f64)>,
}

impl Whole {
    fn new(method: Method, x: &[f64], u: &[f64]) -> Result<Self, FitError> {
        let curve = method.fit(x, u)?.curve;
        let targets = readings::counted(x, u);
        let spline = if method == Method::BSpline {
            let means: Vec<[f64; 2]> = targets.iter().map(|t| [t.x, t.mean]).collect();
            let problem = Problem::new(&means);
            let log_lambda = problem.cross_validated()?;
            Some((problem, log_lambda))
        } else {
            None
        };
        Ok(Self { method, candidate: of_method(method, &targets)?, targets, curve, spline })
    }

    /// Smooths other `values` of the targets by the same method, and evaluates the resulting curve at `at`.
    fn smoothed(&self, values: &[f64], at: &[f64]) -> Result<Vec<f64>, FitError> {
        let curve = if let Some((problem, log_lambda)) = &self.spline {
            let coefficients = problem.with(values).smoothed(*log_lambda)?.coefficients;
            problem.curve(coefficients)?.into()
        } else {
            let (mut x, mut u) = (Vec::new(), Vec::new());
            for (target, value) in self.targets.iter().zip(values) {
                // Repeat each target as often as it was read. This gives it the weight of its readings.
                let mut readings = target.count;
                while readings > 0.5 {
                    x.push(target.x);
                    u.push(*value);
                    readings -= 1.0;
                }
            }
            self.method.fit(&x, &u)?.curve
        };
        Ok(at.iter().map(|&x| curve.value(x)).collect())
    }

    /// Variance of the curve at `x` relative to the variance of one mean reading, interpolated between the leverages of
    /// the neighbouring targets.
    fn leverage(&self, x: f64) -> f64 {
        let leverages = &self.candidate.leverages;
        let (i, share) = self.gap(x);
        leverages[i] + share * (leverages[(i + 1).min(leverages.len() - 1)] - leverages[i])
    }

    /// Index of the target before `x`, and the position of `x` in the gap after that target as a fraction from 0 to 1.
    fn gap(&self, x: f64) -> (usize, f64) {
        let above = self.targets.partition_point(|t| t.x <= x);
        let Some(i) = above.checked_sub(1) else {
            return (0, 0.0);
        };
        match self.targets.get(above) {
            Some(next) => (i, (x - self.targets[i].x) / (next.x - self.targets[i].x)),
            None => (i, 0.0),
        }
    }

    fn of_runs(
        &self,
        runs: &[(&[f64], &[f64])],
        at: &[f64],
        options: &BandOptions,
    ) -> Result<Vec<f64>, FitError> {
        let count = runs.len() as f64;
        let places: Vec<f64> = self.targets.iter().map(|t| t.x).collect();
        // Smooth the deviation of each run from the mean of all runs. At a target that the run lacks, the deviation
        // is 0.
        let mut rests = Vec::with_capacity(runs.len());
        let mut offsets = Vec::with_capacity(runs.len());
        let mut scatter = 0.0;
        for (x, u) in runs {
            let own = readings::counted(x, u);
            let differs: Vec<f64> = self
                .targets
                .iter()
                .map(|target| {
                    let place = own.partition_point(|t| t.x < target.x);
                    let same = own.get(place).filter(|t| t.x == target.x);
                    same.map_or(0.0, |t| t.mean - target.mean)
                })
                .collect();
            scatter += differs.iter().map(|d| d * d).sum::<f64>();
            let curve = self.smoothed(&differs, &places)?;
            let offset = curve.iter().sum::<f64>() / curve.len() as f64;
            offsets.push(offset);
            rests.push(curve.iter().map(|c| c - offset).collect::<Vec<f64>>());
        }
        // Resample whole runs.
        let mut random = ChaCha8Rng::seed_from_u64(options.seed);
        let (mut of_offset, mut of_rest) = (0.0, 0.0);
        for _ in 0..options.resamples {
            let mut drawn = vec![0.0; places.len()];
            let mut offset = 0.0;
            for _ in 0..runs.len() {
                let run = random.random_range(0..runs.len());
                offset += offsets[run] / count;
                for (sum, rest) in drawn.iter_mut().zip(&rests[run]) {
                    *sum += rest / count;
                }
            }
            of_offset += offset * offset;
            of_rest += drawn.iter().map(|d| d * d).sum::<f64>() / drawn.len() as f64;
        }
        let short = count / (count - 1.0) / f64::from(options.resamples);
        let (of_offset, of_rest) = (of_offset * short, of_rest * short);
        let variance = of_offset + of_rest;
        let coefficients = self.candidate.coefficients;
        let rest_freedom = (count - 1.0) * (coefficients - 1.0).max(1.0);
        let freedom = if variance > 0.0 {
            variance * variance
                / (of_offset * of_offset / (count - 1.0) + of_rest * of_rest / rest_freedom)
        } else {
            1.0
        };
        let t = student_95(freedom);
        // Variance of the mean reading of a target.
        let noise = scatter / ((count - 1.0) * self.targets.len() as f64) / count;
        let wrong = self.wrong(noise);
        let mean_leverage = coefficients / self.targets.len() as f64;
        let half_width = |&x: &f64| {
            let rest = of_rest * self.leverage(x) / mean_leverage;
            (t * t * (of_offset + rest) + self.wrong_at(x, wrong)).sqrt()
        };
        Ok(at.iter().map(half_width).collect())
    }

    fn of_means(&self, scatter: &MeanScatter, at: &[f64]) -> Result<Vec<f64>, FitError> {
        // For shifts of the means: the variance of the curve at each abscissa, and the mean variance of a mean.
        let variance = |shifts: &[Vec<f64>], count: f64| -> Result<(Vec<f64>, f64), FitError> {
            let mut variances = vec![0.0; at.len()];
            for shift in shifts {
                for (variance, value) in variances.iter_mut().zip(self.smoothed(shift, at)?) {
                    *variance += value * value / count;
                }
            }
            let squares: f64 = shifts.iter().flatten().map(|shift| shift * shift).sum();
            Ok((variances, squares / count / self.targets.len() as f64))
        };
        let (of_runs, _) = variance(&scatter.of_runs, 1.0)?;
        let samples = &scatter.samples;
        let (of_readings, noise) = variance(samples, samples.len() as f64)?;
        let wrong = self.wrong(noise);
        let half_width = |((&x, of_runs), of_readings): ((&f64, &f64), &f64)| {
            let variance = of_runs + of_readings;
            // The formula of Welch and Satterthwaite gives too narrow bands if the scatter of few runs is small by
            // chance. The product of Student's t factors, each raised to the power of its fraction of the variance,
            // covers 91 to 97 % of mixtures.
            let share = if variance > 0.0 { of_runs / variance } else { 0.0 };
            let t = student_95(scatter.run_freedom.max(1.0)).powf(share)
                * student_95(scatter.freedom).powf(1.0 - share);
            (t * t * variance + self.wrong_at(x, wrong)).sqrt()
        };
        let variances = at.iter().zip(&of_runs).zip(&of_readings);
        Ok(variances.map(half_width).collect())
    }

    /// Two mean square errors of the curve that the noise of the mean readings does not explain: the first at the
    /// targets of the fit, the second at left-out targets.
    fn wrong(&self, noise: f64) -> [f64; 2] {
        let count = self.targets.len() as f64;
        let residuals = self.targets.iter().map(|t| t.mean - self.curve.value(t.x));
        let left = residuals.map(|r| r * r).sum::<f64>() / count;
        // Count only the part that exceeds the expected noise by two standard deviations.
        let freedom = (count - self.candidate.coefficients).max(0.0);
        let at_targets = left - noise * (freedom + 2.0 * (2.0 * freedom).sqrt()) / count;
        let beyond = self.beyond(&self.candidate, noise);
        // The leave-one-out errors of the chosen curve may be small by chance, because it is the best of many
        // candidates, or because waves shorter than two gaps are aliased to a long wave that it follows. Linear
        // interpolation was not selected by these errors, so its errors are a lower bound.
        let of_table = of_method(Method::LinearTable, &self.targets).ok();
        let of_table = of_table.map_or(0.0, |table| self.beyond(&table, noise));
        [at_targets.max(0.0), beyond.max(of_table)]
    }

    /// Mean square leave-one-out error of a method, minus the part that the noise of the mean readings explains.
    fn beyond(&self, candidate: &Candidate, noise: f64) -> f64 {
        let errors = &candidate.errors;
        if errors.is_empty() {
            0.0
        } else {
            // Noise in a leave-one-out error: that of the left-out target, and that of the curve fitted to the other
            // targets.
            let inner = &candidate.leverages[1..self.targets.len() - 1];
            let of_noise = inner.iter().map(|&h| if h < 0.999 { 1.0 / (1.0 - h) } else { 1.5 });
            let of_noise = noise * of_noise.sum::<f64>();
            let squares = errors.iter().filter(|e| e.is_finite()).map(|e| e * e);
            ((squares.sum::<f64>() - of_noise) / errors.len() as f64).max(0.0)
        }
    }

    /// Squared half width at `x` due to errors of shape. `at_targets` applies everywhere, `beyond` only between
    /// targets.
    fn wrong_at(&self, x: f64, [at_targets, beyond]: [f64; 2]) -> f64 {
        let (_, share) = self.gap(x);
        // Student's t, because the mean square is from few errors.
        let t = student_95(self.candidate.errors.len() as f64);
        t * t * (at_targets + 4.0 * share * (1.0 - share) * OF_LEFT_OUT * beyond)
    }

    fn of_residuals(&self, at: &[f64], options: &BandOptions) -> Result<Vec<f64>, FitError> {
        let count = self.targets.len();
        let mut freedom = count as f64 - self.candidate.coefficients;
        let mut residuals: Vec<f64> =
            self.targets.iter().map(|t| t.mean - self.curve.value(t.x)).collect();
        let mut squares: f64 = residuals.iter().map(|r| r * r).sum();
        let errors = &self.candidate.errors;
        if freedom < 1.0 {
            // At a left-out target, an interpolating curve has the error of the noise of that target, plus half the
            // noise of its neighbours.
            residuals = errors.iter().copied().filter(|e| e.is_finite()).collect();
            squares = residuals.iter().map(|e| e * e / 1.5).sum();
            freedom = residuals.len() as f64;
        }
        if residuals.is_empty() || freedom < 1.0 {
            // The readings give no information about the scatter, so the band is unbounded.
            return Ok(vec![f64::INFINITY; at.len()]);
        }
        let mean = residuals.iter().sum::<f64>() / residuals.len() as f64;
        let centred: f64 = residuals.iter().map(|r| (r - mean).powi(2)).sum();
        let factor = (squares / freedom / (centred / residuals.len() as f64)).sqrt();
        if !factor.is_finite() {
            // The residuals are zero or equal, so they have no spread to scale.
            let half = if squares == 0.0 { 0.0 } else { f64::INFINITY };
            return Ok(vec![half; at.len()]);
        }
        let resamples = MeanScatter::samples_for(count, options);
        let mut random = ChaCha8Rng::seed_from_u64(options.seed);
        let mut sums = vec![0.0; at.len()];
        for _ in 0..resamples {
            let draw = |_| (residuals[random.random_range(0..residuals.len())] - mean) * factor;
            let drawn: Vec<f64> = (0..count).map(draw).collect();
            for (sum, value) in sums.iter_mut().zip(self.smoothed(&drawn, at)?) {
                *sum += value * value;
            }
        }
        let t = student_95(freedom);
        let variance = squares / freedom;
        let wrong = [ONE_RUN_SHAPE * variance, self.wrong(variance)[1]];
        let half_width = |(&x, sum): (&f64, &f64)| {
            (t * t * sum / resamples as f64 + self.wrong_at(x, wrong)).sqrt()
        };
        Ok(at.iter().zip(&sums).map(half_width).collect())
    }
}
