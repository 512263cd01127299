//! What is odd about the observations as a whole once the best machine was found.

use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{
    identify::{Fitted, fit},
    observations::{Observations, Row},
    prepared::Rows,
    system::System,
};

/// A note where the residuals are larger than what was stated and chance explain, with the files that fit worst.
pub(crate) fn contradiction(
    observations: &Observations,
    rows: &Rows,
    residuals: &[Vector3<f64>],
    fitted: &Fitted,
) -> Option<String> {
    const SHOWN: usize = 3;
    let factor = fitted.solution.excess()?;
    let mut files: Vec<(f64, &str)> = Vec::new();
    for (observation, own) in observations.fitted() {
        let count: usize = own.clone().map(|row| rows.get(row).seen.count()).sum();
        let squares = own.map(|row| {
            let size = residuals[row].norm() / rows.get(row).uncertainty_mm;
            size * size
        });
        let times = (squares.sum::<f64>() / count.max(1) as f64).sqrt();
        files.push((times, &observation.file));
    }
    files.sort_by(|a, b| b.0.total_cmp(&a.0));
    let worst: Vec<String> = files
        .iter()
        .take(SHOWN)
        .map(|(times, file)| format!("{file} {times:.1} times"))
        .collect();
    let so = if fitted.solution.counts_residuals {
        "The uncertainties follow from what is left, and count this already".to_owned()
    } else {
        format!(
            "The uncertainties count the stated ones alone: multiply them by {factor:.1} at the least"
        )
    };
    Some(format!(
        "what is left is {factor:.1} times the stated uncertainty ({}): the observations contradict each other, the unknowns do not describe the machine, or `uncertainty_um` is too small. {so}",
        worst.join(", ")
    ))
}

/// Notes on files whose rows fit far better with the opposite sign: an instrument that counts the other way.
pub(crate) fn opposite(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Vec<String> {
    /// What is left by the opposite sign is a part of what is left as it is, where chance does not explain the former either.
    const BETTER: f64 = 0.25;
    if fitted.solution.excess().is_none() {
        return Vec::new();
    }
    let mut notes = Vec::new();
    for (observation, own) in observations.fitted() {
        let turned: Vec<Row> = rows
            .iter()
            .enumerate()
            .map(|(place, row)| {
                let mut row = row.clone();
                if own.contains(&place) {
                    row.seen.turn();
                }
                row
            })
            .collect();
        if turned
            .iter()
            .zip(rows.iter())
            .all(|(a, b)| a.seen == b.seen)
        {
            continue;
        }
        let turned = system.prepare(turned.iter());
        let values = fitted.solution.values.clone();
        let Ok(other) = fit(system, observations, &turned, values) else {
            continue;
        };
        let [now, then] = [fitted, &other].map(|of| of.solution.variance.sqrt());
        // Beside many rows that fit either way the contradiction is small, but it goes.
        if other.solution.excess().is_none() || then < BETTER * now {
            notes.push(format!(
                "{}: with the opposite sign of its readings {then:.1} times the stated uncertainty is left in place of {now:.1}: does the instrument count the other way?",
                observation.file,
            ));
        }
    }
    notes
}

/// A note where all linear axes keep to a small part of their travel: coordinates and readings in inches alike fit as well as in
/// mm where nothing of the machine has a length.
pub(crate) fn small_moves(machine: &Machine, rows: &Rows) -> Option<String> {
    const SMALL: f64 = 1.0 / 20.0;
    let mut largest: Option<(f64, AxisName, f64)> = None;
    for (place, axis) in machine.axes().iter().enumerate() {
        if axis.name.kind() != AxisKind::Linear {
            continue;
        }
        let at = || rows.iter().map(|row| row.stand.state.q[place]);
        let span = at().fold(f64::NEG_INFINITY, f64::max) - at().fold(f64::INFINITY, f64::min);
        let share = span / (axis.travel[1] - axis.travel[0]);
        if share > SMALL {
            return None;
        }
        if share > 0.0 && largest.is_none_or(|(most, ..)| share > most) {
            largest = Some((share, axis.name, span));
        }
    }
    let (share, name, span) = largest?;
    Some(format!(
        "the rows move the linear axes over {:.1} % of their travel at the most ({name}: {span:.1} mm): are they mm?",
        100.0 * share
    ))
}
