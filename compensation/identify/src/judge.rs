//! How good what was found is: residuals, rows that were left out, rows that are only predicted, outliers.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_document::Note;
use volcomp_kinematics::nalgebra::Vector3;

use crate::{
    checks::median,
    error::{IdentifyError, at},
    identify::fit,
    observations::Observations,
    prepared::Rows,
    system::System,
    values::Values,
};

/// The size of what is left of rows: distances in three directions for `points` and `sphere`, else the number itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Figures {
    /// Root mean square, µm.
    #[cfg_attr(feature = "serde", serde(rename = "rms"))]
    pub rms_um: f64,
    /// The largest, µm.
    #[cfg_attr(feature = "serde", serde(rename = "max"))]
    pub max_um: f64,
    /// Number of rows.
    pub rows: usize,
}

pub(crate) fn figures(residuals: &[Vector3<f64>]) -> Figures {
    let squares: f64 = residuals.iter().map(Vector3::norm_squared).sum();
    let largest = residuals.iter().map(Vector3::norm).fold(0.0, f64::max);
    Figures {
        rms_um: 1e3 * (squares / residuals.len().max(1) as f64).sqrt(),
        max_um: 1e3 * largest,
        rows: residuals.len(),
    }
}

/// The part of each row: rows of one pose are in the same part, poses are dealt out in an order drawn with a fixed seed. `None` where
/// there are fewer poses than parts: a part without a pose would judge nothing.
fn parts(rows: &Rows, count: usize) -> Option<Vec<usize>> {
    if count == 0 {
        return None;
    }
    let (pose_of, poses) = rows.poses();
    if poses < count {
        return None;
    }
    let mut order: Vec<usize> = (0..poses).collect();
    let mut random = ChaCha8Rng::seed_from_u64(0x766f_6c63);
    for last in (1..order.len()).rev() {
        let drawn = random.next_u64() % (last as u64 + 1);
        // At most `last`, which is a place of the list.
        order.swap(last, usize::try_from(drawn).unwrap_or(last));
    }
    let mut part = vec![0; poses];
    for (place, pose) in order.into_iter().enumerate() {
        part[pose] = place % count;
    }
    Some(pose_of.into_iter().map(|pose| part[pose]).collect())
}

/// What is left of rows that were left out of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LeftOut {
    /// The size of what is left.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub figures: Figures,
    /// Number of parts in which the poses were left out.
    pub folds: usize,
}

/// What is left of rows that were left out of the fit, in so many parts by pose; everything, penalties included, is
/// found anew from the others. A note in place of it where the poses are too few.
pub(crate) fn left_out(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    start: &Values,
    mut done: impl FnMut(usize),
) -> Result<(Option<LeftOut>, Option<Note>), IdentifyError> {
    let folds = observations.folds;
    if folds < 2 {
        return Ok((None, None));
    }
    let none = |why: String| {
        Ok((
            None,
            Some(Note::info("", format!("no rows were left out: {why}"))),
        ))
    };
    let Some(parts) = parts(rows, folds) else {
        return none(format!(
            "{} poses make no {folds} parts (`folds`)",
            rows.poses().1
        ));
    };
    let mut residuals = Vec::new();
    for fold in 0..folds {
        let others = rows.only(|row| parts[row] != fold);
        let left = rows.only(|row| parts[row] == fold);
        let fitted = match fit(system, observations, &others, start.clone()) {
            Ok(fitted) => fitted,
            Err(IdentifyError::TooFew { .. } | IdentifyError::NotConverged { .. }) => {
                return none(
                    "without some of the poses the others do not determine the unknowns".to_owned(),
                );
            }
            Err(error) => return Err(error),
        };
        residuals.extend(system.residuals(&left, &fitted.solution.values));
        done(fold + 1);
    }
    let figures = figures(&residuals);
    Ok((Some(LeftOut { figures, folds }), None))
}

/// Notes on rows that are only predicted.
#[derive(Default)]
pub(crate) struct OfJudged {
    /// On files that are far off as a whole.
    pub(crate) files: Vec<Note>,
    /// On single rows that are far off beside the others.
    pub(crate) rows: Vec<Note>,
}

/// What is left of the rows that are only predicted, and notes on those that are far off beside the others of their file, and on
/// files that are far off beside what is left of the fitted rows.
pub(crate) fn judged(
    system: &System,
    observations: &Observations,
    values: &Values,
    fitted: Figures,
) -> (Option<Figures>, OfJudged) {
    const SHOWN: usize = 5;
    /// As of fitted rows beside their uncertainty.
    const TIMES_FITTED: f64 = 3.0;
    const TIMES_USUAL: f64 = 10.0;
    let mut notes = OfJudged::default();
    let mut all = Vec::new();
    for observation in observations.observations.iter().filter(|o| o.judge) {
        let rows = system.prepare(observation.rows.iter());
        let residuals = system.residuals(&rows, values);
        let sizes: Vec<f64> = residuals.iter().map(Vector3::norm).collect();
        let usual = median(&sizes);
        let stated = observation.rows.iter().map(|row| row.uncertainty_mm);
        let expected = (1e-3 * fitted.rms_um).max(stated.fold(0.0, f64::max));
        if usual > TIMES_FITTED * expected {
            let what = format!(
                "its judged rows are {:.1} µm (median) from what was found, the fitted ones {:.1} µm RMS: are they of the same machine and set-up?",
                1e3 * usual,
                fitted.rms_um
            );
            notes
                .files
                .push(Note::warning(observation.file.as_str(), what));
        }
        let rows = observation.rows.iter().zip(&sizes);
        let far = rows.filter(|(row, size)| **size > TIMES_USUAL * usual.max(row.uncertainty_mm));
        notes.rows.extend(far.take(SHOWN).map(|(row, size)| {
            let what = format!(
                "this judged row is {:.1} µm from what was found, the others {:.1} µm (median): is it a slip?",
                1e3 * size,
                1e3 * usual
            );
            Note::warning(at(&observation.file, row.line), what)
        }));
        all.extend(residuals);
    }
    ((!all.is_empty()).then(|| figures(&all)), notes)
}
