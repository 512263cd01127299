//! Observations from which no machine can be found, or only a wrong one.

use std::collections::BTreeSet;

use crate::{
    error::IdentifyError,
    observations::{Observations, Row, Seen},
    order::absurd_jump,
    params::{Param, Part},
    prepared::Rows,
    rank::Rank,
    span::Span,
    system::System,
    values::Values,
};

/// Refuses rows that are far away, and rows of which some are shifted beside others: a shift is the better reason where no other
/// cause is known.
pub(crate) fn refuse_jump(
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
            let residuals = system.plain_residuals(rows, values);
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
pub(crate) fn refuse_target(
    system: &System,
    rows: &Rows,
    rank: &Rank,
) -> Result<(), IdentifyError> {
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
pub(crate) fn check(system: &System, rows: &Rows) -> Result<(), IdentifyError> {
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
