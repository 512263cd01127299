//! Identifies the errors of a machine from observations.
//!
//! The result is the machine with the identified errors, their validation, and Monte Carlo samples of the machine.

use std::collections::BTreeSet;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_curve::{ErrorCurve, Field};
use volcomp_document::Note;
use volcomp_kinematics::nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3};
use volcomp_model::Machine;
use volcomp_vocabulary::ErrorName;

use crate::checks::median;
use crate::checks::result::{
    contradiction, few, inverted, large, outliers, refuse_far, refuse_rows, refuse_target,
    refuse_unexplained, small_travel, times_by_file,
};
use crate::coefficients::{Role, micro};
use crate::error::{IdentifyError, at};
use crate::fit::{Fitted, Folds, fit};
use crate::next::{Next, next};
use crate::observations::Observations;
use crate::parameters::{
    Response, UndeterminedError, covariance_in_units, left_at_zero, parameters, redundant,
    undetermined,
};
use crate::params::{Param, Parameter, Values};
use crate::start::start;
use crate::system::{Follower, Rows, System};

/// Result of an identification, with its uncertainties and warnings.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Identification {
    /// The machine with the identified errors.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub machine: Machine,
    /// Every unknown: set-ups first, then the errors.
    pub parameters: Vec<Parameter>,
    /// The covariance of the determined parameters in their order, in the products of their units.
    /// It follows from the stated uncertainties alone. If the unknowns do not describe the machine,
    /// `variance` is above 1, and a warning is added. With penalties or robust weights it follows
    /// from the residuals.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub covariance: DMatrix<f64>,
    /// Number of combinations of the unknowns that the observations determine.
    pub rank: usize,
    /// σ_min/σ_max of the columns scaled to unit length; 0 if the rank is not full.
    pub score: f64,
    /// σ_min/σ_max of the scaled columns of the determined unknowns only.
    pub score_of_determined: f64,
    /// Unknowns left at zero by convention: constants of curves and slopes of straightnesses that are equivalent to location
    /// errors, other constants or the set-up.
    pub redundant: Vec<String>,
    /// Every combination of unknowns that does not affect the observations, as names and weights;
    /// the unknown left at zero is first.
    #[cfg_attr(feature = "serde", serde(serialize_with = "as_maps"))]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "Vec<std::collections::BTreeMap<String, f64>>")
    )]
    pub null: Vec<Vec<(String, f64)>>,
    /// Undetermined errors, without those that are zero by convention.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub undetermined: Vec<UndeterminedError>,
    /// Residuals of the fitted rows.
    #[cfg_attr(feature = "serde", serde(rename = "residual_um"))]
    pub residual: Figures,
    /// Residual of each fitted row, by file.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub residuals: Vec<FileResiduals>,
    /// Residuals of rows omitted from the fit (cross-validation); `None`: not computed.
    #[cfg_attr(feature = "serde", serde(rename = "left_out_um"))]
    pub left_out: Option<LeftOut>,
    /// Residuals of observations with `judge = true`; `None` without such observations.
    #[cfg_attr(
        feature = "serde",
        serde(rename = "judged_um", skip_serializing_if = "Option::is_none")
    )]
    pub judged: Option<Figures>,
    /// Variance of the residuals relative to the stated variance.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub variance: f64,
    /// Factor by which the standard uncertainties from `covariance` must be multiplied, because the residuals exceed
    /// the stated uncertainties. 1 if chance explains the residuals, or if the covariance already includes them.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub excess: f64,
    /// Whether the result is contradicted: by a file whose residuals exceed three times the stated uncertainty (not
    /// checked with penalties or robust weights), or by a file of rows that were only predicted.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub is_contradicted: bool,
    /// Effective number of unknowns. With penalties it is smaller than the rank.
    #[cfg_attr(feature = "serde", serde(rename = "effective"))]
    pub degrees: f64,
    /// The most useful next pose; `None` if nothing is uncertain.
    pub next: Option<Next>,
    /// Warnings, assumptions, and information that was not used.
    pub warnings: Vec<Note>,
}

/// Maximum ratio of residuals to stated uncertainty at which the unknowns are taken to describe the machine.
const MAX_RESIDUAL_RATIO: f64 = 3.0;

