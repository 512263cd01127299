//! Checks of the result: rejects rows that no machine explains, and warns about results that could mislead.

use std::collections::BTreeSet;

use volcomp_document::Note;
use volcomp_kinematics::nalgebra::{DVector, Vector3};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName};

use super::{limit_mm, median};
use crate::error::{FarFile, IdentifyError, at};
use crate::fit::{Fitted, LARGEST};
use crate::observations::{Observations, Part, Row, RowReading};
use crate::params::{Param, Values};
use crate::rank::{Rank, of_unit_length, triangle};
use crate::solve::max_squares_by_chance;
use crate::system::{Rows, System};

/// Maximum distance of a row from the nominal machine, mm, scaled by [`limit_mm`]. A newly assembled machine deviates by a few mm.
const MAX_FROM_NOMINAL_MM: f64 = 10.0;
/// Maximum RMS residual of a file after the fit, mm, scaled by [`limit_mm`].
const MAX_RESIDUAL_MM: f64 = 0.5;
/// Files with RMS residuals below this multiple of their stated uncertainty are never rejected: the residuals are
/// attributed to the instrument.
const WITHIN_UNCERTAINTY: f64 = 6.0;
/// A file is reported as inverted if a refit with the opposite sign of its readings reduces the RMS residual of all
/// rows below this fraction of its present value.
const INVERTED_LEAVES: f64 = 0.25;
/// Minimum number of readings per unknown; with fewer, almost no redundancy remains to check the unknowns.
const MIN_NUMBERS_PER_UNKNOWN: f64 = 1.5;
const MAX_LISTED: usize = 5;

pub(crate) fn refuse_rows(system: &System, rows: &Rows) -> Result<(), IdentifyError> {
    if rows.len() == 0 {
        return Err(IdentifyError::NothingToFit);
    }
    let is_pair = |row: &Row| matches!(row.reading, RowReading::Pair { .. });
    let asks_for_errors = system.params.setup() < system.params.len();
    if rows.poses().1 == 1 && !rows.iter().any(is_pair) && asks_for_errors {
        return Err(IdentifyError::AllAlike { rows: rows.len() });
    }
    Ok(())
}

/// Rejects rows that are further from the nominal machine than real machines deviate. `values` contains the fitted
/// set-ups and no error of the machine.
pub(crate) fn refuse_far(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: &Values,
) -> Result<(), IdentifyError> {
    let limit_mm = limit_mm(&system.machine, rows.iter(), MAX_FROM_NOMINAL_MM);
    let residuals = system.plain_residuals(rows, values);
    let mut files: Vec<FarFile> = Vec::new();
    for (observation, own) in observations.fitted() {
        let mut far: Vec<(f64, usize)> = own
            .clone()
            .map(|row| (residuals[row].norm(), row))
            .filter(|(size, _)| *size > limit_mm)
            .collect();
        far.sort_by(|a, b| b.0.total_cmp(&a.0));
        if let Some(&(largest_mm, worst)) = far.first() {
            files.push(FarFile {
                file: observation.file.clone(),
                line: rows.get(worst).line,
                rows: far.len(),
                of: own.len(),
                typical_mm: far[far.len() / 2].0,
                largest_mm,
                limit_mm,
            });
        }
    }
    if files.is_empty() {
        return Ok(());
    }
    files.sort_by(|a, b| b.typical_mm.total_cmp(&a.typical_mm));
    Err(IdentifyError::FarRows { files })
}

/// Rejects a file whose RMS residual after the fit exceeds the limit; with robust weights, its median residual.
pub(crate) fn refuse_unexplained(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    residuals: &[Vector3<f64>],
) -> Result<(), IdentifyError> {
    let limit_mm = limit_mm(&system.machine, rows.iter(), MAX_RESIDUAL_MM);
    for (observation, own) in observations.fitted() {
        let of_file: Vec<f64> = own.clone().map(|row| residuals[row].norm()).collect();
        let count = of_file.len().max(1) as f64;
        let typical_mm = if observations.robust {
            median(&of_file)
        } else {
            (of_file.iter().map(|size| size * size).sum::<f64>() / count).sqrt()
        };
        let stated = own.clone().map(|row| rows.get(row).uncertainty_mm).sum::<f64>() / count;
        let worst = own.max_by(|a, b| residuals[*a].norm().total_cmp(&residuals[*b].norm()));
        let Some(worst) = worst.filter(|_| typical_mm > limit_mm.max(WITHIN_UNCERTAINTY * stated))
        else {
            continue;
        };
        return Err(IdentifyError::Unexplained {
            file: observation.file.clone(),
            line: rows.get(worst).line,
            typical_mm,
            limit_mm,
        });
    }
    Ok(())
}

