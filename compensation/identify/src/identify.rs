//! From observations to a machine, in steps: set-up, rank, errors, judgement.

use std::collections::BTreeSet;

use volcomp_curve::{ErrorCurve, Field};
use volcomp_kinematics::nalgebra::{DMatrix, Vector3};
use volcomp_model::Machine;
use volcomp_vocabulary::ErrorName;

use crate::{
    coefficients::{Role, micro},
    design::design,
    doubts::{contradiction, small_moves},
    error::IdentifyError,
    followers::Follower,
    judge::{Figures, figures, judged, left_out, outliers},
    kept_curves::kept_curves,
    mistaken::mistaken,
    next::{Next, next},
    observations::{Observations, Row, Seen},
    order::{absurd_jump, in_order},
    params::{Param, Part},
    plausible::plausible,
    prepared::Rows,
    rank::{Rank, independent},
    response::Response,
    solve::{Exactness, Solution, solve},
    span::Span,
    start::start,
    system::System,
    thin::{large, thin},
    values::{Values, six_of},
};

/// What was found of one unknown.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// The name: `EX0C`, `EXX legendre 2`, `tracker.csv:frame.x`.
    pub name: String,
    /// The error that it belongs to; `None` for a number of a set-up.
    pub error: Option<ErrorName>,
    /// The value in `unit`; 0 where it is not determined.
    pub value: f64,
    /// `um`, `urad`, `mm`, `deg` or `um_per_m`.
    pub unit: &'static str,
    /// The standard uncertainty (k = 1) in `unit`; `None` where it is not determined.
    pub uncertainty: Option<f64>,
    /// Whether the observations determine it.
    pub determined: bool,
    /// The unknowns left at zero with which it is mixed up: its value holds if these are zero.
    pub given_zero: Vec<String>,
}

/// What was found, and how far it can be trusted.
#[derive(Clone, Debug)]
pub struct Identification {
    /// The machine with the errors that were found.
    pub machine: Machine,
    /// Every unknown: set-ups first, then the errors.
    pub parameters: Vec<Parameter>,
    /// The covariance of the determined parameters in their order, in the products of their units. It follows from the stated
    /// uncertainties alone: where the unknowns do not describe the machine, `variance` is above 1 and a warning says so. With
    /// penalties and with robust weights it follows from what is left.
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
    pub null: Vec<Vec<(String, f64)>>,
    /// What is left of the fitted rows.
    pub residual: Figures,
    /// What is left of rows that were left out of the fit, and in how many parts.
    pub left_out: Option<(Figures, usize)>,
    /// What is left of the rows that are only predicted.
    pub judged: Option<Figures>,
    /// The variance of the residuals in units of the stated one.
    pub variance: f64,
    /// The effective number of unknowns.
    pub degrees: f64,
    /// The pose that would help most.
    pub next: Option<Next>,
    /// Messages that a person should read.
    pub warnings: Vec<String>,
}

/// A fit to some rows.
pub(crate) struct Fitted {
    pub(crate) solution: Solution,
    pub(crate) rank: Rank,
}

/// Finds the unknowns of the observations. `progress` is told how many of how many fits are done.
///
/// # Errors
/// * Observations that no file could state: [`IdentifyError::Unusable`], [`IdentifyError::NoSuchPlace`].
/// * No rows, too few or all alike; a frame that cannot be found; a search that does not end.
/// * Rows that no machine like the nominal one can have given: [`IdentifyError::FarRow`], [`IdentifyError::FarRows`], and
///   [`IdentifyError::Jump`] where something was shifted between two rows.
/// * A curve that cannot be built from what was found: [`IdentifyError::Curve`].
pub fn identify(
    observations: &Observations,
    progress: impl FnMut(usize, usize),
) -> Result<Identification, IdentifyError> {
    identify_followed(observations, &[], progress).map(|(found, _)| found)
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
    let system = System::new(observations)?.followed_by(followers)?;
    let rows = system.prepare(observations.fitted().flat_map(|(o, _)| &o.rows));
    check(&system, &rows)?;
    let fits = 1 + observations.folds;
    progress(0, fits);
    let values = start(&system, observations, &rows)?;
    let far = plausible(&system, observations, &rows, &values);
    refuse_jump(&system, observations, &rows, &values, far)?;
    let fitted = fit(&system, observations, &rows, values.clone())?;
    refuse_target(&system, &rows, &fitted.rank)?;
    progress(1, fits);
    let machine = machine_of(&system, &fitted.solution.values)?;
    let residuals = system.residuals(&rows, &fitted.solution.values);
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
    // First what makes the answer wrong, then what makes it uncertain, last what stands at every run.
    let mut warnings = mistaken(&system, observations, &rows, &fitted);
    warnings.extend(kept_curves(&system, observations, &rows, &fitted));
    warnings.extend(in_order(&system, observations, &rows, &fitted));
    warnings.extend(contradiction(observations, &rows, &residuals, &fitted));
    warnings.extend(outliers(observations, &rows, &residuals));
    warnings.extend(of_judged);
    warnings.extend(large(&system, &fitted));
    warnings.extend(thin(&system, observations, &rows, &fitted));
    warnings.extend(observations.notes.iter().cloned());
    warnings.extend(observations.guessed_turns());
    warnings.extend(small_moves(&system.machine, &rows));
    warnings.extend(why_not);
    warnings.extend(left_at_zero(&system, &fitted.rank, &null));
    let found = Identification {
        covariance: covariance_in_units(&system, &fitted),
        rank: fitted.rank.kept.len(),
        score: fitted.rank.score(),
        score_of_determined: fitted.rank.score_of_kept(),
        redundant: redundant(&system, &fitted.rank),
        residual: figures(&residuals),
        judged,
        left_out,
        variance: fitted.solution.variance,
        degrees: fitted.solution.degrees,
        next: next(&system, observations, &rows, &fitted),
        machine,
        parameters,
        null,
        warnings,
    };
    let response = Response::new(&system, observations, followers, &fitted);
    Ok((found, response))
}

