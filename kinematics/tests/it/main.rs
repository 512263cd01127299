//! Tests of the chain, its errors and its correction against independent implementations.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod conversions;
mod correction;
mod forms;
mod given;
mod inverse;
mod plain;
mod structures;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{Chain, ErrorMotion, GivenErrors, State, Structure};
use volcomp_vocabulary::AxisKind;

pub(crate) fn seeded(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

pub(crate) fn vector(rng: &mut ChaCha8Rng, size: f64) -> [f64; 3] {
    [(); 3].map(|()| rng.random_range(-size..=size))
}

/// A random error motion of up to ±20 µm and ±30 µrad.
pub(crate) fn motion(rng: &mut ChaCha8Rng) -> ErrorMotion {
    let [x, y, z] = vector(rng, 20.0);
    let [a, b, c] = vector(rng, 30.0);
    ErrorMotion::from_um_urad([x, y, z, a, b, c])
}

/// A chain with random points, tool tip and workpiece origin.
pub(crate) fn placed(structure: &Structure, rng: &mut ChaCha8Rng) -> Chain {
    let mut chain = Chain::new(structure.clone());
    for &axis in structure.axes() {
        chain.set_point(axis, vector(rng, 400.0)).unwrap();
    }
    chain.set_tool(vector(rng, 200.0), [0.0, 0.0, 1.0]).unwrap();
    chain.set_workpiece_origin(vector(rng, 200.0)).unwrap();
    chain
}

pub(crate) fn state(chain: &Chain, rng: &mut ChaCha8Rng) -> State {
    let mut state = State::default();
    for (place, joint) in state.q.iter_mut().zip(chain.joints()) {
        *place = match joint.kind {
            AxisKind::Linear => rng.random_range(-400.0..=400.0),
            AxisKind::Rotary => rng.random_range(-3.1..=3.1),
        };
    }
    state
}

/// Random error motions and assembly errors, and random location errors where these have an effect.
pub(crate) fn every_error(chain: &Chain, rng: &mut ChaCha8Rng) -> GivenErrors {
    let mut errors = GivenErrors::default();
    for (index, joint) in chain.joints().iter().enumerate() {
        errors.motion[index] = motion(rng);
        errors.assembly[index] = motion(rng);
        errors.location[index] = motion(rng);
        if joint.kind == AxisKind::Linear {
            errors.location[index].linear_mm.fill(0.0);
        }
    }
    errors
}

#[cfg(feature = "serde")]
#[test]
fn plain_data_goes_to_json_and_back() {
    use volcomp_kinematics::{Correction, CorrectionOptions};
    use volcomp_vocabulary::AxisName;
    let structure: Structure = "w C' X' b Y Z B t".parse().unwrap();
    let json = serde_json::to_string(&structure).unwrap();
    assert_eq!(json, "\"w C' X' b Y Z B t\"");
    assert_eq!(serde_json::from_str::<Structure>(&json).unwrap(), structure);
    assert!(serde_json::from_str::<Structure>("\"w X\"").is_err());
    let chain = Chain::new(structure);
    let mut errors = GivenErrors::default();
    errors.set(&chain, "EZB".parse().unwrap(), 5.0).unwrap();
    let state = State::new(
        &chain,
        [
            (AxisName::C, 1.0),
            (AxisName::X, 2.0),
            (AxisName::Y, 0.0),
            (AxisName::Z, 0.0),
            (AxisName::B, 0.0),
        ],
    )
    .unwrap();
    let correction =
        volcomp_kinematics::correct(&chain, &errors, &state, &CorrectionOptions::default());
    let read: Correction =
        serde_json::from_str(&serde_json::to_string(&correction).unwrap()).unwrap();
    assert_eq!(read, correction);
    let read: GivenErrors = serde_json::from_str(&serde_json::to_string(&errors).unwrap()).unwrap();
    assert_eq!(read, errors);
}