/// Rejects a tracker target whose position is undetermined while tilts are unknown. Tilts act through the lever arm of the target, so the
/// identified machine would be right at the target and wrong at the tip.
pub(crate) fn refuse_target(
    system: &System,
    rows: &Rows,
    rank: &Rank,
) -> Result<(), IdentifyError> {
    /// Minimum share of the target in a combination without effect; smaller shares move the target by a negligible amount.
    const SHARE: f64 = 1e-3;
    let is_tilt = |&param: &usize| match system.params.at(param) {
        Param::Coefficient(place) => {
            let error = system.unknowns.coefficients[place].error;
            !error.location && error.component.is_angular() && !system.unknowns.is_convention(place)
        }
        Param::SetUp { .. } => false,
    };
    if !rank.kept.iter().any(is_tilt) {
        return Ok(());
    }
    let targets: BTreeSet<usize> = rows
        .iter()
        .filter_map(|row| match row.reading {
            RowReading::Point { target, .. } => target,
            _ => None,
        })
        .collect();
    let is_target = |param: usize| {
        matches!(system.params.at(param), Param::SetUp { part: Part::Point(place), order: 0, .. }
            if targets.contains(&place))
    };
    // Only combinations that fix a set-up unknown at zero matter here. If an error is fixed at zero, the target is
    // known to within the size of errors.
    let of_setup = |null: &&Vec<(usize, f64)>| null[0].0 < system.params.setup();
    for null in rank.null.iter().filter(of_setup) {
        let target = (null.iter()).find(|(param, share)| is_target(*param) && share.abs() > SHARE);
        if let Some(&(target, _)) = target {
            let others = null.iter().filter(|(param, _)| *param != target);
            let others: Vec<String> =
                others.map(|(param, _)| system.name(*param)).take(4).collect();
            return Err(IdentifyError::Target {
                target: system.name(target),
                with: others.join(", "),
            });
        }
    }
    Ok(())
}