impl Identification {
    /// Errors whose values the observations do not support: undetermined errors, and errors whose value holds only if
    /// an undetermined error is zero. Returns all errors if the residuals of all observations or of one file exceed
    /// three times the stated uncertainty, or if predicted rows are far off.
    pub fn undecided(&self) -> BTreeSet<ErrorName> {
        let is_described = self.variance <= MAX_RESIDUAL_RATIO.powi(2) && !self.is_contradicted;
        let is_open = |of: &Parameter| !of.determined && !self.redundant.contains(&of.name);
        let errors = self.parameters.iter().filter(|of| of.error.is_some());
        let open: Vec<&str> =
            (errors.clone().filter(|of| is_open(of))).map(|of| of.name.as_str()).collect();
        let holds_on_open =
            |of: &Parameter| (of.given_zero.iter()).any(|zero| open.contains(&zero.as_str()));
        errors
            .filter(|of| !is_described || is_open(of) || holds_on_open(of))
            .filter_map(|of| of.error)
            .collect()
    }
}

#[cfg(feature = "serde")]
fn as_maps<S: serde::Serializer>(
    null: &[Vec<(String, f64)>],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    struct Weights<'a>(&'a [(String, f64)]);
    impl serde::Serialize for Weights<'_> {
        fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            serializer.collect_map(self.0.iter().map(|(name, weight)| (name, weight)))
        }
    }
    serializer.collect_seq(null.iter().map(|weights| Weights(weights)))
}

/// Identifies the unknowns of the observations. `progress` receives the number of completed fits and their total.
///
/// # Errors
/// * Observations that no file could state: [`IdentifyError::Unusable`], [`IdentifyError::NoSuchPlace`].
/// * No rows, too few rows, or identical rows; an undetermined frame; a search that does not converge.
/// * Rows that no machine like the nominal one can have produced: [`IdentifyError::FarRows`], and
///   [`IdentifyError::Unexplained`] if residuals after the fit are larger than real machines deviate.
/// * A curve that cannot be built from the identified coefficients: [`IdentifyError::Curve`].
pub fn identify(
    observations: &Observations,
    mut progress: impl FnMut(usize, usize),
) -> Result<Identification, IdentifyError> {
    let system = System::new(observations)?;
    followed(&system, observations, &mut progress).map(|(found, _)| found)
}

/// Like [`identify`], for a machine whose known errors depend on the unknowns (`followers`). Residuals and covariance
/// include this dependence. Also returns the dependence of the result on the known errors.
///
/// In the identified machine, the known errors remain as in the observations.
///
/// # Errors
/// Same as [`identify`].
pub fn identify_followed(
    observations: &Observations,
    followers: &[Follower],
    mut progress: impl FnMut(usize, usize),
) -> Result<(Identification, Response), IdentifyError> {
    let system = System::new(observations)?.followed_by(followers)?;
    let (found, fitted) = followed(&system, observations, &mut progress)?;
    let response = Response::new(&system, observations, followers, &fitted);
    Ok((found, response))
}

