use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_kinematics::nalgebra::{DMatrix, DVector, SymmetricEigen};
use volcomp_model::Machine;

use crate::{
    coefficients::micro,
    error::IdentifyError,
    found_machine::machine_of,
    identify::Identification,
    observations::Observations,
    params::{Param, Values},
    system::System,
};

/// Monte Carlo samples of the machine: its errors follow the covariance of an identification, correlations included
/// (JCGM 101, propagation of distributions). An error that the observations do not determine is the same in every
/// sample.
#[derive(Clone, Debug)]
pub struct MachineSampler {
    system: System,
    /// Identified values of all coefficients, µm and µrad.
    found: Vec<f64>,
    /// Indices in `found` of the determined coefficients.
    determined: Vec<usize>,
    /// Square root of the covariance of the determined coefficients, which is the product of this matrix and its transpose.
    root: DMatrix<f64>,
}

impl MachineSampler {
    /// Prepares samples from observations and their identification.
    ///
    /// # Errors
    /// [`IdentifyError::OtherObservations`] if the identification has other unknowns than the observations; the errors
    /// of [`identify`](crate::identify()).
    pub fn new(observations: &Observations, found: &Identification) -> Result<Self, IdentifyError> {
        let system = System::new(observations)?;
        let names = (0..system.params.len()).map(|param| system.name(param));
        let is_same = names.eq(found.parameters.iter().map(|p| p.name.clone()));
        let determined = found.parameters.iter().filter(|p| p.determined).count();
        if !is_same || found.covariance.shape() != (determined, determined) {
            return Err(IdentifyError::OtherObservations);
        }
        let mut coefficients = vec![0.0; system.unknowns.coefficients.len()];
        // Columns of the covariance that belong to coefficients. Columns of set-ups are left out: their contribution is
        // already in the variances of the coefficients.
        let (mut places, mut columns) = (Vec::new(), Vec::new());
        let mut column = 0;
        for (param, parameter) in found.parameters.iter().enumerate() {
            if let Param::Coefficient(place) = system.params.at(param) {
                coefficients[place] = parameter.value;
                if parameter.determined {
                    places.push(place);
                    columns.push(column);
                }
            }
            column += usize::from(parameter.determined);
        }
        let covariance = found.covariance.select_columns(&columns).select_rows(&columns);
        Ok(Self {
            system,
            found: coefficients,
            determined: places,
            // Residuals beyond the stated uncertainties widen the distribution.
            root: root_of(&(covariance * found.excess.powi(2))),
        })
    }

    /// Returns the sample with the number `trial`, which depends only on `seed` and `trial`.
    ///
    /// # Errors
    ///
    /// A rejected curve; this does not occur for coefficients of an identification, which has already built such
    /// curves.
    pub fn machine(&self, seed: u64, trial: u64) -> Result<Machine, IdentifyError> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(trial);
        let normal = |_, _| StandardNormal.sample(&mut rng);
        let independent = DVector::from_fn(self.root.ncols(), normal);
        let shifts = &self.root * independent;
        let mut coefficients = self.found.clone();
        for (&place, shift) in self.determined.iter().zip(&shifts) {
            coefficients[place] += shift;
        }
        let listed = self.system.unknowns.coefficients.iter().zip(coefficients);
        let inside = listed.map(|(coefficient, value)| value / micro(coefficient.error.component));
        machine_of(&self.system, &Values::stated(&self.system.setup, inside.collect()))
    }
}

/// Square root of a covariance that rounding may have made slightly indefinite. Rows and columns are first divided by
/// the standard uncertainties, so that µm and µrad of any size have equal scale.
fn root_of(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let sizes = covariance.diagonal().map(|variance| variance.max(0.0).sqrt());
    let correlation = DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |row, column| {
        let size = sizes[row] * sizes[column];
        if size > 0.0 {
            // The matrix is made exactly symmetric, which the eigenvalue decomposition requires.
            0.5 * (covariance[(row, column)] + covariance[(column, row)]) / size
        } else {
            0.0
        }
    });
    let eigen = SymmetricEigen::new(correlation);
    let roots = eigen.eigenvalues.map(|value| value.max(0.0).sqrt());
    DMatrix::from_diagonal(&sizes) * eigen.eigenvectors * DMatrix::from_diagonal(&roots)
}
