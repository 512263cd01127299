//! What was measured at rows of balls, as the mean correction of an NC program takes it.

use std::path::Path;

use volcomp_identify::{Kind, Observations, Seen};
use volcomp_nc::Reading;

use crate::failure::Failure;

/// The readings of all ball rows of a file: how far the tip is from each ball, along each direction that was read.
///
/// # Errors
/// What reading the file says; a file without ball rows; a row whose place is not stated, since its readings do not say where the
/// machine is.
pub(super) fn readings(path: &Path) -> Result<Vec<Reading>, Failure> {
    let observations = Observations::read(path)?;
    let mut readings = Vec::new();
    for observation in &observations.observations {
        if observation.kind != Kind::BallRow {
            continue;
        }
        for row in &observation.rows {
            let Seen::Ball {
                origin,
                tilts,
                axes,
                offset_mm,
                ..
            } = &row.seen
            else {
                continue;
            };
            let setup = &observations.setup;
            if setup.points[*origin].unknown
                || tilts.iter().any(|tilt| setup.numbers[*tilt].unknown)
            {
                return Err(Failure::in_file(
                    path,
                    format!(
                        "the ball row {} has an unknown `origin` or `direction`, so that its readings do not say where the machine is; expected both as numbers",
                        observation.file
                    ),
                ));
            }
            for (along, error_mm) in axes.column_iter().zip(offset_mm) {
                readings.extend(error_mm.map(|error_mm| Reading {
                    direction: [along[0], along[1], along[2]],
                    error_mm,
                }));
            }
        }
    }
    if readings.is_empty() {
        return Err(Failure::in_file(
            path,
            "found no observation of kind \"ball-row\", expected one at least",
        ));
    }
    Ok(readings)
}
