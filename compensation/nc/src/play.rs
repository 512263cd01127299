//! After how much travel back an axis counts as turned.
//!
//! Where an axis with play goes back, its table stands still until the play is passed: what it is off by goes over from one
//! direction's curve to the other's on this way. Half of the play is where the two are equally wrong.

use volcomp_model::{
    Machine,
    vocabulary::{Component, Direction, ErrorName, TURNED_AFTER, TURNED_AFTER_ROTARY},
};

use crate::coordinates::{Axes, is_rotary, name_of};

/// The play of an axis is looked at in so many places of its travel.
const NODES: u32 = 33;
/// Less is what words round to, mm and deg.
const LEAST: [f64; 2] = [5e-4, 5e-4];

/// For each axis that a program can name, mm and deg: half of its play, the largest over its travel, where that is less than what
/// holds for every axis.
pub(crate) fn turned_after(machine: &Machine) -> Axes<f64> {
    std::array::from_fn(|axis| {
        let rotary = is_rotary(axis);
        let usual = if rotary {
            TURNED_AFTER_ROTARY.0
        } else {
            TURNED_AFTER.0
        };
        match play(machine, axis) {
            Some(play) if play > 0.0 => (0.5 * play).clamp(LEAST[usize::from(rotary)], usual),
            _ => usual,
        }
    })
}

/// The largest play of an axis in its own direction, mm or deg.
fn play(machine: &Machine, axis: usize) -> Option<f64> {
    // X, U: EX; A: EA; and so on.
    const ALONG: [Component; 6] = [
        Component::EX,
        Component::EY,
        Component::EZ,
        Component::EA,
        Component::EB,
        Component::EC,
    ];
    let along = if axis < 6 { axis } else { axis - 6 };
    let name = name_of(axis)?;
    let place = machine.index_of(name).ok()?;
    let curve = machine.error(ErrorName::motion(ALONG[along], name))?;
    let [low, high] = machine.axis(name)?.travel;
    let mut coordinates = vec![0.0; machine.axes().len()];
    let mut largest = 0.0_f64;
    for node in 0..NODES {
        coordinates[place] = low + (high - low) * f64::from(node) / f64::from(NODES - 1);
        let [forward, backward] =
            Direction::BOTH.map(|direction| curve.value(place, &coordinates, Some(direction)));
        largest = largest.max((forward - backward).abs());
    }
    Some(if is_rotary(axis) {
        (1e-6 * largest).to_degrees()
    } else {
        1e-3 * largest
    })
}