/// The machine of the observations with values of their unknown errors, by the names and in the units of the parameters; 0 where
/// none is given.
///
/// # Errors
/// What [`identify`] refuses of unknowns; a name that is none of the unknowns or of the set-up.
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

/// The names of the unknowns that are left at zero and are conventions: constants of curves and slopes of straightnesses.
fn redundant(system: &System, rank: &Rank) -> Vec<String> {
    let left = rank.left_at_zero();
    left.filter(|column| system.is_convention(*column) == Some(true))
        .map(|column| system.name(column))
        .collect()
}

/// Fits rows from a start of the set-ups.
pub(crate) fn fit(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: Values,
) -> Result<Fitted, IdentifyError> {
    let design = design(system, rows, &values);
    let rank = independent(&design.jacobian);
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
    // What is left at zero begins there.
    let mut values = values;
    for null in &rank.null {
        if let Param::Coefficient(coefficient) = system.params.at(null[0].0) {
            values.coefficients[coefficient] = 0.0;
        }
    }
    let is_penalised = rank
        .kept
        .iter()
        .any(|&column| system.group(column).is_some());
    let solution = solve(
        system,
        rows,
        values,
        &rank.kept,
        observations.robust,
        is_penalised,
        Exactness::Full,
    )?;
    Ok(Fitted { solution, rank })
}

/// Refuses rows that are far away, and rows of which some are shifted beside others: a shift is the better reason where no other
/// cause is known.
fn refuse_jump(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: &Values,
    far: Result<(), IdentifyError>,
) -> Result<(), IdentifyError> {
    /// No row is further from the others where the shift is at most a millimetre (of usual machine tools).
    const NEAR_MM: f64 = 0.25;
    let is_without_cause = match &far {
        Ok(()) => {
            let near_mm = Span::of(&system.machine, rows.iter()).limit_mm(NEAR_MM);
            let residuals = system.residuals(rows, values);
            residuals.iter().any(|residual| residual.norm() > near_mm)
        }
        Err(IdentifyError::FarRows { files }) => files.iter().all(|file| file.causes.is_empty()),
        Err(_) => false,
    };
    if is_without_cause && let Some(jump) = absurd_jump(system, observations, rows, values) {
        return Err(IdentifyError::Jump {
            why: jump.why(),
            file: jump.file,
            line: jump.line,
            found_mm: jump.size_mm,
        });
    }
    far
}

/// Refuses a target whose place nothing determines where tilts are found: they act over its lever, so that the machine
/// found would be right at the target and wrong at the tip.
fn refuse_target(system: &System, rows: &Rows, rank: &Rank) -> Result<(), IdentifyError> {
    /// A share in a combination that is smaller moves it by little.
    const SHARE: f64 = 1e-3;
    let has_tilt = rank
        .kept
        .iter()
        .any(|&param| match system.params.at(param) {
            Param::Coefficient(place) => {
                let error = system.unknowns.coefficients[place].error;
                !error.location
                    && error.component.is_angular()
                    && !system.unknowns.is_convention(place)
            }
            Param::SetUp { .. } => false,
        });
    let targets: BTreeSet<usize> = rows
        .iter()
        .filter_map(|row| match row.seen {
            Seen::Point { target, .. } => target,
            _ => None,
        })
        .collect();
    let is_target = |param: usize| {
        matches!(system.params.at(param), Param::SetUp { part: Part::Point(place), order: 0, .. }
            if targets.contains(&place))
    };
    // Where an error is left at zero, the target is known within the size of errors.
    let is_open = |null: &&Vec<(usize, f64)>| has_tilt && null[0].0 < system.params.setup();
    for null in rank.null.iter().filter(is_open) {
        let target = (null.iter()).find(|(param, share)| is_target(*param) && share.abs() > SHARE);
        if let Some(&(target, _)) = target {
            let others = null.iter().filter(|(param, _)| *param != target);
            let others: Vec<String> = others
                .map(|(param, _)| system.name(*param))
                .take(4)
                .collect();
            return Err(IdentifyError::Target {
                target: system.name(target),
                with: others.join(", "),
            });
        }
    }
    Ok(())
}

