//! From observations to a machine, in steps: set-up, rank, errors, judgement.

use std::collections::BTreeSet;

use volcomp_document::Note;
use volcomp_kinematics::nalgebra::DMatrix;
use volcomp_model::Machine;
use volcomp_vocabulary::ErrorName;

use crate::{
    checks::{
        contradiction, few, inches, inverted, large, outliers, refuse_far, refuse_rows,
        refuse_target, refuse_unexplained, small_moves, times_by_file,
    },
    design::design,
    error::IdentifyError,
    followers::Follower,
    found_machine::machine_of,
    judge::{Figures, LeftOut, figures, judged, left_out},
    left_open::{LeftOpen, left_at_zero, left_open, redundant},
    next::{Next, next},
    observations::Observations,
    parameters::{Parameter, covariance_in_units, parameters},
    params::Param,
    prepared::Rows,
    rank::Rank,
    response::Response,
    sides::told_apart,
    solve::{Exactness, Solution, solve},
    start::start,
    system::System,
    uncertain::Uncertain,
    values::Values,
};

/// What was found, and how far it can be trusted.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Identification {
    /// The machine with the errors that were found.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub machine: Machine,
    /// Every unknown: set-ups first, then the errors.
    pub parameters: Vec<Parameter>,
    /// The covariance of the determined parameters in their order, in the products of their units. It follows from the stated
    /// uncertainties alone: where the unknowns do not describe the machine, `variance` is above 1 and a warning says so. With
    /// penalties and with robust weights it follows from what is left.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub covariance: DMatrix<f64>,
    /// How many combinations of the unknowns the observations determine.
    pub rank: usize,
    /// σ_min/σ_max of the columns scaled to unit length; 0 where the rank is not full.
    pub score: f64,
    /// The same of the unknowns that are determined alone.
    pub score_of_determined: f64,
    /// Unknowns that are left at zero though nothing is missing: the constants that curves bring, and the slopes of
    /// straightnesses, as far as location errors, other constants or the set-up move the tool alike. They are conventions.
    pub redundant: Vec<String>,
    /// Every combination that moves nothing: names and weights, the one that was left at zero first.
    #[cfg_attr(feature = "serde", serde(serialize_with = "as_maps"))]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "Vec<std::collections::BTreeMap<String, f64>>")
    )]
    pub null: Vec<Vec<(String, f64)>>,
    /// The errors that the observations leave open though they are no convention.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub left_open: Vec<LeftOpen>,
    /// What is left of the fitted rows.
    #[cfg_attr(feature = "serde", serde(rename = "residual_um"))]
    pub residual: Figures,
    /// What is left of rows that were left out of the fit; `None`: not judged.
    #[cfg_attr(feature = "serde", serde(rename = "left_out_um"))]
    pub left_out: Option<LeftOut>,
    /// What is left of the rows of observations with `judge = true`; `None` where there are none.
    #[cfg_attr(
        feature = "serde",
        serde(rename = "judged_um", skip_serializing_if = "Option::is_none")
    )]
    pub judged: Option<Figures>,
    /// The variance of the residuals in units of the stated one.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub variance: f64,
    /// How many times larger the uncertainties are than the covariance says, by what is left of the rows; 1 where chance explains that, or where
    /// the covariance counts it already.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub excess: f64,
    /// Whether a file, or the rows that were only predicted, contradict what was found.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub is_contradicted: bool,
    /// The effective number of unknowns; with penalties smaller than the rank.
    #[cfg_attr(feature = "serde", serde(rename = "effective"))]
    pub degrees: f64,
    /// The pose that would help most; `None` where nothing is uncertain.
    pub next: Option<Next>,
    /// What could mislead, and what was assumed or not used.
    pub warnings: Vec<Note>,
}

/// More than so many times the stated uncertainty is left of observations by unknowns that do not describe the machine.
const NOT_DESCRIBED: f64 = 3.0;

