//! Contribution of the lines to the uncertainty of the unknowns: the uncertainty of the readings propagates to the
//! curves, and from the curves to the unknowns that depend on them.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use volcomp_fit::student_widening;
use volcomp_identify::{Identification, Observations, Parameter, Response, machine_with};
use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_model::Machine;
use volcomp_vocabulary::ErrorName;

use crate::{
    calibration_file::{CalibrationFile, located},
    error::CalibrateError,
    stages::Stages,
    varied::{Part, normal},
};

/// Maximum number of independent shifts that are propagated individually; a larger number is
/// sampled together.
const ALONE: usize = 60;
/// Number of joint samples: they determine the standard deviation to about 5 %.
const DRAWS: u64 = 200;

pub(crate) struct LineContribution<'a> {
    pub(crate) file: &'a CalibrationFile,
    pub(crate) observations: &'a Observations,
    pub(crate) known: &'a Machine,
    pub(crate) response: &'a Response,
    /// Whether the lines depend on the unknowns, and were fitted alternately with them: a change of an unknown changes
    /// the lines, and the changed lines change the unknown again.
    pub(crate) carries: bool,
}

impl LineContribution<'_> {
    /// Adds the contribution of the lines to the covariance of the result and to the uncertainties of its parameters.
    pub(crate) fn add_to(
        &self,
        found: &mut Identification,
        stages: &Stages,
    ) -> Result<(), CalibrateError> {
        let count = found.covariance.nrows();
        let carried = if self.carries {
            self.carried(found, stages)?
        } else {
            DMatrix::identity(count, count)
        };
        let mut covariance = found.covariance.clone();
        let base = self.response.to(&stages.machine)?;
        let mut few_runs = vec![FewRuns::default(); count];
        for scatter in self.file.scatters() {
            let mut of_line = DVector::zeros(count);
            for &run in &scatter.runs {
                let shift = self.shift(&self.file.shifted_by_run(scatter.line, run), &base)?;
                covariance += &shift * shift.transpose();
                let shift = &carried * shift;
                of_line += shift.component_mul(&shift);
            }
            for (few_runs, variance) in few_runs.iter_mut().zip(&of_line) {
                few_runs.add(*variance, scatter.degrees as f64);
            }
        }
        covariance += self.stated(&base)?;
        covariance = &carried * covariance * carried.transpose();
        let widening = DVector::from_fn(count, |place, _| {
            few_runs[place].widening(covariance[(place, place)])
        });
        let widening = DMatrix::from_diagonal(&widening);
        found.covariance = &widening * covariance * &widening;
        let determined = found.parameters.iter_mut().filter(|p| p.determined);
        for (place, parameter) in determined.enumerate() {
            let variance = found.covariance[(place, place)];
            parameter.uncertainty = Some(variance.max(0.0).sqrt());
        }
        Ok(())
    }

    /// Change of the unknowns in one round if the lines have the readings of `file`; `base` is the response to the actual readings.
    fn shift(
        &self,
        file: &CalibrationFile,
        base: &DVector<f64>,
    ) -> Result<DVector<f64>, CalibrateError> {
        Ok(self.response.to(&self.fitted(file)?.machine)? - base)
    }

    pub(crate) fn fitted(&self, file: &CalibrationFile) -> Result<Stages, CalibrateError> {
        let mut known = located(file)?;
        for unknown in &self.observations.unknown {
            take(&mut known, self.known, unknown.error)?;
        }
        Stages::of(file, &known, || ())
    }

    /// Covariance due to the instrument uncertainties stated in the file, without the scatter of runs.
    fn stated(&self, base: &DVector<f64>) -> Result<DMatrix<f64>, CalibrateError> {
        // The contribution of the observations to the covariance is already included.
        let mut without = self.file.clone();
        without.observations = None;
        let mut sizes = Vec::new();
        let mut probe = without.clone();
        probe.vary_direct(&mut |part| {
            sizes.push(part);
            0.0
        });
        let shifted = |next: &mut dyn FnMut(usize) -> f64| {
            let mut file = without.clone();
            let mut place = 0;
            file.vary_direct(&mut |part| {
                place += 1;
                if part == Part::Stated { next(place - 1) } else { 0.0 }
            });
            file
        };
        let alone = |own: usize| shifted(&mut |place| if place == own { 1.0 } else { 0.0 });
        let stated = (0..sizes.len()).filter(|&place| sizes[place] == Part::Stated);
        // A part without a stated uncertainty shifts no reading and is omitted.
        let files: Vec<CalibrationFile> =
            stated.map(alone).filter(|file| !file.reads_as(&without)).take(ALONE + 1).collect();
        let count = base.len();
        let mut covariance = DMatrix::zeros(count, count);
        if files.len() <= ALONE {
            for file in &files {
                let shift = self.shift(file, base)?;
                covariance += &shift * shift.transpose();
            }
            return Ok(covariance);
        }
        for draw in 0..DRAWS {
            let mut rng = ChaCha8Rng::seed_from_u64(draw);
            let shift = self.shift(&shifted(&mut |_| normal(&mut rng)), base)?;
            covariance += &shift * shift.transpose() / DRAWS as f64;
        }
        Ok(covariance)
    }

    /// Total effect of a change of the unknowns over all rounds, (1 − A)⁻¹, where A is the effect of one round.
    fn carried(
        &self,
        found: &Identification,
        stages: &Stages,
    ) -> Result<DMatrix<f64>, CalibrateError> {
        let count = found.covariance.nrows();
        let base = self.response.to(&stages.machine)?;
        let mut round = DMatrix::identity(count, count);
        let mut column = 0;
        for (place, parameter) in found.parameters.iter().enumerate() {
            if !parameter.determined {
                continue;
            }
            let at = (&found.parameters[..], place);
            if let Some(changed) = changed(self.file, self.observations, self.known, at)? {
                let shift = self.response.to(&changed.machine)? - &base;
                let mut own = round.column_mut(column);
                own -= shift / CHANGE;
            }
            column += 1;
        }
        // If the rounds converge, the inverse exists.
        Ok(round.try_inverse().unwrap_or(DMatrix::identity(count, count)))
    }
}

