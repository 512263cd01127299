//! Results of an identification: values in their units, covariance, and undetermined unknowns.
//!
//! Also the dependence of the identified unknowns on the errors of the machine that were taken as known.

use volcomp_kinematics::nalgebra::{DMatrix, DVector, Vector3};
use volcomp_model::Machine;

use crate::equation::weight;
use crate::error::IdentifyError;
use crate::fit::Fitted;
use crate::observations::{Observations, Part};
use crate::params::{Param, Parameter, Values, six_of};
use crate::rank::{Rank, of_unit_length};
use crate::system::{Follower, System};

/// Derivatives of the reported parameters with respect to those of the search. The matrix is diagonal except for frames, which the
/// search rotates about the middle of the observed points.
fn reported_by_searched(system: &System, fitted: &Fitted) -> DMatrix<f64> {
    let count = fitted.rank.kept.len();
    let mut derivatives = DMatrix::zeros(count, count);
    for (row, &param) in fitted.rank.kept.iter().enumerate() {
        let (_, scale) = system.unit_of(param);
        let Some((frame, place)) = of_frame(system.params.at(param)) else {
            derivatives[(row, row)] = scale;
            continue;
        };
        let frame_now = &fitted.solution.values.frames[frame];
        let arm = frame_now.pose.translation_mm - frame_now.middle_mm;
        let six = six_of(&frame_now.pose);
        for (column, &other) in fitted.rank.kept.iter().enumerate() {
            let Some((_, by)) = of_frame(system.params.at(other)).filter(|(of, _)| *of == frame)
            else {
                continue;
            };
            let mut turn = Vector3::zeros();
            let mut shift = Vector3::zeros();
            if by < 3 {
                shift[by] = 1.0;
            } else {
                turn[by - 3] = 1.0;
            }
            derivatives[(row, column)] = if place < 3 {
                (shift + turn.cross(&arm))[place]
            } else {
                // ω = (R_z R_y e_x) da + (R_z e_y) db + e_z dc, solved for the rates of the angles.
                let (sb, cb) = six[4].sin_cos();
                let (sc, cc) = six[5].sin_cos();
                let along = cc * turn.x + sc * turn.y;
                let cosine = if cb.abs() < 1e-9 { 1e-9 } else { cb };
                let rates =
                    [along / cosine, cc * turn.y - sc * turn.x, turn.z + along * sb / cosine];
                rates[place - 3] * scale
            };
        }
    }
    derivatives
}

/// Frame and component (0 to 5) of a set-up parameter that does not drift.
fn of_frame(param: Param) -> Option<(usize, usize)> {
    match param {
        Param::SetUp { part: Part::Frame(frame), place, order: 0 } => Some((frame, place)),
        _ => None,
    }
}

pub(crate) fn covariance_in_units(system: &System, fitted: &Fitted) -> DMatrix<f64> {
    let derivatives = reported_by_searched(system, fitted);
    &derivatives * &fitted.solution.covariance * derivatives.transpose()
}

pub(crate) fn parameters(system: &System, fitted: &Fitted) -> Vec<Parameter> {
    let covariance = covariance_in_units(system, fitted);
    let values = &fitted.solution.values;
    let parameter = |(param, what): (usize, Param)| {
        let (unit, scale) = system.unit_of(param);
        let value = values.of(what) * scale;
        let place = fitted.rank.kept.iter().position(|kept| *kept == param);
        let mixed = |null: &&Vec<(usize, f64)>| null[1..].iter().any(|(c, _)| *c == param);
        Parameter {
            name: system.name(param),
            error: match what {
                Param::Coefficient(place) => Some(system.unknowns.coefficients[place].error),
                Param::SetUp { .. } => None,
            },
            value,
            unit,
            uncertainty: place.map(|place| covariance[(place, place)].max(0.0).sqrt()),
            determined: place.is_some(),
            given_zero: fitted
                .rank
                .null
                .iter()
                .filter(mixed)
                .map(|null| system.name(null[0].0))
                .collect(),
        }
    };
    system.params.iter().enumerate().map(parameter).collect()
}

