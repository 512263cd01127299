//! Error motions of the machine file that contradict the rows with their sign or in their unit: curves that were measured before,
//! and are kept.

use volcomp_kinematics::nalgebra::DVector;
use volcomp_vocabulary::{Component, ErrorName};

use crate::{
    derivatives::component_of,
    identify::{Fitted, fit},
    left::{BETTER, Left},
    observations::Observations,
    prepared::Rows,
    system::System,
};

/// 1 arc second, µrad.
const ARC_SECOND: f64 = 4.848_136_811;

/// By what a curve may have to be multiplied, and why.
const FACTORS: [(f64, &str); 5] = [
    (-1.0, "with the opposite sign"),
    (0.0, "without it"),
    (1e3, "times 1000"),
    (1e-3, "divided by 1000"),
    (ARC_SECOND, "times 4.848, as if it were in arc seconds"),
];

/// A curve that is tried with a factor. The rows with it are made when they are needed: many of them at a time are much memory.
struct Trial {
    error: ErrorName,
    /// The place of its axis in the chain.
    place: usize,
    factor: f64,
    words: &'static str,
}

impl Trial {
    fn of(&self, rows: &Rows) -> Rows {
        let mut scaled = rows.clone();
        for row in &mut scaled.0 {
            for stand in core::iter::once(&mut row.stand).chain(&mut row.from) {
                let motion = &mut stand.known.motion[self.place];
                *component_of(motion, self.error.component.index()) *= self.factor;
                let sides = stand.sides.iter_mut();
                for side in sides.filter(|side| side.axis == self.place) {
                    let known = &mut side.known;
                    *component_of(known, self.error.component.index()) *= self.factor;
                }
            }
        }
        scaled
    }
}

/// Notes on curves of the machine file with which far more is left than with another factor of theirs.
pub(crate) fn kept_curves(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Vec<String> {
    if fitted.solution.excess().is_none() {
        return Vec::new();
    }
    let values = &fitted.solution.values;
    let mut trials: Vec<Trial> = Vec::new();
    for (place, axis) in system.machine.axes().iter().enumerate() {
        for component in Component::ALL {
            let known = |rows: &Rows| {
                let mut stands = rows.0.iter().map(|row| row.stand.known);
                stands.any(|mut known| {
                    *component_of(&mut known.motion[place], component.index()) != 0.0
                })
            };
            let error = ErrorName::motion(component, axis.name);
            if observations.measured.contains(&error) || !known(rows) {
                continue;
            }
            for (factor, words) in FACTORS {
                let is_angle = component.is_angular();
                if factor == ARC_SECOND && !is_angle {
                    continue;
                }
                trials.push(Trial {
                    error,
                    place,
                    factor,
                    words,
                });
            }
        }
    }
    let before = system.equations(rows, values).residuals;
    let changes: Vec<DVector<f64>> = trials
        .iter()
        .map(|trial| system.equations(&trial.of(rows), values).residuals - &before)
        .collect();
    let left = Left::new(system, rows, fitted, &changes.iter().collect::<Vec<_>>());
    let found = left.good((0..trials.len()).map(|place| vec![place]).collect());
    let fits = found.into_iter().flatten().filter_map(|place| {
        let other = fit(
            system,
            observations,
            &trials[place].of(rows),
            values.clone(),
        )
        .ok()?;
        let is_as_stated = other.solution.excess().is_none();
        Some((place, is_as_stated, other.solution.variance.sqrt()))
    });
    let fits: Vec<(usize, bool, f64)> = fits.collect();
    let now = fitted.solution.variance.sqrt();
    let any_as_stated = fits.iter().any(|(_, is_as_stated, _)| *is_as_stated);
    // Others beside one that leaves what was stated are no explanation.
    let is_better = |(_, is_as_stated, then): &&(usize, bool, f64)| {
        *is_as_stated || (!any_as_stated && *then < BETTER * now)
    };
    let note = |(place, _, then): &(usize, bool, f64)| {
        let Trial { error, words, .. } = &trials[*place];
        format!(
            "{error}: {words} the curve of the machine file leaves {then:.1} times the stated uncertainty in place of {now:.1}: are its sign and its unit right?"
        )
    };
    fits.iter().filter(is_better).map(note).collect()
}