impl Identification {
    /// The errors that the observations do not bear out: those that they leave open, those that hold only if one of these is zero, and all where what
    /// is left of the observations, or of a file of them, is more than three times their stated uncertainty, or rows that were only predicted are far off.
    pub fn undecided(&self) -> BTreeSet<ErrorName> {
        let is_described = self.variance <= NOT_DESCRIBED.powi(2) && !self.is_contradicted;
        let is_open = |of: &Parameter| !of.determined && !self.redundant.contains(&of.name);
        let errors = self.parameters.iter().filter(|of| of.error.is_some());
        let open: Vec<&str> = (errors.clone().filter(|of| is_open(of)))
            .map(|of| of.name.as_str())
            .collect();
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

/// A fit to some rows.
pub(crate) struct Fitted {
    pub(crate) solution: Solution,
    pub(crate) rank: Rank,
    /// Of what the rank leaves out that of which only the noise leaves nothing known.
    pub(crate) uncertain: Vec<Uncertain>,
}

/// Finds the unknowns of the observations. `progress` is told how many of how many fits are done.
///
/// # Errors
/// * Observations that no file could state: [`IdentifyError::Unusable`], [`IdentifyError::NoSuchPlace`].
/// * No rows, too few or all alike; a frame that cannot be found; a search that does not end.
/// * Rows that no machine like the nominal one can have given: [`IdentifyError::FarRows`], and
///   [`IdentifyError::Unexplained`] where what is left after the fit is more than machines miss.
/// * A curve that cannot be built from what was found: [`IdentifyError::Curve`].
pub fn identify(
    observations: &Observations,
    mut progress: impl FnMut(usize, usize),
) -> Result<Identification, IdentifyError> {
    followed(observations, &[], &mut progress).map(|(found, _)| found)
}

/// The same where other errors of the machine follow the unknowns: these are found by the residuals with all that follows
/// them, and so is their covariance. With it comes how what was found follows the errors that were taken for known.
///
/// The machine that is found has the other errors as the observations had them.
///
/// # Errors
/// As [`identify`].
pub fn identify_followed(
    observations: &Observations,
    followers: &[Follower],
    mut progress: impl FnMut(usize, usize),
) -> Result<(Identification, Response), IdentifyError> {
    followed(observations, followers, &mut progress)
}

/// Compiled once, and not for each closure that is told the progress.
fn followed(
    observations: &Observations,
    followers: &[Follower],
    progress: &mut dyn FnMut(usize, usize),
) -> Result<(Identification, Response), IdentifyError> {
    let system = System::new(observations)?.followed_by(followers)?;
    let rows = system.prepare(observations.fitted().flat_map(|(o, _)| &o.rows));
    refuse_rows(&system, &rows)?;
    let fits = 1 + observations.folds;
    progress(0, fits);
    let values = start(&system, observations, &rows)?;
    refuse_far(&system, observations, &rows, &values)?;
    let fitted = fit(&system, observations, &rows, values.clone())?;
    refuse_target(&system, &rows, &fitted.rank)?;
    progress(1, fits);
    let machine = machine_of(&system, &fitted.solution.values)?;
    let residuals = system.residuals(&rows, &fitted.solution.values);
    refuse_unexplained(&system, observations, &rows, &residuals)?;
    let (left_out, why_not) = left_out(&system, observations, &rows, &values, |done| {
        progress(1 + done, fits);
    })?;
    let (judged, of_judged) = judged(
        &system,
        observations,
        &fitted.solution.values,
        figures(&residuals),
    );
    let parameters = parameters(&system, &fitted);
    let names =
        |null: &Vec<(usize, f64)>| null.iter().map(|(c, w)| (system.name(*c), *w)).collect();
    let null: Vec<Vec<(String, f64)>> = fitted.rank.null.iter().map(names).collect();
    let warning = |text: &String| Note::warning("", text.as_str());
    // First what makes the answer wrong, then what makes it uncertain, last what stands at every run.
    let mut warnings = inverted(&system, observations, &rows, &fitted);
    warnings.extend(inches(&system, observations, &fitted));
    warnings.extend(contradiction(observations, &rows, &residuals, &fitted));
    warnings.extend(outliers(observations, &rows, &residuals));
    let is_contradicted = !of_judged.files.is_empty()
        || !fitted.solution.counts_residuals
            && (times_by_file(observations, &rows, &residuals).iter())
                .any(|(times, _)| *times > NOT_DESCRIBED);
    warnings.extend(of_judged.files);
    warnings.extend(of_judged.rows);
    warnings.extend(large(&system, &fitted));
    warnings.extend(few(&rows, &fitted));
    warnings.extend(
        observations
            .notes
            .iter()
            .map(|text| Note::info("", text.as_str())),
    );
    warnings.extend(observations.guessed_turns().iter().map(warning));
    warnings.extend(small_moves(&system.machine, &rows));
    warnings.extend(why_not);
    warnings.extend(left_at_zero(&system, &fitted, &null).iter().map(warning));
    let mut found = Identification {
        covariance: covariance_in_units(&system, &fitted),
        rank: fitted.rank.kept.len(),
        score: fitted.rank.score(),
        score_of_determined: fitted.rank.score_of_kept(),
        redundant: redundant(&system, &fitted.rank),
        left_open: left_open(&system, &fitted.rank),
        residual: figures(&residuals),
        judged,
        left_out,
        variance: fitted.solution.variance,
        excess: fitted.solution.excess_of_covariance(),
        is_contradicted,
        degrees: fitted.solution.degrees,
        next: next(&system, observations, &rows, &fitted),
        machine,
        parameters,
        null,
        warnings,
    };
    found.machine.leave_undecided(found.undecided());
    let response = Response::new(&system, observations, followers, &fitted);
    Ok((found, response))
}

/// Fits rows from a start of the set-ups.
pub(crate) fn fit(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: Values,
) -> Result<Fitted, IdentifyError> {
    let design = design(system, rows, &values);
    let rank = told_apart(system, &design, &[]);
    if rank.kept.len() > design.jacobian.nrows()
        || (rank.kept.len() == design.jacobian.nrows() && !rank.null.is_empty())
    {
        return Err(IdentifyError::TooFew {
            poses: rows.poses().1,
            numbers: design.jacobian.nrows(),
            unknowns: system.params.len(),
            rank: rank.kept.len(),
        });
    }
    let mut values = values;
    let is_penalised =
        |rank: &Rank| (rank.kept.iter()).any(|&column| system.group(column).is_some());
    let mut rank = rank;
    let mut uncertain: Vec<Uncertain> = Vec::new();
    // A penalty says how large an unknown may be: beside it noise leaves nothing open.
    if !is_penalised(&rank) {
        let jacobian = system.equations(rows, &values).jacobian;
        while let Some(one) = Uncertain::among(system, &rank.kept, &jacobian) {
            uncertain.push(one);
            let without: Vec<usize> = uncertain.iter().map(|of| of.param).collect();
            rank = told_apart(system, &design, &without);
        }
    }
    // What is left at zero begins there.
    for left in rank.left_at_zero() {
        if let Param::Coefficient(coefficient) = system.params.at(left) {
            values.coefficients[coefficient] = 0.0;
        }
    }
    let solution = solve(
        system,
        rows,
        values,
        &rank.kept,
        observations.robust,
        is_penalised(&rank),
        Exactness::Full,
    )?;
    Ok(Fitted {
        solution,
        rank,
        uncertain,
    })
}