/// An error coefficient that the observations do not determine and that is not a
/// convention. It is fixed at zero; the readings are the same for any value.
#[derive(Clone, Debug, PartialEq)]
pub struct UndeterminedError {
    /// Name of the coefficient among the parameters.
    pub name: String,
    /// Unit, `um` or `urad`.
    pub unit: &'static str,
    /// Combination of changes of error coefficients, including this one, that has no effect on the readings: name of
    /// each coefficient, and its change, in its unit, per unit of change of this coefficient.
    pub moves: Vec<(String, f64)>,
}

pub(crate) fn undetermined(system: &System, rank: &Rank) -> Vec<UndeterminedError> {
    let is_error = |null: &&Vec<(usize, f64)>| system.is_convention(null[0].0) == Some(false);
    let open = rank.null.iter().filter(is_error).map(|null| {
        let left = null[0].0;
        let (unit, _) = system.unit_of(left);
        // Weights refer to columns of unit length.
        let change = |&(param, weight): &(usize, f64)| {
            let length = rank.lengths[param];
            let length = if length > 0.0 { length } else { 1.0 };
            weight / length * system.unit_of(param).1
        };
        let whole = change(&null[0]);
        let errors = (null.iter())
            .filter(|(param, _)| matches!(system.params.at(*param), Param::Coefficient(_)));
        UndeterminedError {
            name: system.name(left),
            unit,
            moves: errors.map(|share| (system.name(share.0), change(share) / whole)).collect(),
        }
    });
    open.collect()
}

/// Names of the unknowns that are fixed at zero by convention: constants of curves and slopes of straightnesses.
pub(crate) fn redundant(system: &System, rank: &Rank) -> Vec<String> {
    let left = rank.left_at_zero();
    left.filter(|column| system.is_convention(*column) == Some(true))
        .map(|column| system.name(column))
        .collect()
}

/// Notes on indistinguishable unknowns: one for each that more observations could determine, and
/// one for all conventions together.
pub(crate) fn left_at_zero(
    system: &System,
    fitted: &Fitted,
    null: &[Vec<(String, f64)>],
) -> Vec<String> {
    let rank = &fitted.rank;
    let is_convention = |place: &usize| {
        let left = rank.null[*place][0].0;
        system.is_convention(left) == Some(true)
    };
    let (conventions, missing): (Vec<usize>, Vec<usize>) = (0..null.len()).partition(is_convention);
    let is_setup = |place: usize| rank.null[place][0].0 < system.params.setup();
    let words = |place: &usize| {
        let mut uncertain = fitted.uncertain.iter();
        match uncertain.find(|of| of.param == rank.null[*place][0].0) {
            Some(of) => of.words(system),
            None => null_in_words(&null[*place], is_setup(*place)),
        }
    };
    let mut notes: Vec<String> = missing.iter().map(words).collect();
    match &conventions[..] {
        [] => {}
        [one] => notes.push(words(one)),
        several => {
            let names: Vec<&str> = several.iter().map(|place| null[*place][0].0.as_str()).collect();
            notes.push(format!(
                "left at zero by convention, because they are equivalent to location errors, other constants or the set-up: {}",
                names.join(", ")
            ));
        }
    }
    notes
}

fn null_in_words(null: &[(String, f64)], is_setup: bool) -> String {
    const MAX_LISTED: usize = 4;
    let (left, others) = (&null[0].0, &null[1..]);
    let where_left = if is_setup { "at its start value" } else { "at zero" };
    if others.is_empty() {
        return format!("{left} has no effect in these observations: it is left {where_left}");
    }
    let mut names: Vec<&str> = others.iter().map(|(name, _)| name.as_str()).collect();
    let more = names.len().saturating_sub(MAX_LISTED);
    names.truncate(MAX_LISTED);
    let mut with = names.join(", ");
    if more > 0 {
        with = format!("{with} and {more} more");
    }
    format!("{left} cannot be distinguished from {with}: it is left {where_left}")
}

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