/// Change of an unknown with which the response of the lines is computed, µm or µrad: the size of real errors. The
/// response is linear, so the size does not affect the result.
pub(crate) const CHANGE: f64 = 10.0;

/// Fits the lines again with one unknown increased by [`CHANGE`]; `None` for a parameter of a
/// set-up, which does not affect the machine.
pub(crate) fn changed(
    file: &CalibrationFile,
    observations: &Observations,
    known: &Machine,
    (found, place): (&[Parameter], usize),
) -> Result<Option<Stages>, CalibrateError> {
    let Some(error) = found.get(place).and_then(|parameter| parameter.error) else {
        return Ok(None);
    };
    let values = found.iter().enumerate().map(|(of, parameter)| {
        let by = if of == place { CHANGE } else { 0.0 };
        (parameter.name.clone(), parameter.value + by)
    });
    let machine = machine_with(observations, &values.collect::<Vec<_>>())?;
    let mut there = known.clone();
    take(&mut there, &machine, error)?;
    Stages::of(file, &there, || ()).map(Some)
}

/// Copies an error from `from` to `to`. A location error missing in `from` becomes 0; if a curve is missing in `from`, `to` keeps its own.
pub(crate) fn take(
    to: &mut Machine,
    from: &Machine,
    error: ErrorName,
) -> Result<(), CalibrateError> {
    if error.location {
        let value = from.locations().get(&error).copied();
        to.set_location(error, value.unwrap_or_default())?;
    } else if let Some(curve) = from.error(error) {
        to.set_error(error, curve.clone())?;
    }
    Ok(())
}

/// Variance contributed by the scatter of lines with few runs, and the effective degrees of freedom
/// of all these scatters together.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FewRuns {
    variance: f64,
    /// Sums of the squared contributions over ν and over ν + 2, where ν are the degrees of freedom of each
    /// contribution.
    over_degrees: f64,
    over_two_more: f64,
}

impl FewRuns {
    pub(crate) fn add(&mut self, variance: f64, degrees: f64) {
        self.variance += variance;
        self.over_degrees += variance * variance / degrees;
        self.over_two_more += variance * variance / (degrees + 2.0);
    }