/// Not generic over `progress`, so that it is compiled only once.
fn followed(
    system: &System,
    observations: &Observations,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<(Identification, Fitted), IdentifyError> {
    let rows = system.prepare(observations.fitted_rows());
    refuse_rows(system, &rows)?;
    let fits = 1 + observations.folds;
    progress(0, fits);
    let values = start(system, observations, &rows)?;
    refuse_far(system, observations, &rows, &values)?;
    let fitted = fit(system, observations, &rows, values.clone())?;
    refuse_target(system, &rows, &fitted.rank)?;
    progress(1, fits);
    let machine = machine_of(system, &fitted.solution.values)?;
    let residuals = system.residuals(&rows, &fitted.solution.values);
    refuse_unexplained(system, observations, &rows, &residuals)?;
    let (left_out, why_not) = left_out(system, observations, &rows, (&values, &fitted), |done| {
        progress(1 + done, fits);
    })?;
    let (judged, of_judged) =
        judged(system, observations, &fitted.solution.values, figures(&residuals));
    let parameters = parameters(system, &fitted);
    let names =
        |null: &Vec<(usize, f64)>| null.iter().map(|(c, w)| (system.name(*c), *w)).collect();
    let null: Vec<Vec<(String, f64)>> = fitted.rank.null.iter().map(names).collect();
    let warning = |text: &String| Note::warning("", text.as_str());
    // Warnings of a wrong result come first, then warnings of an uncertain result, then notes that any result may have.
    let mut warnings = inverted(system, observations, &rows, &fitted);
    warnings.extend(contradiction(observations, &rows, &residuals, &fitted));
    warnings.extend(outliers(observations, &rows, &residuals));
    let is_contradicted = !of_judged.files.is_empty()
        || !fitted.solution.counts_residuals
            && (times_by_file(observations, &rows, &residuals).iter())
                .any(|(times, _)| *times > MAX_RESIDUAL_RATIO);
    warnings.extend(of_judged.files);
    warnings.extend(of_judged.rows);
    warnings.extend(large(system, &fitted));
    warnings.extend(few(&rows, &fitted));
    warnings.extend(observations.notes.iter().map(|text| Note::info("", text.as_str())));
    warnings.extend(observations.fourier_gap_notes().iter().map(warning));
    warnings.extend(small_travel(&system.machine, &rows));
    warnings.extend(why_not);
    warnings.extend(left_at_zero(system, &fitted, &null).iter().map(warning));
    let mut found = Identification {
        covariance: covariance_in_units(system, &fitted),
        rank: fitted.rank.kept.len(),
        score: fitted.rank.score(),
        score_of_determined: fitted.rank.score_of_kept(),
        redundant: redundant(system, &fitted.rank),
        undetermined: undetermined(system, &fitted.rank),
        residual: figures(&residuals),
        residuals: by_file(observations, &rows, &residuals),
        judged,
        left_out,
        variance: fitted.solution.variance,
        excess: fitted.solution.excess_of_covariance(),
        is_contradicted,
        degrees: fitted.solution.degrees,
        next: next(system, observations, &rows, &fitted),
        machine,
        parameters,
        null,
        warnings,
    };
    found.machine.leave_undecided(found.undecided());
    Ok((found, fitted))
}

/// Residuals of the fitted rows of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct FileResiduals {
    /// Name of the row file.
    pub file: String,
    /// Size of the residual of each row and its stated standard uncertainty, µm, in the order of the file.
    pub rows: Vec<[f64; 2]>,
}

fn by_file(
    observations: &Observations,
    rows: &Rows,
    residuals: &[Vector3<f64>],
) -> Vec<FileResiduals> {
    let files = observations.fitted().map(|(observation, own)| {
        let of = |row: usize| [residuals[row].norm(), rows.get(row).uncertainty_mm];
        FileResiduals {
            file: observation.file.clone(),
            rows: own.map(|row| of(row).map(|mm| 1e3 * mm)).collect(),
        }
    });
    files.collect()
}

/// Size of residuals: for `points` and `sphere` the distance in space, otherwise the residual
/// itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Figures {
    /// Root mean square, µm.
    #[cfg_attr(feature = "serde", serde(rename = "rms"))]
    pub rms_um: f64,
    /// Largest residual of the rows, µm.
    #[cfg_attr(feature = "serde", serde(rename = "max"))]
    pub max_um: f64,
    /// Number of rows.
    pub rows: usize,
}

fn figures(residuals: &[Vector3<f64>]) -> Figures {
    let squares: f64 = residuals.iter().map(Vector3::norm_squared).sum();
    let largest = residuals.iter().map(Vector3::norm).fold(0.0, f64::max);
    Figures {
        rms_um: 1e3 * (squares / residuals.len().max(1) as f64).sqrt(),
        max_um: 1e3 * largest,
        rows: residuals.len(),
    }
}

