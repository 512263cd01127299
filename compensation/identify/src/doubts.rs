//! What is odd about the observations as a whole once the best machine was found.

use volcomp_kinematics::nalgebra::Vector3;

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
    Some(format!(
        "what is left is {factor:.1} times the stated uncertainty ({}): the observations contradict each other, the unknowns do not describe the machine, or `uncertainty_um` is too small. The uncertainties count the stated ones alone: multiply them by {factor:.1} at the least",
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
    /// What is left by the opposite sign is a part of what is left as it is.
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
        if then < BETTER * now {
            notes.push(format!(
                "{}: with the opposite sign its readings leave {:.1} times less: does the instrument count the other way?",
                observation.file,
                now / then.max(f64::MIN_POSITIVE)
            ));
        }
    }
    notes
}
