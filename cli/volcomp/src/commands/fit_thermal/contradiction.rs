//! Files that contradict each other: one that would agree with the others with the opposite sign, or in another unit.

use std::path::PathBuf;

use volcomp_fit::{ThermalRun, ThermalSearch, search_thermal};

use super::Channel;
use crate::commands::fixed;

/// A file is in doubt from this share of its displacement on that is left of its prediction from the others.
const DOUBTFUL: f64 = 0.5;
/// A cause is named where no more than this share of what is left is left with it.
const EXPLAINS: f64 = 0.3;

/// What may be wrong with the displacement of a file: the factor that it needs, and how that is said of lengths and of angles.
const CAUSES: [(f64, [&str; 2]); 3] = [
    (-1.0, ["had the opposite sign"; 2]),
    (1e3, ["were in mm", "were in mrad"]),
    (1e-3, ["were in nm", "were in nrad"]),
];

/// A note for each file whose displacement agrees with the terms that the others find only by a factor.
pub(super) fn notes(
    channel: &Channel,
    runs: &[ThermalRun],
    files: &[PathBuf],
    search: &ThermalSearch,
) -> Vec<String> {
    let mut notes = Vec::new();
    for (place, (left, run)) in channel.left_out.iter().zip(runs).enumerate() {
        // Where the others predict a file, nothing is searched for.
        let is_doubtful = *left > DOUBTFUL * run.rms_from_start();
        let others: Vec<ThermalRun> = (0..runs.len())
            .filter(|other| *other != place)
            .map(|other| runs[other].clone())
            .collect();
        let Some(terms) = is_doubtful
            .then(|| search_thermal(&others, search).ok())
            .flatten()
        else {
            continue;
        };
        let with = |factor: f64| {
            let mut run = run.clone();
            for displacement in &mut run.record.displacement {
                *displacement *= factor;
            }
            (terms.rms_from_start(&run), run.rms_from_start())
        };
        let cause = CAUSES.iter().find_map(|(factor, cause)| {
            let (better, size) = with(*factor);
            // A factor that makes everything small explains nothing.
            let explains = better < EXPLAINS * left && better < DOUBTFUL * size;
            explains.then_some((better, cause[usize::from(channel.is_angular())], *factor))
        });
        let Some((better, cause, factor)) = cause else {
            continue;
        };
        let mut named = files[place].display().to_string();
        let two = runs.len() == 2;
        if two && factor < 0.0 {
            named = format!("{named} or {}", files[1 - place].display());
        }
        let unit = if channel.is_angular() { "µrad" } else { "µm" };
        notes.push(format!(
            "{}: these files contradict each other: if {named} {cause}, {} {unit} would be left of its prediction from the others in place of {} {unit}",
            channel.name,
            fixed(better, 2),
            fixed(*left, 2)
        ));
        if two && factor < 0.0 {
            break;
        }
    }
    notes
}
