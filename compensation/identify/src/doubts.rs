//! What is odd about the observations as a whole once the best machine was found.

use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{
    identify::Fitted,
    observations::{Observations, Seen},
    prepared::Rows,
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
    } else if !observations.measured.is_empty() {
        "So does the noise of the lines, which the uncertainties count".to_owned()
    } else {
        format!(
            "The uncertainties count the stated ones alone: multiply them by {factor:.1} at the least"
        )
    };
    let has_motion = observations.machine.errors().next().is_some()
        || observations
            .unknown
            .iter()
            .any(|unknown| !unknown.error.location);
    let motions = if has_motion {
        ""
    } else {
        ". The machine file has no error motions and none is unknown, so that all that the axes miss on their way is in what is left, and in what is found"
    };
    Some(format!(
        "what is left is {factor:.1} times the stated uncertainty ({}): the observations contradict each other, the unknowns do not describe the machine, or `uncertainty_um` is too small. {so}{motions}",
        worst.join(", ")
    ))
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
        // A length between two poses moves the axes from the one to the other.
        let at = || {
            rows.iter().flat_map(|row| {
                let from = match &row.seen {
                    Seen::Pair { from, .. } => Some(from.state.q[place]),
                    _ => None,
                };
                from.into_iter().chain([row.stand.state.q[place]])
            })
        };
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