/// Warnings for files whose readings fit far better with the opposite sign, from one linearised refit for each file.
pub(crate) fn inverted(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Vec<Note> {
    if fitted.solution.excess().is_none() {
        return Vec::new();
    }
    let values = &fitted.solution.values;
    let plain = system.equations_in(0, rows, values, false);
    let mut files = Vec::new();
    let mut changes = Vec::new();
    for (observation, own) in observations.fitted() {
        let mut inverted_rows: Vec<Row> = own.clone().map(|row| rows.get(row).clone()).collect();
        for row in &mut inverted_rows {
            row.reading.invert();
        }
        let is_same = inverted_rows
            .iter()
            .zip(own.clone())
            .all(|(row, place)| row.reading == rows.get(place).reading);
        let Some(&(first, _)) = plain.places.get(own.start).filter(|_| !is_same) else {
            continue;
        };
        let inverted_equations =
            system.equations_in(0, &system.prepare(inverted_rows.iter()), values, false);
        // Calibrated numbers of the set-up follow after the rows and do not change sign.
        let count: usize = inverted_equations.places.iter().map(|(_, count)| count).sum();
        let mut change = DVector::zeros(plain.residuals.len());
        let by = inverted_equations.residuals.rows(0, count) - plain.residuals.rows(first, count);
        change.rows_mut(first, count).copy_from(&by);
        plain.sides.eliminate_from(&mut change);
        files.push(observation.file.as_str());
        changes.push(change);
    }
    if files.is_empty() {
        return Vec::new();
    }
    let equations = system.equations(rows, values);
    let kept = fitted.rank.kept.len();
    let mut columns = of_unit_length(equations.jacobian.select_columns(&fitted.rank.kept))
        .resize_horizontally(kept + 1 + files.len(), 0.0);
    columns.set_column(kept, &equations.residuals);
    for (place, change) in changes.into_iter().enumerate() {
        columns.set_column(kept + 1 + place, &(&equations.residuals + change));
    }
    let triangle = triangle(columns);
    // Sum of squares of a column of residuals after the refit of all unknowns.
    let left = |place: usize| triangle.column(kept + place).rows_range(kept..).norm_squared();
    let now = left(0);
    let freedom = fitted.solution.freedom.max(1.0);
    let good = (INVERTED_LEAVES * INVERTED_LEAVES * now).max(max_squares_by_chance(freedom));
    let mut notes = Vec::new();
    for (place, file) in files.into_iter().enumerate() {
        let squares_inverted = left(1 + place);
        if squares_inverted < good {
            let [now, squares_inverted] =
                [now, squares_inverted].map(|squares| (squares / freedom).sqrt());
            let what = format!(
                "looks inverted: with the opposite sign of its readings, the residuals are {squares_inverted:.1} times the stated uncertainty instead of {now:.1}"
            );
            let note = Note::warning(file, what);
            notes.push(note.hint("check the sign convention of the instrument"));
        }
    }
    notes
}

/// RMS residual of each file as a multiple of the stated uncertainty, largest first.
pub(crate) fn times_by_file<'a>(
    observations: &'a Observations,
    rows: &Rows,
    residuals: &[Vector3<f64>],
) -> Vec<(f64, &'a str)> {
    let mut files: Vec<(f64, &str)> = Vec::new();
    for (observation, own) in observations.fitted() {
        let count: usize = own.clone().map(|row| rows.get(row).reading.count()).sum();
        let squares = own.map(|row| (residuals[row].norm() / rows.get(row).uncertainty_mm).powi(2));
        let times = (squares.sum::<f64>() / count.max(1) as f64).sqrt();
        files.push((times, &observation.file));
    }
    files.sort_by(|a, b| b.0.total_cmp(&a.0));
    files
}

/// Warning if residuals exceed the stated uncertainties by more than chance, with the files that
/// fit worst.
pub(crate) fn contradiction(
    observations: &Observations,
    rows: &Rows,
    residuals: &[Vector3<f64>],
    fitted: &Fitted,
) -> Option<Note> {
    const MAX_LISTED: usize = 3;
    let factor = fitted.solution.excess()?;
    let files = times_by_file(observations, rows, residuals);
    let worst: Vec<String> = files
        .iter()
        .take(MAX_LISTED)
        .map(|(times, file)| format!("{file} {times:.1} times"))
        .collect();
    let uncertainties = if fitted.solution.counts_residuals {
        "The uncertainties follow from the residuals and include this already".to_owned()
    } else if !observations.measured.is_empty() {
        "The noise of the lines shows it too, and the uncertainties include it".to_owned()
    } else {
        format!(
            "The uncertainties include only the stated ones: multiply them by at least {factor:.1}"
        )
    };
    let what = format!(
        "the residuals are {factor:.1} times the stated uncertainty ({}): the observations contradict each other, the unknowns do not describe the machine, or `uncertainty_um` is too small. {uncertainties}",
        worst.join(", ")
    );
    Some(Note::warning("", what))
}

/// Warning if no linear axis moves over more than a twentieth of its travel: coordinates and readings may both be in inches.
pub(crate) fn small_travel(machine: &Machine, rows: &Rows) -> Option<Note> {
    const SMALL: f64 = 1.0 / 20.0;
    let mut largest: Option<(f64, AxisName, f64)> = None;
    for (place, axis) in machine.axes().iter().enumerate() {
        let at = || rows.iter().flat_map(Row::poses).map(|s| s.state.q[place]);
        let moved = at().fold(f64::NEG_INFINITY, f64::max) - at().fold(f64::INFINITY, f64::min);
        let share = moved / (axis.travel[1] - axis.travel[0]);
        if axis.name.kind() == AxisKind::Linear
            && share > 0.0
            && largest.is_none_or(|(most, ..)| share > most)
        {
            largest = Some((share, axis.name, moved));
        }
    }
    let (share, name, moved) = largest.filter(|(share, ..)| *share <= SMALL)?;
    let what = format!(
        "the rows move the linear axes over {:.1} % of their travel at most ({name}: {moved:.1} mm): are they mm?",
        100.0 * share
    );
    Some(Note::warning("", what))
}