/// Cross-validation fold of each row. Rows of one pose share a fold; poses are assigned in an order shuffled with a fixed seed. `None` without
/// folds, or with fewer poses than folds, because a fold without a pose would validate nothing.
fn parts(rows: &Rows, count: usize) -> Option<Vec<usize>> {
    if count == 0 {
        return None;
    }
    let (pose_of, poses) = rows.poses();
    if poses < count {
        return None;
    }
    let mut order: Vec<usize> = (0..poses).collect();
    let mut random = ChaCha8Rng::seed_from_u64(0x766f_6c63);
    for last in (1..order.len()).rev() {
        let drawn = random.next_u64() % (last as u64 + 1);
        order.swap(last, usize::try_from(drawn).unwrap_or(last));
    }
    let mut part = vec![0; poses];
    for (place, pose) in order.into_iter().enumerate() {
        part[pose] = place % count;
    }
    Some(pose_of.into_iter().map(|pose| part[pose]).collect())
}

/// Residuals of rows omitted from the fit (cross-validation).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeftOut {
    /// Size of the residuals.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub figures: Figures,
    /// Number of parts in which the poses were omitted.
    pub folds: usize,
}

/// Cross-validates the fit: the poses of every fold are predicted from an identification of all other folds, including
/// the choice of penalties. Returns a note instead of residuals if there are fewer poses than folds, or if without some
/// of the poses the others do not determine the unknowns or the fit does not converge. Returns neither if `folds` is
/// below 2.
pub(crate) fn left_out(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    (start, fitted): (&Values, &Fitted),
    mut done: impl FnMut(usize),
) -> Result<(Option<LeftOut>, Option<Note>), IdentifyError> {
    let folds = observations.folds;
    if folds < 2 {
        return Ok((None, None));
    }
    let none =
        |why: String| Ok((None, Some(Note::info("", format!("no cross-validation: {why}")))));
    let Some(parts) = parts(rows, folds) else {
        return none(format!(
            "{} poses cannot be split into {folds} parts (`folds`)",
            rows.poses().1
        ));
    };
    let mut residuals = Vec::new();
    let factorised = Folds::new(system, rows, fitted);
    for fold in 0..folds {
        let is_left = |row: usize| parts[row] == fold;
        if let Some(own) = factorised.as_ref().and_then(|of| of.left_out(is_left)) {
            residuals.extend(own);
            done(fold + 1);
            continue;
        }
        let others = rows.only(|row| parts[row] != fold);
        let left = rows.only(|row| parts[row] == fold);
        let fitted = match fit(system, observations, &others, start.clone()) {
            Ok(fitted) => fitted,
            Err(IdentifyError::TooFew { .. } | IdentifyError::NotConverged { .. }) => {
                return none(
                    "without some of the poses, the others do not determine the unknowns"
                        .to_owned(),
                );
            }
            Err(error) => return Err(error),
        };
        residuals.extend(system.residuals(&left, &fitted.solution.values));
        done(fold + 1);
    }
    let figures = figures(&residuals);
    Ok((Some(LeftOut { figures, folds }), None))
}

#[derive(Default)]
pub(crate) struct JudgedNotes {
    pub(crate) files: Vec<Note>,
    /// Notes on single rows that are outliers in their file.
    pub(crate) rows: Vec<Note>,
}

/// Residuals of rows that are predicted but not fitted. Adds warnings about outlying rows of a file, and about files
/// with larger residuals than the fitted rows.
pub(crate) fn judged(
    system: &System,
    observations: &Observations,
    values: &Values,
    fitted: Figures,
) -> (Option<Figures>, JudgedNotes) {
    const MAX_LISTED: usize = 5;
    const TIMES_FITTED: f64 = 3.0;
    const TIMES_USUAL: f64 = 10.0;
    let mut notes = JudgedNotes::default();
    let mut all = Vec::new();
    for observation in observations.observations.iter().filter(|o| o.judge) {
        let rows = system.prepare(observation.rows.iter());
        let residuals = system.residuals(&rows, values);
        let sizes: Vec<f64> = residuals.iter().map(Vector3::norm).collect();
        let usual = median(&sizes);
        let stated = observation.rows.iter().map(|row| row.uncertainty_mm);
        let expected = (1e-3 * fitted.rms_um).max(stated.fold(0.0, f64::max));
        if usual > TIMES_FITTED * expected {
            let what = format!(
                "its judged rows are {:.1} µm (median) from the identified machine, the fitted ones {:.1} µm RMS: are they from the same machine and set-up?",
                1e3 * usual,
                fitted.rms_um
            );
            notes.files.push(Note::warning(observation.file.as_str(), what));
        }
        let rows = observation.rows.iter().zip(&sizes);
        let far = rows.filter(|(row, size)| **size > TIMES_USUAL * usual.max(row.uncertainty_mm));
        notes.rows.extend(far.take(MAX_LISTED).map(|(row, size)| {
            let what = format!(
                "this judged row is {:.1} µm from the identified machine, the others {:.1} µm (median): is it an outlier?",
                1e3 * size,
                1e3 * usual
            );
            Note::warning(at(&observation.file, row.line), what)
        }));
        all.extend(residuals);
    }
    ((!all.is_empty()).then(|| figures(&all)), notes)
}

