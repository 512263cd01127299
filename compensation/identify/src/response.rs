//! How what was found follows the errors of the machine that were taken for known.

use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_model::Machine;

use crate::{
    error::IdentifyError,
    followers::Follower,
    identify::{Fitted, told_by_searched},
    observations::Observations,
    solve::weight,
    system::System,
    values::Values,
};

/// How the determined unknowns of an identification change, to first order, where the known errors of the machine are others: what
/// the uncertainty of these adds to that of the unknowns.
#[derive(Clone, Debug)]
pub struct Response {
    observations: Observations,
    followers: Vec<Follower>,
    values: Values,
    residuals: DVector<f64>,
    /// What one of the residuals, in units of its uncertainty, moves each determined unknown by, in the unit of the unknown.
    gain: DMatrix<f64>,
}

impl Response {
    pub(crate) fn new(
        system: &System,
        observations: &Observations,
        followers: &[Follower],
        fitted: &Fitted,
    ) -> Self {
        let values = fitted.solution.values.clone();
        let rows = system.prepare(observations.fitted().flat_map(|(o, _)| &o.rows));
        let equations = system.equations(&rows, &values, false);
        let mut jacobian = equations.jacobian.select_columns(&fitted.rank.kept);
        if observations.robust {
            for (row, residual) in equations.residuals.iter().enumerate() {
                jacobian.row_mut(row).scale_mut(weight(*residual));
            }
        }
        let told = told_by_searched(system, fitted);
        Self {
            gain: -(told * &fitted.solution.of_unit_variance * jacobian.transpose()),
            residuals: equations.residuals,
            values,
            observations: observations.clone(),
            followers: followers.to_vec(),
        }
    }

    /// What the determined unknowns change by, in their order and units, where the known errors are those of this machine.
    ///
    /// # Errors
    /// A machine of another structure, or without an axis that the observations name.
    pub fn to(&self, machine: &Machine) -> Result<DVector<f64>, IdentifyError> {
        let mut observations = self.observations.clone();
        observations.machine = machine.clone();
        let system = System::new(&observations)?.followed_by(&self.followers)?;
        let rows = system.prepare(observations.fitted().flat_map(|(o, _)| &o.rows));
        let there = system.equations(&rows, &self.values, false).residuals;
        Ok(&self.gain * (there - &self.residuals))
    }
}
