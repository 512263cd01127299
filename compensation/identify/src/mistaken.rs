//! Files that contradict the others until one thing about them is taken to be another: the sign of their readings, the tool, two
//! columns.
//!
//! What would be left then follows from the equations at hand, as far as they are straight; what looks good is fitted.

use core::ops::Range;

use volcomp_kinematics::nalgebra::{DMatrix, DVector};

use crate::{
    causes::{causes, with_cause},
    error::Cause,
    identify::{Fitted, fit},
    observations::{NumberKind, Observations, Row, Seen},
    prepared::Rows,
    system::System,
};

/// With the cause a part of what is left without it is left, where chance does not explain the former either.
const BETTER: f64 = 0.25;
/// A step on the way there: one of several files makes the squares smaller by this at the least.
const ON_THE_WAY: f64 = 0.8;
/// Other causes are as good where they leave no more than so many times what the best leaves.
const ALIKE: f64 = 1.5;
/// So many causes are named.
const SHOWN: usize = 3;
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
    let left = Left::new(system, rows, fitted, &trials);
    for set in left.best(&trials) {
        let set: Vec<&Trial> = set.iter().map(|place| &trials[*place]).collect();
        notes.extend(confirmed(system, observations, rows, fitted, &set));
    }
    notes
}

/// The squares of what would be left, as far as the equations are straight: a quadratic form in what is changed.
struct Left {
    now: f64,
    /// The scalar products of the changes with what is left, and with each other, beside the unknowns.
    with_rest: DVector<f64>,
    with_others: DMatrix<f64>,
    freedom: f64,
}

impl Left {
    fn new(system: &System, rows: &Rows, fitted: &Fitted, trials: &[Trial]) -> Self {
        let equations = system.equations(rows, &fitted.solution.values, false);
        let basis = orthonormal(equations.jacobian.select_columns(&fitted.rank.kept));
        let normal = |vector: &DVector<f64>| vector - &basis * (basis.transpose() * vector);
        let residuals = normal(&equations.residuals);
        let changes: Vec<DVector<f64>> = trials.iter().map(|trial| normal(&trial.change)).collect();
        Self {
            now: residuals.norm_squared(),
            with_rest: DVector::from_fn(trials.len(), |k, _| residuals.dot(&changes[k])),
            with_others: DMatrix::from_fn(trials.len(), trials.len(), |a, b| {
                changes[a].dot(&changes[b])
            }),
            freedom: fitted.solution.freedom.max(1.0),
        }
    }

    fn of(&self, set: &[usize]) -> f64 {
        let mut squares = self.now;
        for &one in set {
            squares += 2.0 * self.with_rest[one];
            squares += set
                .iter()
                .map(|&other| self.with_others[(one, other)])
                .sum::<f64>();
        }
        squares.max(0.0)
    }

    fn is_good(&self, left: f64) -> bool {
        let by_chance = self.freedom + 4.0 * (2.0 * self.freedom).sqrt();
        left < BETTER * BETTER * self.now || left < by_chance
    }

    /// The fewest trials together that make it good, and as few others that are as good; the best first.
    fn best(&self, trials: &[Trial]) -> Vec<Vec<usize>> {
        let singles = (0..trials.len()).map(|place| vec![place]).collect();
        let found = self.good(singles);
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
                self.good(sets.clone())
            } else {
                Vec::new()
            };
            if !found.is_empty() {
                return found;
            }
        }
        self.good(vec![self.one_after_the_other(trials)])
    }

    /// Those of some sets that are good, and nearly as good as the best.
    fn good(&self, sets: Vec<Vec<usize>>) -> Vec<Vec<usize>> {
        let with = sets.into_iter().map(|set| (self.of(&set), set));
        let mut good: Vec<(f64, Vec<usize>)> = with
            .filter(|(left, set)| !set.is_empty() && self.is_good(*left))
            .collect();
        good.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(&(best, _)) = good.first() else {
            return Vec::new();
        };
        let alike = good
            .into_iter()
            .filter(|(left, _)| *left <= ALIKE * ALIKE * best.max(self.freedom));
        alike.map(|(_, set)| set).take(SHOWN).collect()
    }

    /// One file and cause after the other, each the one after which least is left.
    fn one_after_the_other(&self, trials: &[Trial]) -> Vec<usize> {
        let mut taken: Vec<usize> = Vec::new();
        let mut left = self.now;
        while taken.len() < MOST && !self.is_good(left) {
            let open = |place: &usize| {
                let is_of = |other: &usize| trials[*other].file == trials[*place].file;
                !taken.iter().any(is_of)
            };
            let tried = (0..trials.len()).filter(open).map(|place| {
                let left = self.of(&[&taken[..], &[place]].concat());
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
}

/// Everything that may be another in each file.
fn trials(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Vec<Trial> {
    let values = &fitted.solution.values;
    let equations = system.equations(rows, values, false);
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
            let there = system.equations(&system.prepare(changed.iter()), values, false);
            // What a calibration says stands below the rows, and is as it was.
            let count: usize = there.places.iter().map(|(_, count)| count).sum();
            let mut change = DVector::zeros(equations.residuals.len());
            let by = there.residuals.rows(0, count) - equations.residuals.rows(first, count);
            change.rows_mut(first, count).copy_from(&by);
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

/// An orthonormal basis of columns of any length.
fn orthonormal(mut columns: DMatrix<f64>) -> DMatrix<f64> {
    for mut column in columns.column_iter_mut() {
        let length = column.norm();
        if length > 0.0 {
            column /= length;
        }
    }
    columns.qr().q()
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
