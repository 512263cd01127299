//! How good what was found is: residuals, rows that were left out, rows that are only predicted, outliers.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::nalgebra::Vector3;

use crate::{
    error::{IdentifyError, at},
    identify::fit,
    observations::{Observations, Seen},
    prepared::Rows,
    system::System,
    values::Values,
};

/// The size of what is left of rows: distances in three directions for `points` and `sphere`, else the number itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Root mean square, µm.
    pub rms_um: f64,
    /// The largest, µm.
    pub max_um: f64,
    /// How many rows.
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

/// The figures of rows that were left out, and in how many parts.
pub(crate) type LeftOut = Option<(Figures, usize)>;

/// What is left of rows that were left out of the fit, in so many parts by pose; everything, penalties included, is
/// found anew from the others. A note in place of it where the poses are too few.
pub(crate) fn left_out(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    start: &Values,
    mut done: impl FnMut(usize),
) -> Result<(LeftOut, Option<String>), IdentifyError> {
    let folds = observations.folds;
    if folds < 2 {
        return Ok((None, None));
    }
    let none = |why: String| Ok((None, Some(format!("no rows were left out: {why}"))));
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
    Ok((Some((figures(&residuals), folds)), None))
}

/// What is left of the rows that are only predicted, and notes on those that are far off beside the others of their file, and on
/// files that are far off beside what is left of the fitted rows.
pub(crate) fn judged(
    system: &System,
    observations: &Observations,
    values: &Values,
    fitted: Figures,
) -> (Option<Figures>, Vec<String>) {
    const SHOWN: usize = 5;
    const TIMES: f64 = 10.0;
    let mut notes = Vec::new();
    let mut all = Vec::new();
    for observation in observations.observations.iter().filter(|o| o.judge) {
        let rows = system.prepare(observation.rows.iter());
        let residuals = system.residuals(&rows, values);
        let sizes: Vec<f64> = residuals.iter().map(Vector3::norm).collect();
        let usual = median(&sizes);
        let stated = observation.rows.iter().map(|row| row.uncertainty_mm);
        let expected = (1e-3 * fitted.rms_um).max(stated.fold(0.0, f64::max));
        if usual > TIMES * expected {
            notes.push(format!(
                "{}: its judged rows are {:.1} µm (median) from what was found, the fitted ones {:.1} µm RMS: are they of the same machine and set-up?",
                observation.file,
                1e3 * usual,
                fitted.rms_um
            ));
        }
        let rows = observation.rows.iter().zip(&sizes);
        let far = rows.filter(|(row, size)| **size > TIMES * usual.max(row.uncertainty_mm));
        notes.extend(far.take(SHOWN).map(|(row, size)| {
            format!(
                "{}: this judged row is {:.1} µm from what was found, the others {:.1} µm (median): is it a slip?",
                at(&observation.file, row.line),
                1e3 * size,
                1e3 * usual
            )
        }));
        all.extend(residuals);
    }
    ((!all.is_empty()).then(|| figures(&all)), notes)
}

/// Notes on rows that fit far worse than the others of their file, and on spheres that moved between files.
pub(crate) fn outliers(
    observations: &Observations,
    rows: &Rows,
    residuals: &[Vector3<f64>],
) -> Vec<String> {
    const SHOWN: usize = 10;
    let mut notes = Vec::new();
    let mut spheres: Vec<(usize, &str, Vector3<f64>, f64, usize)> = Vec::new();
    for (observation, own) in observations.fitted() {
        let sizes: Vec<f64> = residuals[own.clone()].iter().map(Vector3::norm).collect();
        let directions = observation.rows.iter().map(|row| row.seen.count()).max();
        // The median of the distances in one, two or three directions, in standard deviations.
        let usual = match directions {
            Some(3..) => 1.538,
            Some(2) => 1.177,
            _ => 0.6745,
        };
        let sigma = median(&sizes) / usual;
        let is_far = |place: &usize| {
            let row = rows.get(*place);
            let size = residuals[*place].norm();
            size > 6.0 * sigma && size > 4.0 * row.uncertainty_mm
        };
        let mut far: Vec<usize> = own.clone().filter(is_far).collect();
        far.sort_by(|a, b| residuals[*b].norm().total_cmp(&residuals[*a].norm()));
        for place in far.iter().take(SHOWN) {
            let (row, size) = (rows.get(*place), residuals[*place].norm());
            // Where the others fit exactly, no number says how many times worse it is than they are.
            let beside = if sigma > 0.01 * row.uncertainty_mm {
                format!("{:.0} times what is usual in this file", size / sigma)
            } else {
                format!("{:.0} times its uncertainty", size / row.uncertainty_mm)
            };
            notes.push(format!(
                "{}: this row is {:.1} µm from what all rows say together, {beside}: is it a slip? `robust = true` lets such rows count less",
                at(&observation.file, row.line),
                1e3 * size,
            ));
        }
        if far.len() > SHOWN {
            notes.push(format!(
                "{}: {} more rows like these",
                observation.file,
                far.len() - SHOWN
            ));
        }
        for place in own {
            let Seen::Sphere { centre, .. } = rows.get(place).seen else {
                continue;
            };
            let u = rows.get(place).uncertainty_mm;
            let file = observation.file.as_str();
            match spheres
                .iter_mut()
                .find(|(c, f, ..)| *c == centre && *f == file)
            {
                Some((_, _, sum, largest, count)) => {
                    *sum += residuals[place];
                    *largest = largest.max(u);
                    *count += 1;
                }
                None => spheres.push((centre, file, residuals[place], u, 1)),
            }
        }
    }
    notes.extend(moved_spheres(observations, &spheres));
    notes
}

/// A sphere whose rows in two files are apart by more than their uncertainty explains.
fn moved_spheres(
    observations: &Observations,
    spheres: &[(usize, &str, Vector3<f64>, f64, usize)],
) -> Vec<String> {
    let mut notes = Vec::new();
    for (place, (centre, file, sum, u, count)) in spheres.iter().enumerate() {
        for (other, before, other_sum, other_u, other_count) in &spheres[..place] {
            if other != centre {
                continue;
            }
            let mean = |sum: &Vector3<f64>, count: usize| sum / count as f64;
            let apart = mean(sum, *count) - mean(other_sum, *other_count);
            let expected = (u * u / *count as f64 + other_u * other_u / *other_count as f64).sqrt();
            if apart.norm() > 6.0 * expected {
                let name = &observations.setup.points[*centre].name;
                notes.push(format!(
                    "{name} seems to have moved by [{:.1}, {:.1}, {:.1}] µm between {before} and {file}: if so, give it another name in one of them",
                    1e3 * apart.x, 1e3 * apart.y, 1e3 * apart.z
                ));
            }
        }
    }
    notes
}

pub(crate) fn median(sizes: &[f64]) -> f64 {
    let mut sorted = sizes.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or_default()
}