pub(crate) fn few(rows: &Rows, fitted: &Fitted) -> Option<Note> {
    let numbers: usize = rows.iter().map(|row| row.reading.count()).sum();
    let found = fitted.rank.kept.len();
    // Penalties reduce the effective number of unknowns. Fewer readings than unknowns are too few even then.
    let is_few = (numbers as f64) < MIN_NUMBERS_PER_UNKNOWN * fitted.solution.degrees;
    (is_few || numbers < found).then(|| {
        let what = format!(
            "{numbers} numbers in {} poses for {found} unknowns: they fit almost any machine",
            rows.poses().1
        );
        Note::warning("", what).hint("observe more poses before you use the result")
    })
}

pub(crate) fn large(system: &System, fitted: &Fitted) -> Vec<Note> {
    let values = &fitted.solution.values;
    let mut large: Vec<(f64, usize)> = Vec::new();
    for (place, &param) in fitted.rank.kept.iter().enumerate() {
        let value = values.of(system.params.at(param)).abs();
        // Converts µm to mm and µrad to mrad.
        let size = 1e-3 * system.unit_of(param).1 * value;
        let variance = fitted.solution.covariance[(place, place)].max(0.0);
        let is_error = matches!(system.params.at(param), Param::Coefficient(_));
        if is_error && size > LARGEST && value > 3.0 * variance.sqrt() {
            large.push((size, param));
        }
    }
    large.sort_by(|a, b| b.0.total_cmp(&a.0));
    let note = |(size, param): &(f64, usize)| {
        let is_length = system.unit_of(*param).0 == "um";
        let unit = if is_length { "mm" } else { "mrad" };
        let what = format!("{} was identified as {size:.1} {unit}", system.name(*param));
        Note::warning("", what).hint("check signs, units, tools and points in the machine file")
    };
    let mut notes: Vec<Note> = large.iter().take(MAX_LISTED).map(note).collect();
    if large.len() > MAX_LISTED {
        let what = format!("{} more errors beyond 1 mm or 1 mrad", large.len() - MAX_LISTED);
        notes.push(Note::warning("", what));
    }
    notes
}

pub(crate) fn outliers(
    observations: &Observations,
    rows: &Rows,
    residuals: &[Vector3<f64>],
) -> Vec<Note> {
    const MAX_LISTED: usize = 10;
    let mut notes = Vec::new();
    for (observation, own) in observations.fitted() {
        let sizes: Vec<f64> = residuals[own.clone()].iter().map(Vector3::norm).collect();
        let directions = observation.rows.iter().map(|row| row.reading.count()).max();
        // Median length of a standard normal vector in one, two or three dimensions.
        let usual = match directions {
            Some(3..) => 1.538,
            Some(2) => 1.177,
            _ => 0.6745,
        };
        let sigma = median(&sizes) / usual;
        let is_far = |place: &usize| {
            let size = residuals[*place].norm();
            size > 6.0 * sigma && size > 4.0 * rows.get(*place).uncertainty_mm
        };
        let mut far: Vec<usize> = own.filter(is_far).collect();
        far.sort_by(|a, b| residuals[*b].norm().total_cmp(&residuals[*a].norm()));
        for place in far.iter().take(MAX_LISTED) {
            let (row, size) = (rows.get(*place), residuals[*place].norm());
            // If the other rows fit exactly, the ratio to their residuals has no meaning.
            let comparison = if sigma > 0.01 * row.uncertainty_mm {
                format!("{:.0} times what is usual in this file", size / sigma)
            } else {
                format!("{:.0} times its uncertainty", size / row.uncertainty_mm)
            };
            let what = format!(
                "this row is {:.1} µm from the fit of all rows, {comparison}: is it an outlier?",
                1e3 * size
            );
            notes.push(
                Note::warning(at(&observation.file, row.line), what)
                    .hint("`robust = true` reduces the weight of such rows"),
            );
        }
        if far.len() > MAX_LISTED {
            let what = format!("{} more rows like these", far.len() - MAX_LISTED);
            notes.push(Note::warning(observation.file.as_str(), what));
        }
    }
    notes
}