    /// Widening factor for a standard uncertainty of this variance, which includes the scatters, so
    /// that ±1.96 times the widened uncertainty is a 95 % interval.
    ///
    /// The formula of Welch and Satterthwaite (JCGM 100, G.4) treats each estimated variance as
    /// exact. The scatter of two runs is often much too small by chance. Its fraction of the total
    /// is then underestimated, and the degrees of freedom are overestimated exactly when the
    /// interval is too narrow: with one scatter of two runs and well-known contributions, such
    /// intervals cover as little as 87 %. Here the degrees of freedom are those of the scatters
    /// alone. The factor is Student's t for them, raised to the power of their fraction of the
    /// variance. Such intervals cover 91.5 to 97.5 % in mixtures of one to ten scatters of two to
    /// five runs and well-known contributions.
    pub(crate) fn widening(&self, variance: f64) -> f64 {
        let square = self.variance * self.variance;
        if square <= 0.0 || self.over_degrees <= 0.0 {
            return 1.0;
        }
        // The square of an estimated variance is on average 1 + 2/ν times the square of the true variance. Without a
        // correction for this the degrees of freedom are too few; with the correction they are too many if there are
        // few scatters. The geometric mean is between both.
        let few = square / self.over_degrees;
        let many = square / self.over_two_more - 2.0;
        let degrees = (few * many.max(1.0)).sqrt();
        let share = (self.variance / variance).clamp(0.0, 1.0);
        student_widening(degrees).powf(share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{ChiSquared, Distribution, StandardNormal};

    /// Widening for one scatter and for two equal scatters, computed by hand: the first has its own degrees of freedom, the
    /// second √(2ν · (2 (ν + 2) − 2)).
    #[test]
    fn pure_scatter_has_the_factor_of_student() {
        let widening = |parts: &[(f64, f64)], variance: f64| {
            let mut all = FewRuns::default();
            for (part, degrees) in parts {
                all.add(*part, *degrees);
            }
            all.widening(variance)
        };
        // Table G.2 of JCGM 100.
        for (degrees, t) in [(1.0, 12.706_205), (2.0, 4.302_653), (4.0, 2.776_445)] {
            let found = widening(&[(3.0, degrees)], 3.0) * 1.959_964;
            assert!((found / t - 1.0).abs() < 1e-6, "{found} {t}");
        }
        // Two scatters with ν = 1: √(2 · 1 · (2 · 3 − 2)) = √8 degrees of freedom.
        let two = widening(&[(1.0, 1.0), (1.0, 1.0)], 2.0);
        assert!((two - student_widening(8.0_f64.sqrt())).abs() < 1e-12);
        // A variance without a part from scatters, and a variance of zero.
        assert_eq!(widening(&[], 4.0), 1.0);
        assert_eq!(widening(&[(0.0, 1.0)], 0.0), 1.0);
        let little = widening(&[(1e-6, 1.0)], 1.0);
        assert!((1.0..1.001).contains(&little), "{little}");
    }

    /// Coverage of 95 % intervals for many mixtures of scatters and well-known contributions. Intervals by the formula
    /// of Welch and Satterthwaite alone would cover 87 to 93 % with one scatter of two runs.
    #[test]
    fn bands_cover_for_any_share_of_the_scatters() {
        const TRIALS: u32 = 20_000;
        let mixtures: [&[f64]; 10] = [
            &[1.0],
            &[0.9],
            &[0.8],
            &[0.5],
            &[0.3],
            &[0.1],
            &[0.35, 0.35],
            &[0.48, 0.02, 0.02, 0.02],
            &[0.2; 5],
            &[0.1; 10],
        ];
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for degrees in [1.0, 2.0, 4.0] {
            let chance = ChiSquared::new(degrees).expect("degrees");
            for mixture in mixtures {
                let known = 1.0 - mixture.iter().sum::<f64>();
                let mut inside = 0;
                for _ in 0..TRIALS {
                    let mut scatters = FewRuns::default();
                    let mut variance = known.max(0.0);
                    for share in mixture {
                        let part: f64 = share * chance.sample(&mut rng) / degrees;
                        scatters.add(part, degrees);
                        variance += part;
                    }
                    let error: f64 = StandardNormal.sample(&mut rng);
                    let band = 1.959_964 * variance.sqrt() * scatters.widening(variance);
                    inside += u32::from(error.abs() < band);
                }
                let share = f64::from(inside) / f64::from(TRIALS);
                assert!((0.91..0.975).contains(&share), "{degrees} {mixture:?}: {share}");
            }
        }
    }
}
