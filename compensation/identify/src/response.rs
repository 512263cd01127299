//! Dependence of the identified unknowns on the errors of the machine that were taken as known.

use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_model::Machine;

use crate::{
    equation::weight,
    error::IdentifyError,
    fit::Fitted,
    observations::Observations,
    parameters::reported_by_searched,
    params::Values,
    rank::of_unit_length,
    system::{Follower, System},
};

/// First-order dependence of the determined unknowns on the known errors of the machine. With it, the uncertainty of
/// the known errors propagates to the unknowns.
#[derive(Clone, Debug)]
pub struct Response {
    observations: Observations,
    followers: Vec<Follower>,
    values: Values,
    residuals: DVector<f64>,
    /// Derivatives of the residuals with respect to the determined unknowns, as columns of unit length.
    jacobian: DMatrix<f64>,
    /// Change of each determined unknown, in its unit, per residual divided by its uncertainty.
    gain: DMatrix<f64>,
}

/// Share of a hypothetical change of the known errors that the observations support.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupportedShare {
    /// 1 for the whole change, 0 for none.
    pub share: f64,
    /// Standard uncertainty of the share.
    pub uncertainty: f64,
}

impl Response {
    pub(crate) fn new(
        system: &System,
        observations: &Observations,
        followers: &[Follower],
        fitted: &Fitted,
    ) -> Self {
        let values = fitted.solution.values.clone();
        let rows = system.prepare(observations.fitted_rows());
        let equations = system.equations(&rows, &values);
        let mut jacobian = equations.jacobian.select_columns(&fitted.rank.kept);
        let normed = of_unit_length(jacobian.clone());
        if observations.robust {
            for (row, residual) in equations.residuals.iter().enumerate() {
                jacobian.row_mut(row).scale_mut(weight(*residual));
            }
        }
        let reported = reported_by_searched(system, fitted);
        Self {
            gain: -(reported * &fitted.solution.of_unit_variance * jacobian.transpose()),
            residuals: equations.residuals,
            jacobian: normed,
            values,
            observations: observations.clone(),
            followers: followers.to_vec(),
        }
    }

    /// Returns the change of the determined unknowns, in their order and units, if the known errors of the observations
    /// are replaced by those of `machine`.
    ///
    /// # Errors
    /// A machine with another structure.
    pub fn to(&self, machine: &Machine) -> Result<DVector<f64>, IdentifyError> {
        Ok(&self.gain * self.changed(machine)?)
    }

    /// Estimates to which share the observations support hypothetical changes of the known errors, one change for each
    /// of `machines` (1: the whole change), with the standard uncertainty of the share. All shares and the unknowns are
    /// estimated together. `None` for a change that the unknowns compensate: the observations contain no information
    /// about it.
    ///
    /// # Errors
    /// Same as [`Response::to`].
    pub fn supported_shares(
        &self,
        machines: &[Machine],
    ) -> Result<Vec<Option<SupportedShare>>, IdentifyError> {
        /// Maximum share of a change in the residuals at which the unknowns are considered to compensate the change.
        const MAX_COMPENSATED_SHARE: f64 = 1e-3;
        /// Prior standard uncertainty of a share. It bounds shares that the observations determine only in combination.
        const PRIOR_SHARE: f64 = 10.0;
        let within = self.jacobian.clone().qr().q();
        let beyond = |of: &DVector<f64>| of - &within * (within.transpose() * of);
        let left = beyond(&self.residuals);
        let mut seen = Vec::new();
        let mut is_seen = Vec::new();
        for machine in machines {
            let change = self.changed(machine)?;
            let own = beyond(&change);
            is_seen.push(own.norm() > MAX_COMPENSATED_SHARE * change.norm());
            if own.norm() > MAX_COMPENSATED_SHARE * change.norm() {
                seen.push(own);
            }
        }
        if seen.is_empty() {
            return Ok(vec![None; machines.len()]);
        }
        let seen = DMatrix::from_columns(&seen);
        let count = seen.ncols();
        let freedom = self.residuals.len().saturating_sub(within.ncols() + count);
        let freedom = freedom.max(1) as f64;
        let square = seen.transpose() * &seen;
        // Residuals above the stated uncertainties reduce the information in the same proportion.
        let mut variance = 1.0;
        let mut estimate = (DVector::zeros(count), DMatrix::zeros(count, count));
        for _ in 0..2 {
            let information =
                &square / variance + DMatrix::identity(count, count) / (PRIOR_SHARE * PRIOR_SHARE);
            let Some(covariance) = information.try_inverse() else {
                return Ok(vec![None; machines.len()]);
            };
            let shares = -(&covariance * (seen.transpose() * &left)) / variance;
            variance = ((&left + &seen * &shares).norm_squared() / freedom).max(1.0);
            estimate = (shares, covariance);
        }
        let (values, covariance) = estimate;
        let mut places = 0..count;
        let shares = is_seen.into_iter().map(|is_seen| {
            let place = if is_seen { places.next() } else { None };
            place.map(|place| SupportedShare {
                share: values[place],
                uncertainty: covariance[(place, place)].max(0.0).sqrt(),
            })
        });
        Ok(shares.collect())
    }

    fn changed(&self, machine: &Machine) -> Result<DVector<f64>, IdentifyError> {
        let [found, expected] =
            [machine, &self.observations.machine].map(|machine| machine.chain().structure());
        if found != expected {
            return Err(IdentifyError::OtherStructure {
                found: found.to_string(),
                expected: expected.to_string(),
            });
        }
        let mut observations = self.observations.clone();
        observations.machine = machine.clone();
        let system = System::new(&observations)?.followed_by(&self.followers)?;
        let rows = system.prepare(observations.fitted_rows());
        let changed_residuals = system.equations(&rows, &self.values).residuals;
        Ok(changed_residuals - &self.residuals)
    }
}