/// Returns the machine of the observations with `values` for the unknown errors, as parameter names and values in
/// parameter units. Unknowns without a value are 0.
///
/// # Errors
/// Unknowns that [`crate::identify()`] rejects; a name that is neither an unknown nor part of the set-up.
pub fn machine_with(
    observations: &Observations,
    values: &[(String, f64)],
) -> Result<Machine, IdentifyError> {
    let system = System::new(observations)?;
    let mut names = (0..system.params.len()).map(|param| system.name(param));
    for (name, _) in values {
        if !names.clone().any(|known| known == *name) {
            let known: Vec<String> = names.by_ref().collect();
            return Err(IdentifyError::NoSuchUnknown {
                found: name.clone(),
                known: known.join(", "),
            });
        }
    }
    let given = system.unknowns.coefficients.iter().map(|coefficient| {
        let value = values.iter().find(|(name, _)| *name == coefficient.name);
        value.map_or(0.0, |(_, value)| value / micro(coefficient.error.component))
    });
    let stated = Values::stated(&system.setup, given.collect());
    machine_of(&system, &stated)
}

fn machine_of(system: &System, values: &Values) -> Result<Machine, IdentifyError> {
    let mut machine = system.machine.clone();
    for (place, unknown) in system.unknowns.curves.iter().enumerate() {
        let error = unknown.error;
        let scale = micro(error.component);
        let own = system.unknowns.coefficients.iter().zip(&values.coefficients);
        let own = own.filter(|(coefficient, _)| coefficient.curve == place);
        let mut modes = vec![0.0; unknown.modes.as_ref().map_or(0, crate::basis::Modes::len)];
        let mut products = vec![0.0; unknown.products.as_ref().map_or(0, |p| p.pairs().len())];
        let mut reversal = None;
        for (coefficient, value) in own {
            match coefficient.role {
                Role::Location => machine.set_location(error, value * scale)?,
                Role::Mode(mode) => modes[mode] = value * scale,
                Role::Product(place) => products[place] = value * scale,
                Role::Reversal => reversal = Some(value * scale),
            }
        }
        if unknown.error.location {
            continue;
        }
        let before = machine.error(error).cloned();
        let mean = match &unknown.modes {
            Some(own) => {
                let field = match &unknown.products {
                    Some(found) => {
                        let go_round = [unknown.axis, found.axis()]
                            .map(|axis| machine.axes()[axis].modulo.is_some());
                        found
                            .grid(own, unknown.axis, [&modes, &products], go_round)
                            .map(Field::Grid)
                    }
                    None => own.curve(&modes).map(Field::Curve),
                };
                field.map_err(|source| IdentifyError::Curve { error, source })?
            }
            None => match &before {
                Some(ErrorCurve::Single(mean) | ErrorCurve::Reversal { mean, .. }) => mean.clone(),
                _ => Field::Curve(volcomp_curve::Curve::Constant(0.0)),
            },
        };
        // A reversal value that is not an unknown is kept.
        let reversal = reversal.or(match before {
            Some(ErrorCurve::Reversal { reversal, .. }) => Some(reversal),
            _ => None,
        });
        let curve = match reversal {
            Some(reversal) => ErrorCurve::with_reversal(mean, reversal)
                .map_err(|source| IdentifyError::Curve { error, source })?,
            None => ErrorCurve::Single(mean),
        };
        machine.set_error(error, curve)?;
    }
    Ok(machine)
}

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
