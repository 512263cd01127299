//! Files that contradict the others until one thing about them is taken to be another: the sign of their readings, the tool, two
//! columns.
//!
//! What would be left then follows from the equations at hand, as far as they are straight; what looks good is fitted.

use core::ops::Range;

use volcomp_kinematics::nalgebra::DVector;

use crate::{
    causes::{causes, with_cause},
    error::Cause,
    identify::{Fitted, fit},
    left::{BETTER, Left},
    observations::{NumberKind, Observations, Row, Seen},
    prepared::Rows,
    system::System,
};

/// A step on the way there: one of several files makes the squares smaller by this at the least.
const ON_THE_WAY: f64 = 0.8;
/// So many files may be wrong at once.
const MOST: usize = 6;
/// Of so many files the signs are turned in any combination.
const MOST_TURNED: usize = 4;
const MOST_SETS: usize = 30_000;

/// Something that is taken to be another in one file.
struct Trial {
    file: usize,
    name: String,
    cause: Cause,
    own: Range<usize>,
    rows: Vec<Row>,
    /// By what it changes the residuals of all equations.
    change: DVector<f64>,
}

/// Notes on files that fit far better with one thing taken to be another.
pub(crate) fn mistaken(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Vec<String> {
    let mut notes = inches_in_dead_lengths(system, observations, fitted);
    if fitted.solution.excess().is_none() {
        return notes;
    }
    let trials = trials(system, observations, rows, fitted);
    let changes: Vec<&DVector<f64>> = trials.iter().map(|trial| &trial.change).collect();
    let left = Left::new(system, rows, fitted, &changes);
    for set in best(&left, &trials) {
        let set: Vec<&Trial> = set.iter().map(|place| &trials[*place]).collect();
        notes.extend(confirmed(system, observations, rows, fitted, &set));
    }
    notes
}

/// The fewest trials together that make it good, and as few others that are as good; the best first.
fn best(left: &Left, trials: &[Trial]) -> Vec<Vec<usize>> {
    let singles = (0..trials.len()).map(|place| vec![place]).collect();
    let found = left.good(singles);
    if !found.is_empty() {
        return found;
    }
    // Signs in any combination: one alone may seem to make it worse.
    let turned: Vec<usize> = (0..trials.len())
        .filter(|place| trials[*place].cause == Cause::Turned)
        .collect();
    let mut sets: Vec<Vec<usize>> = vec![Vec::new()];
    // As many again the other way would be the same machine with opposite errors.
    for count in 1..=(turned.len() / 2).min(MOST_TURNED) {
        sets = sets
            .iter()
            .flat_map(|set| {
                let after = move |place: &&usize| set.last().is_none_or(|last| **place > *last);
                let more = turned.iter().filter(after);
                more.map(|place| [&set[..], &[*place]].concat())
            })
            .collect();
        if sets.len() > MOST_SETS {
            break;
        }
        let found = if count > 1 {
            left.good(sets.clone())
        } else {
            Vec::new()
        };
        if !found.is_empty() {
            return found;
        }
    }
    left.good(vec![one_after_the_other(left, trials)])
}

/// One file and cause after the other, each the one after which least is left.
fn one_after_the_other(squares: &Left, trials: &[Trial]) -> Vec<usize> {
    let mut taken: Vec<usize> = Vec::new();
    let mut left = squares.now;
    while taken.len() < MOST && !squares.is_good(left) {
        let open = |place: &usize| {
            let is_of = |other: &usize| trials[*other].file == trials[*place].file;
            !taken.iter().any(is_of)
        };
        let tried = (0..trials.len()).filter(open).map(|place| {
            let left = squares.of(&[&taken[..], &[place]].concat());
            (place, left)
        });
        match tried.min_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((place, then)) if then < ON_THE_WAY * left => {
                taken.push(place);
                left = then;
            }
            _ => break,
        }
    }
    taken
}

