//! What the lines add to the uncertainty of the unknowns that rest on them: other readings of the lines would have given
//! other curves, and beside these the observations other unknowns.

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

/// Maximum number of independent shifts that are propagated one by one; more of them are drawn together.
const ALONE: usize = 60;
/// How often many shifts are drawn together: the standard deviation is then known to some 5 %.
const DRAWS: u64 = 200;

/// What is needed to see what lines do to unknowns.
pub(crate) struct LinesShare<'a> {
    pub(crate) file: &'a CalibrationFile,
    pub(crate) observations: &'a Observations,
    /// The machine of the file with the unknowns as they were found.
    pub(crate) known: &'a Machine,
    pub(crate) response: &'a Response,
    /// Whether the lines hold something of the unknowns, which were found by turns with them: what changes an unknown then
    /// changes the lines, and these the unknown again.
    pub(crate) carries: bool,
}

impl LinesShare<'_> {
    /// Adds the share of the lines to the covariance of what was found and to the uncertainties of its parameters.
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

    /// What the unknowns change by where the lines have these readings, in one round.
    fn shift(
        &self,
        file: &CalibrationFile,
        base: &DVector<f64>,
    ) -> Result<DVector<f64>, CalibrateError> {
        Ok(self.response.to(&self.fitted(file)?.machine)? - base)
    }

    /// The lines of another file fitted beside the unknowns as they were found.
    pub(crate) fn fitted(&self, file: &CalibrationFile) -> Result<Stages, CalibrateError> {
        let mut known = located(file)?;
        for unknown in &self.observations.unknown {
            take(&mut known, self.known, unknown.error)?;
        }
        Stages::of(file, &known, || ())
    }

    /// The covariance by what the file states of its instruments: all that is not the scatter of runs.
    fn stated(&self, base: &DVector<f64>) -> Result<DMatrix<f64>, CalibrateError> {
        // The observations have their share already.
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
                if part == Part::Stated {
                    next(place - 1)
                } else {
                    0.0
                }
            });
            file
        };
        let alone = |own: usize| shifted(&mut |place| if place == own { 1.0 } else { 0.0 });
        let stated = (0..sizes.len()).filter(|&place| sizes[place] == Part::Stated);
        // Where nothing is stated a shift is none.
        let files: Vec<CalibrationFile> = stated
            .map(alone)
            .filter(|file| !file.reads_as(&without))
            .take(ALONE + 1)
            .collect();
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

    /// What a change of the unknowns becomes in the end by what the lines carry from round to round: 1/(1 − A), A the
    /// change that one round makes of it.
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
        // Rounds that settle carry less than all of it on.
        Ok(round
            .try_inverse()
            .unwrap_or(DMatrix::identity(count, count)))
    }
}

/// By how much an unknown is changed to see how the lines follow it, µm or µrad. That is of the size of errors, and the lines follow
/// an error of this size in proportion, so that any other change would show the same.
pub(crate) const CHANGE: f64 = 10.0;

/// The lines fitted again with one unknown larger by [`CHANGE`]; `None` for a number of a set-up, which changes nothing of the
/// machine.
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

/// Gives `to` an error of another machine: a location error that this one has not becomes 0, and a curve that it has not stays as it is.
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

/// What the scatters of lines, each of a few runs, add to a variance, and how well all of them together are known.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FewRuns {
    variance: f64,
    /// The sums of the squares of the parts over ν and over ν + 2, ν the degrees of freedom of each.
    over_degrees: f64,
    over_two_more: f64,
}

impl FewRuns {
    /// Adds a part of the variance that comes from a scatter with these degrees of freedom.
    pub(crate) fn add(&mut self, variance: f64, degrees: f64) {
        self.variance += variance;
        self.over_degrees += variance * variance / degrees;
        self.over_two_more += variance * variance / (degrees + 2.0);
    }

    /// The factor by which a standard uncertainty of this variance, of which the scatters are a part, has to be wider, so that
    /// ±1.96 of it are a band of 95 %.
    ///
    /// The formula of Welch and Satterthwaite (JCGM 100, G.4) takes each estimated variance for the true one. A scatter of two
    /// runs is by chance often much less than it should be; its share of the whole then looks small and the whole looks well known just
    /// where the band is too narrow: with one scatter of two runs beside what is known well such bands hold down to 87 %. Here the degrees of freedom
    /// are those of the scatters alone, and the factor is Student's for these to the power of their share of the variance: so bands hold 91.5 to 97.5 % in
    /// mixtures of one to ten scatters of two to five runs and what is known well.
    pub(crate) fn widening(&self, variance: f64) -> f64 {
        let square = self.variance * self.variance;
        if square <= 0.0 || self.over_degrees <= 0.0 {
            return 1.0;
        }
        // The square of an estimated variance is on average 1 + 2/ν times that of the true one. Left as it is it makes the degrees too few,
        // without it they are too many where there are few scatters: between both.
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

    /// A single scatter has its own degrees of freedom, and two alike have two and √(2ν · (2 (ν + 2) − 2)), worked out by hand.
    #[test]
    fn scatters_alone_have_the_factor_of_student() {
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
        // 2 · 1 and 2 · 3 − 2: √8.
        let two = widening(&[(1.0, 1.0), (1.0, 1.0)], 2.0);
        assert!((two - student_widening(8.0_f64.sqrt())).abs() < 1e-12);
        // Nothing of it from scatters, and nothing of it at all.
        assert_eq!(widening(&[], 4.0), 1.0);
        assert_eq!(widening(&[(0.0, 1.0)], 0.0), 1.0);
        let little = widening(&[(1e-6, 1.0)], 1.0);
        assert!((1.0..1.001).contains(&little), "{little}");
    }

    /// Bands of 95 % over many mixtures of scatters and of what is known well. With the formula of Welch and Satterthwaite
    /// those of one scatter of two runs hold 87 to 93 %.
    #[test]
    fn bands_hold_whatever_part_the_scatters_are() {
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
                assert!(
                    (0.91..0.975).contains(&share),
                    "{degrees} {mixture:?}: {share}"
                );
            }
        }
    }
}
