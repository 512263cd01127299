//! The last stage of a calibration: unknown errors are identified from observations of the whole machine.
//!
//! Two steps alternate until both converge: the unknowns are identified with the measured errors held, and the measured
//! errors are fitted again without the contributions of the unknowns. If the lines depend so strongly on the unknowns
//! that the alternation converges slowly or not at all, unknowns and measured errors are solved together.

use volcomp_document::Note;
use volcomp_identify::{Follower, Identification, Observations, Parameter, identify_followed};
use volcomp_model::Machine;
use volcomp_vocabulary::{Displacement, ErrorName, Um, Urad};

use crate::branches::{FittedCurve, FittedLine};
use crate::calibration_file::CalibrationFile;
use crate::checks::Stated;
use crate::error::CalibrateError;
use crate::line_contribution::{CHANGE, LineContribution, changed, take};
use crate::stages::Stages;

/// Convergence limit on the change of any parameter, as a fraction of its standard uncertainty.
const SETTLED: f64 = 0.01;
/// Lower bound of the standard uncertainty to which `SETTLED` refers, in the unit of the parameter.
const LEAST: f64 = 1e-6;
const ROUNDS: usize = 60;
/// Ratio of successive changes above which unknowns and lines are solved together instead of alternately.
const TOGETHER_ABOVE: f64 = 0.9;

/// Errors identified from volumetric observations.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Identified {
    /// Identified parameters, with uncertainties, rank and residuals.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub found: Identification,
    /// Number of rounds of identification and fitting until convergence.
    pub rounds: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scope {
    Machine,
    Everything,
}

pub(crate) fn settled(
    file: &CalibrationFile,
    observations: &Observations,
    mut known: Machine,
    mut stages: Stages,
    wanted: Scope,
) -> Result<(Identified, Stages, Vec<String>), CalibrateError> {
    let on = |machine: &Machine, followers: &[Follower], folds: usize| {
        let mut observations = observations.clone();
        observations.machine = machine.clone();
        let lines = file.measurements.iter();
        observations.measured = lines.map(|line| line.setup.error).collect();
        observations.folds = folds;
        identify_followed(&observations, followers, |_, _| {})
    };
    let mut notes = Vec::new();
    let mut followers: Vec<Follower> = Vec::new();
    let mut before: Option<Vec<Parameter>> = None;
    let mut rounds = 0;
    let mut last_moved = None;
    loop {
        rounds += 1;
        let found = on(&stages.machine, &followers, 0);
        let (found, _) = found?;
        let moved = before.as_ref().map(|before| moved(before, &found.parameters));
        // As long as the changes exceed rounding errors, the change of each round is a constant fraction of the
        // previous one.
        let share = match (last_moved, moved) {
            (Some(before), Some(moved)) if moved > SETTLED => moved / before,
            _ => 0.0,
        };
        last_moved = moved;
        for unknown in &observations.unknown {
            take(&mut known, &found.machine, unknown.error)?;
        }
        let again = Stages::of(file, &known, || ())?;
        let is_same = again.is_as_measured(&stages);
        if is_same || moved.is_some_and(|moved| moved < SETTLED) {
            break;
        }
        stages = again;
        if rounds == ROUNDS {
            return Err(CalibrateError::NotSettled { rounds, moved: moved.unwrap_or_default() });
        }
        if followers.is_empty() && share > TOGETHER_ABOVE {
            followers = following(file, observations, (&known, &stages), &found.parameters)?;
        }
        for follower in &mut followers {
            let own = |parameter: &&Parameter| parameter.name == follower.parameter();
            let value = found.parameters.iter().find(own).map(|own| own.value);
            *follower = follower.clone().with_value(value.unwrap_or_default());
        }
        before = Some(found.parameters);
    }
    if !followers.is_empty() {
        notes.push(format!(
            "the lines contain the unknowns: they were found together in {rounds} rounds"
        ));
    } else if rounds > 1 {
        notes.push(format!(
            "the unknowns were identified {rounds} times, each time with the lines cleared of what was found before, until they settled"
        ));
    }
    let single = file.files_without_scatter();
    if !single.is_empty() && wanted == Scope::Everything {
        notes.push(format!(
            "the uncertainties of the unknowns do not count the noise of {}: one run only in each direction shows none. Take two runs or more, or state reading_um or reading_urad in [uncertainty]",
            single.join(", ")
        ));
    }
    let (mut found, response) = on(&stages.machine, &followers, observations.folds)?;
    if wanted == Scope::Everything {
        let lines = LineContribution {
            file,
            observations,
            known: &known,
            response: &response,
            // There is no feedback between rounds if the equations include the response of the lines, or if the lines do not
            // depend on the unknowns.
            carries: followers.is_empty() && rounds > 1,
        };
        // Stated values are checked first, because a wrong value makes correct rows appear wrong.
        let contradicted = contradicted_values(&lines)?;
        let errors = contradicted.iter().map(|(error, _)| *error);
        found.machine.leave_undecided(errors);
        let notes = contradicted.into_iter().map(|(_, note)| note);
        found.warnings.splice(0..0, notes);
        lines.add_to(&mut found, &stages)?;
    }
    Ok((Identified { found, rounds }, stages, notes))
}

