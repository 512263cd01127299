//! The last stage: unknown errors from observations of the whole machine, with the measured ones held, and the measured
//! ones fitted again without what the found ones add to their lines, until both settle.

use volcomp_identify::{Identification, Observations, Parameter, identify};
use volcomp_model::Machine;
use volcomp_vocabulary::ErrorName;

use crate::{calibration_file::CalibrationFile, error::CalibrateError, stages::Stages};

/// What is found has settled when nothing moves by more than this part of its standard uncertainty.
const SETTLED: f64 = 0.01;
/// The smallest uncertainty that is looked at, in the unit of the parameter.
const LEAST: f64 = 1e-6;
/// What has not settled after so many rounds is an error.
const ROUNDS: usize = 60;
/// A share that one round carries into the next that makes uncertainties more than a quarter larger.
const WORTH_TELLING: f64 = 0.2;

/// Errors found from observations.
#[derive(Clone, Debug)]
pub struct Identified {
    /// What was found, with its uncertainties, rank and residuals.
    pub found: Identification,
    /// How often the unknowns were identified until the measured lines, cleared of them, had settled.
    pub rounds: usize,
}

/// Finds the unknowns of a file, whose lines were fitted with the errors of `known`; the stages come back as they were
/// fitted last.
pub(crate) fn settled(
    file: &CalibrationFile,
    observations: &Observations,
    mut known: Machine,
    mut stages: Stages,
) -> Result<(Identified, Stages, Vec<String>), CalibrateError> {
    let on = |machine: &Machine, folds: usize| {
        let mut observations = observations.clone();
        observations.machine = machine.clone();
        observations.folds = folds;
        identify(&observations, |_, _| {})
    };
    let mut notes = Vec::new();
    let mut before: Option<Vec<Parameter>> = None;
    let mut rounds = 0;
    let mut last_moved = None;
    let mut carried = 0.0_f64;
    loop {
        rounds += 1;
        let found = on(&stages.machine, 0)?;
        let moved = before
            .as_ref()
            .map(|before| moved(before, &found.parameters));
        // What one round changes in the lines, and with them in the next: beyond the noise of the numbers a constant share.
        if let (Some(before), Some(moved)) = (last_moved, moved)
            && moved > SETTLED
        {
            carried = carried.max(moved / before);
        }
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
            // Where a change of the unknowns changes the lines nearly as much, the place where both stand still is no least
            // squares answer, and the uncertainties with the lines held are not its.
            return Err(CalibrateError::NotSettled {
                rounds,
                moved: moved.unwrap_or_default(),
            });
        }
        before = Some(found.parameters);
    }
    if rounds > 1 {
        notes.push(format!(
            "the unknowns were identified {rounds} times, each time with the lines cleared of what was found before, until they settled"
        ));
    }
    if carried > WORTH_TELLING {
        let times = 1.0 / (1.0 - carried.min(0.99));
        notes.push(format!(
            "the lines contain the unknowns: each round moved them by {:.0} % of the one before. Their uncertainties are those with the lines held, and may be {times:.1} times as large",
            100.0 * carried
        ));
    }
    let found = on(&stages.machine, observations.folds)?;
    Ok((Identified { found, rounds }, stages, notes))
}

/// The largest change of a determined parameter in its standard uncertainties.
fn moved(before: &[Parameter], after: &[Parameter]) -> f64 {
    let pairs = before.iter().zip(after);
    let changes = pairs.filter_map(|(before, after)| {
        let uncertainty = after.uncertainty?.max(LEAST);
        Some((after.value - before.value).abs() / uncertainty)
    });
    changes.fold(0.0, f64::max)
}

/// Gives `to` the error of another machine.
fn take(to: &mut Machine, from: &Machine, error: ErrorName) -> Result<(), CalibrateError> {
    if error.location {
        let value = from.locations().get(&error).copied();
        to.set_location(error, value.unwrap_or_default())?;
    } else if let Some(curve) = from.error(error) {
        to.set_error(error, curve.clone())?;
    }
    Ok(())
}
