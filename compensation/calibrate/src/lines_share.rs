//! What the lines add to the uncertainty of the unknowns that rest on them: other readings of the lines would have given
//! other curves, and beside these the observations other unknowns.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use volcomp_identify::{Identification, Observations, Response};
use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_model::Machine;

use crate::{
    calibration_file::CalibrationFile,
    error::CalibrateError,
    few_runs::FewRuns,
    identified::{CHANGE, changed, take},
    locations::located,
    stages::Stages,
    varied::{Part, normal},
};

/// Up to so many independent shifts each is looked at alone; more of them are drawn together.
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