/// Everything that may be another in each file.
fn trials(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Vec<Trial> {
    let values = &fitted.solution.values;
    let equations = system.plain_equations(rows, values, false);
    let mut trials = Vec::new();
    for (file, (observation, own)) in observations.fitted().enumerate() {
        let of_file: Vec<&Row> = own.clone().map(|row| rows.get(row)).collect();
        let Some(&(first, _)) = equations.places.get(own.start) else {
            continue;
        };
        for cause in causes(&system.machine, &of_file) {
            let changed: Vec<Row> = of_file
                .iter()
                .map(|row| with_cause(row, &cause, &system.machine))
                .collect();
            let there = system.plain_equations(&system.prepare(changed.iter()), values, false);
            // What a calibration says stands below the rows, and is as it was.
            let count: usize = there.places.iter().map(|(_, count)| count).sum();
            let mut change = DVector::zeros(equations.residuals.len());
            let by = there.residuals.rows(0, count) - equations.residuals.rows(first, count);
            change.rows_mut(first, count).copy_from(&by);
            equations.sides.eliminate_from(&mut change);
            trials.push(Trial {
                file,
                name: observation.file.clone(),
                cause,
                own: own.clone(),
                rows: changed,
                change,
            });
        }
    }
    trials
}

/// The note on some files and what is another in them, where a fit says so too.
fn confirmed(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
    set: &[&Trial],
) -> Option<String> {
    let mut all: Vec<Row> = rows.iter().cloned().collect();
    for trial in set {
        all[trial.own.clone()].clone_from_slice(&trial.rows);
    }
    let prepared = system.prepare(all.iter());
    let values = fitted.solution.values.clone();
    let other = fit(system, observations, &prepared, values).ok()?;
    let [now, then] = [fitted, &other].map(|of| of.solution.variance.sqrt());
    // Beside many rows that fit either way the contradiction is small, but it goes.
    if other.solution.excess().is_some() && then > BETTER * now {
        return None;
    }
    let left = format!("{then:.1} times the stated uncertainty is left in place of {now:.1}");
    let files: Vec<&str> = set.iter().map(|trial| trial.name.as_str()).collect();
    let files = files.join(", ");
    if set.iter().all(|trial| trial.cause == Cause::Turned) {
        return Some(format!(
            "{files}: with the opposite sign of its readings {left}: does the instrument count the other way?"
        ));
    }
    let causes: Vec<String> = set
        .iter()
        .map(|trial| match set {
            [_] => format!("{}: the rows do not fit; {}", trial.name, trial.cause),
            _ => format!("{}: {}", trial.name, trial.cause),
        })
        .collect();
    Some(format!("{} ({left})", causes.join("; and ")))
}

/// Lengths in inches differ by 24.4 times themselves from those in mm, which a dead length that is to be found takes up where all
/// are alike.
fn inches_in_dead_lengths(
    system: &System,
    observations: &Observations,
    fitted: &Fitted,
) -> Vec<String> {
    const MM_PER_INCH: f64 = 25.4;
    const NEAR: f64 = 0.01;
    let mut notes = Vec::new();
    for (observation, _) in observations.fitted() {
        let lengths = observation.rows.iter().filter_map(|row| match row.seen {
            Seen::Distance {
                dead, length_mm, ..
            }
            | Seen::Pair {
                dead, length_mm, ..
            } => Some((dead, length_mm)),
            _ => None,
        });
        let lengths: Vec<(usize, f64)> = lengths.collect();
        let Some(&(dead, _)) = lengths.first() else {
            continue;
        };
        let is_dead = system.setup.number_kinds.get(dead) == Some(&NumberKind::DeadLength);
        if !is_dead || !system.setup.numbers[dead].unknown {
            continue;
        }
        let mean = lengths.iter().map(|(_, length)| length).sum::<f64>() / lengths.len() as f64;
        let found = fitted.solution.values.numbers[dead][0];
        let as_inches = (MM_PER_INCH - 1.0) * mean;
        if mean > 0.0 && (found - as_inches).abs() < NEAR * as_inches {
            notes.push(format!(
                "{}: the dead length is found to be {found:.3} mm, which is what lengths of {mean:.3} inches lack in mm: is `length_mm` inches?",
                observation.file
            ));
        }
    }
    notes
}