/// Refuses rows from which nothing can be found.
fn check(system: &System, rows: &Rows) -> Result<(), IdentifyError> {
    if rows.len() == 0 {
        return Err(IdentifyError::NothingToFit);
    }
    let is_pair = |row: &Row| matches!(row.seen, Seen::Pair { .. });
    let asks_for_errors = system.params.setup() < system.params.len();
    if rows.poses().1 == 1 && !rows.iter().any(is_pair) && asks_for_errors {
        return Err(IdentifyError::AllAlike { rows: rows.len() });
    }
    Ok(())
}

/// The machine with the errors of these values.
pub(crate) fn machine_of(system: &System, values: &Values) -> Result<Machine, IdentifyError> {
    let mut machine = system.machine.clone();
    for (place, unknown) in system.unknowns.curves.iter().enumerate() {
        let error = unknown.error;
        let scale = micro(error.component);
        let own = system
            .unknowns
            .coefficients
            .iter()
            .zip(&values.coefficients);
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
        // A reversal value that was not asked for stays.
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

/// The derivatives of the parameters as they are told by those of the search: diagonal but for frames, whose search
/// moves them about their middle.
pub(crate) fn told_by_searched(system: &System, fitted: &Fitted) -> DMatrix<f64> {
    let count = fitted.rank.kept.len();
    let mut told = DMatrix::zeros(count, count);
    for (row, &param) in fitted.rank.kept.iter().enumerate() {
        let (_, scale) = system.unit_of(param);
        let Some((frame, place)) = of_frame(system.params.at(param)) else {
            told[(row, row)] = scale;
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
            told[(row, column)] = if place < 3 {
                (shift + turn.cross(&arm))[place]
            } else {
                // ω = (R_z R_y e_x) da + (R_z e_y) db + e_z dc, solved for the rates of the angles.
                let (sb, cb) = six[4].sin_cos();
                let (sc, cc) = six[5].sin_cos();
                let along = cc * turn.x + sc * turn.y;
                let cosine = if cb.abs() < 1e-9 { 1e-9 } else { cb };
                let rates = [
                    along / cosine,
                    cc * turn.y - sc * turn.x,
                    turn.z + along * sb / cosine,
                ];
                rates[place - 3] * scale
            };
        }
    }
    told
}

/// Which frame a number that does not drift belongs to, and which of its six it is.
fn of_frame(param: Param) -> Option<(usize, usize)> {
    match param {
        Param::SetUp {
            part: Part::Frame(frame),
            place,
            order: 0,
        } => Some((frame, place)),
        _ => None,
    }
}

fn covariance_in_units(system: &System, fitted: &Fitted) -> DMatrix<f64> {
    let told = told_by_searched(system, fitted);
    &told * &fitted.solution.covariance * told.transpose()
}

fn parameters(system: &System, fitted: &Fitted) -> Vec<Parameter> {
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

/// Notes on what cannot be told apart: one for each unknown that more observations could tell, one for all that are conventions.
fn left_at_zero(system: &System, rank: &Rank, null: &[Vec<(String, f64)>]) -> Vec<String> {
    let is_convention = |place: &usize| {
        let left = rank.null[*place][0].0;
        system.is_convention(left) == Some(true)
    };
    let (conventions, missing): (Vec<usize>, Vec<usize>) = (0..null.len()).partition(is_convention);
    let is_setup = |place: usize| rank.null[place][0].0 < system.params.setup();
    let words = |place: &usize| null_in_words(&null[*place], is_setup(*place));
    let mut notes: Vec<String> = missing.iter().map(words).collect();
    match &conventions[..] {
        [] => {}
        [one] => notes.push(words(one)),
        several => {
            let names: Vec<&str> = several
                .iter()
                .map(|place| null[*place][0].0.as_str())
                .collect();
            notes.push(format!(
                "left at zero by convention, since they move the tool like location errors, other constants or the set-up: {}",
                names.join(", ")
            ));
        }
    }
    notes
}

/// A combination that moves nothing, in words.
fn null_in_words(null: &[(String, f64)], is_setup: bool) -> String {
    const SHOWN: usize = 4;
    let (left, others) = (&null[0].0, &null[1..]);
    let where_left = if is_setup {
        "as it was at the start"
    } else {
        "at zero"
    };
    if others.is_empty() {
        return format!("{left} moves nothing in these observations: it is left {where_left}");
    }
    let mut names: Vec<&str> = others.iter().map(|(name, _)| name.as_str()).collect();
    let more = names.len().saturating_sub(SHOWN);
    names.truncate(SHOWN);
    let mut with = names.join(", ");
    if more > 0 {
        with = format!("{with} and {more} more");
    }
    format!("{left} cannot be told apart from {with}: it is left {where_left}")
}