/// Derivatives of the lines with respect to each unknown: the lines are refitted with the unknown changed from its last identified value.
fn following(
    file: &CalibrationFile,
    observations: &Observations,
    (known, stages): (&Machine, &Stages),
    found: &[Parameter],
) -> Result<Vec<Follower>, CalibrateError> {
    let mut followers = Vec::new();
    for (place, parameter) in found.iter().enumerate() {
        let Some(changed) = changed(file, observations, known, (found, place))? else {
            continue;
        };
        if !changed.is_as_measured(stages) {
            let machines = [stages.machine.clone(), changed.machine];
            followers.push(Follower::new(parameter, machines, CHANGE)?);
        }
    }
    Ok(followers)
}

fn moved(before: &[Parameter], after: &[Parameter]) -> f64 {
    let pairs = before.iter().zip(after);
    let changes = pairs.filter_map(|(before, after)| {
        let uncertainty = after.uncertainty?.max(LEAST);
        Some((after.value - before.value).abs() / uncertainty)
    });
    changes.fold(0.0, f64::max)
}

/// Warning for each error whose chosen curve leaves residuals larger than the scatter of the readings, whose targets
/// are too sparse, or whose curve oscillates between them.
pub(crate) fn not_followed(curves: &[FittedCurve], lines: &[FittedLine]) -> Vec<String> {
    let mut warnings = Vec::new();
    let mut rest = curves;
    // The branches of an error are adjacent and have the same choice of method.
    while let Some(curve) = rest.first() {
        let error = curve.error;
        let (branches, others) =
            rest.split_at(rest.iter().take_while(|branch| branch.error == error).count());
        rest = others;
        let unit = if error.component.is_angular() { Urad::SYMBOL } else { Um::SYMBOL };
        let choice = curve.choice.as_ref();
        let of_curves = || {
            let mut said = branches.iter().map(|branch| &branch.between);
            said.find_map(|between| between.not_followed(unit))
        };
        let said = choice.and_then(|choice| choice.not_followed(unit));
        if let Some(said) = said.or_else(of_curves) {
            warnings.push(format!("{error}: {said}"));
        }
        let along = error.axis.kind().coordinate_unit();
        let said = branches
            .iter()
            .map(|branch| branch.between.warnings(unit, along))
            .find(|said| !said.is_empty());
        for said in said.into_iter().flatten() {
            let files = files(lines, error);
            warnings.push(format!("{files}{error}, axis {}: {said}", error.axis));
        }
    }
    warnings
}

/// Files of an error as a prefix: `a.csv, b.csv: `.
fn files(lines: &[FittedLine], error: ErrorName) -> String {
    let of_error = lines.iter().filter(|line| line.error == error);
    let mut files: Vec<&str> =
        of_error.flat_map(|line| &line.sources).map(|source| source.file.as_str()).collect();
    files.dedup();
    if files.is_empty() { String::new() } else { files.join(", ") + ": " }
}

/// Stated values that contradict the observations by more than their uncertainties, such as values with wrong sign or unit, halved or doubled.
fn contradicted_values(
    lines: &LineContribution<'_>,
) -> Result<Vec<(ErrorName, Note)>, CalibrateError> {
    /// Minimum contradiction as a multiple of the combined standard uncertainty.
    const UNCERTAINTIES: f64 = 4.0;
    /// Minimum contradiction as a fraction of the value.
    const SHARE: f64 = 0.4;
    let all = Stated::all(lines.file);
    // The change to the opposite value; for a value below half of `CHANGE`, the change `CHANGE`.
    let step = |of: &Stated| {
        if 2.0 * of.value.abs() > CHANGE { -2.0 * of.value } else { CHANGE }
    };
    let machines = all.iter().map(|of| {
        let file = of.changed(lines.file, step(of));
        lines.fitted(&file).map(|stages| stages.machine)
    });
    let machines: Vec<_> = machines.collect::<Result<_, _>>()?;
    let mut notes = Vec::new();
    for (of, wanted) in all.iter().zip(lines.response.supported_shares(&machines)?) {
        let Some(wanted) = wanted else { continue };
        let change = wanted.share * step(of);
        let own = (wanted.uncertainty * step(of)).abs();
        if change.abs() > UNCERTAINTIES * own.hypot(of.uncertainty)
            && change.abs() > SHARE * of.value.abs()
        {
            let [stated, fits] = [of.value, of.value + change]
                .map(|micro| Displacement::from_micro(of.error.component.kind(), micro));
            let digits = if of.value.abs() < 1.0 { 4 } else { 1 };
            let what = format!(
                "the observations contradict its {stated:.digits$} and fit with {fits:.1}, standard uncertainty {own:.1}"
            );
            let place = format!("{} in [[{}]]", of.error, of.table);
            let note = Note::warning(place, what).hint("check its sign and unit");
            notes.push((of.error, note));
        }
    }
    Ok(notes)
}
