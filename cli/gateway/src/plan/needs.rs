//! What the machine file asks for over the travels: how large the correction of each axis becomes.

use volcomp_kinematics::State;
use volcomp_runtime::{Model, PathPlan};
use volcomp_vocabulary::{AxisName, Direction, Displacement, PerAxis};

use crate::documents::{ByAxis, round};

/// The most states of the grid that are looked at, from either direction of approach.
const STATES: usize = 4000;
/// The most places along an axis: more than that shows nothing new.
const PLACES: usize = 21;

/// The largest correction of each axis that the model asks of a path, over an even grid of the travels with their ends and, from
/// the largest of each axis, along all others where their curves have to be looked at; approached from either side, without what
/// temperatures add: µm and µrad.
pub(super) fn largest(model: &Model, path: &PathPlan) -> ByAxis {
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
        let delta = model.correction_of(state, &path.correctors).delta;
        for (most, now) in largest.iter_mut().zip(delta) {
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
