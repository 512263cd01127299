//! What the machine file asks for over the travels: how large the correction of each axis becomes.

use volcomp_kinematics::State;
use volcomp_model::{Fading, Machine, Thermal};
use volcomp_runtime::{Model, PathPlan};
use volcomp_vocabulary::{AxisName, Direction, Displacement, PerAxis};

use crate::{
    documents::{ByAxis, round},
    error::GatewayError,
};

/// The most states of the grid that are looked at, from either direction of approach.
const STATES: usize = 4000;
/// The most places along an axis: more than that shows nothing new.
const PLACES: usize = 21;

/// What the machine file asks of a path within the travels, µm and µrad.
#[derive(Clone, Debug, Default)]
pub(super) struct Needs {
    /// The largest correction of each axis that corrects, without what temperatures add.
    pub(super) up_to: ByAxis,
    /// How much more temperatures may add to it with each kelvin of the sensors; empty without thermal terms.
    pub(super) per_k: ByAxis,
}

/// What a machine file asks of each path.
pub(super) fn of_paths(
    machine: &Machine,
    model: &Model,
    paths: &[PathPlan],
) -> Result<Vec<Needs>, GatewayError> {
    let mut unseen = machine.clone();
    unseen
        .set_thermal(Thermal {
            seen: Vec::new(),
            ..machine.thermal().clone()
        })
        .map_err(GatewayError::Model)?;
    let reference_degc = machine.thermal().reference_degc;
    // One kelvin more of one sensor, whatever the terms have seen.
    let warmer = (0..model.sensors().len()).map(|warm| {
        let mut model = Model::new(&unseen, Fading::default()).map_err(GatewayError::Model)?;
        let degc = |sensor| Some(reference_degc + if sensor == warm { 1.0 } else { 0.0 });
        let degc: Vec<Option<f64>> = (0..model.sensors().len()).map(degc).collect();
        model.step(0.0, &degc);
        Ok(model)
    });
    let warmer: Vec<Model> = warmer.collect::<Result<_, GatewayError>>()?;
    paths
        .iter()
        .map(|path| {
            let correction =
                |model: &Model, state: &State| model.correction_of(state, &path.correctors).delta;
            let per_k = |state: &State| {
                let before = correction(model, state);
                let mut sum = PerAxis::ZERO;
                for warmer in &warmer {
                    let after = correction(warmer, state);
                    for (sum, (after, before)) in sum.iter_mut().zip(after.iter().zip(&before)) {
                        *sum += (after - before).abs();
                    }
                }
                sum
            };
            let mut needs = Needs {
                up_to: if path.only_thermal {
                    ByAxis::new()
                } else {
                    largest(model, path, &|state| correction(model, state))
                },
                per_k: if warmer.is_empty() {
                    ByAxis::new()
                } else {
                    largest(model, path, &per_k)
                },
            };
            needs.per_k.retain(|_, most| *most > 0.0);
            Ok(needs)
        })
        .collect()
}

/// The largest of something of each axis that corrects in a path, over an even grid of the travels with their ends and, from
/// the largest of each axis, along all others where their curves have to be looked at; approached from either side: µm and µrad.
fn largest(model: &Model, path: &PathPlan, of: &dyn Fn(&State) -> PerAxis<f64>) -> ByAxis {
    let count = model.axes.len();
    let moves: Vec<usize> = (0..count).filter(|i| path.fixed[*i].is_none()).collect();
    let mut places = PLACES;
    while places > 2 && places.pow(u32::try_from(moves.len()).unwrap_or(u32::MAX)) > STATES {
        places -= 1;
    }
    let held = State {
        q: PerAxis::from_fn(|axis| path.fixed.get(axis).copied().flatten().unwrap_or_default()),
        approach: PerAxis::from_fn(|_| Some(Direction::Positive)),
    };
    let mut largest: PerAxis<(f64, State)> = PerAxis::from_fn(|_| (0.0, held));
    let look = |state: &State, largest: &mut PerAxis<(f64, State)>| {
        for (most, now) in largest.iter_mut().zip(of(state)) {
            if now.abs() > most.0 {
                *most = (now.abs(), *state);
            }
        }
    };
    for direction in [Direction::Positive, Direction::Negative] {
        let mut state = State::default();
        for axis in 0..count {
            state.approach[axis] = Some(direction);
            state.q[axis] = path.fixed[axis].unwrap_or_default();
        }
        let mut at = vec![0; moves.len()];
        loop {
            for (axis, place) in moves.iter().zip(&at) {
                let [low, high] = model.travel[*axis].map(Displacement::mm_or_rad);
                state.q[*axis] = low + (high - low) * f64::from(*place) / (places - 1) as f64;
            }
            look(&state, &mut largest);
            if !next(&mut at, places) {
                break;
            }
        }
    }
    for corrected in (0..count).filter(|axis| path.correctors.contains(*axis)) {
        for axis in &moves {
            let mut state = largest[corrected].1;
            for place in model.places(*axis) {
                state.q[*axis] = *place;
                look(&state, &mut largest);
            }
        }
    }
    let corrected = model.axes.iter().zip(largest).enumerate();
    corrected
        .filter(|(axis, _)| path.correctors.contains(*axis))
        .map(|(_, (name, (most, _)))| (*name, micro(*name, most)))
        .collect()
}

/// The next point of a grid; `false` after the last one.
fn next(at: &mut [u32], places: usize) -> bool {
    for place in at {
        *place += 1;
        if (*place as usize) < places {
            return true;
        }
        *place = 0;
    }
    false
}

fn micro(name: AxisName, value: f64) -> f64 {
    let micro = Displacement::new(name.kind(), value).um_or_urad();
    round((micro * 10.0).ceil() / 10.0)
}
