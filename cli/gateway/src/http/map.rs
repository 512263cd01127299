//! The error map around the current position.

use volcomp_kinematics::State;
use volcomp_runtime::Model;
use volcomp_vocabulary::{AxisName, Displacement, PerAxis};

use crate::documents::{ErrorMap, MapAxis, Status};

/// Number of nodes along each of the two axes.
const NODES: usize = 25;

/// Magnitude of the error over the travels of the first two linear axes, with the other axes at their current
/// positions.
pub(super) fn map(model: &Model, status: &Status) -> ErrorMap {
    let mut linear: Vec<(AxisName, usize)> = model
        .axes
        .iter()
        .enumerate()
        .filter(|(_, name)| !name.is_rotary())
        .map(|(index, name)| (*name, index))
        .collect();
    linear.sort_unstable();
    let [(_, first), (_, second), ..] = linear[..] else {
        return ErrorMap::default();
    };
    let temperature = |name: &str| {
        let mut sensors = status.temperatures.iter();
        sensors.find(|sensor| sensor.name == name)?.degc
    };
    let model = model.warmed(temperature);
    let mut at = State::default();
    for (q, name) in at.q.iter_mut().zip(&model.axes) {
        let shown = if name.is_rotary() {
            &status.positions_deg
        } else {
            &status.positions_mm
        };
        // Without the position of every axis there is no map.
        let Some(coordinate) = shown.get(name).copied() else {
            return ErrorMap::default();
        };
        *q = Displacement::from_coordinate(name.kind(), coordinate).mm_or_rad();
    }
    let nodes = |axis: usize| {
        let [low, high] = model.travel[axis].map(Displacement::mm_or_rad);
        (0..NODES).map(move |i| low + (high - low) * i as f64 / (NODES - 1) as f64)
    };
    let error_um = nodes(second)
        .map(|y| {
            nodes(first)
                .map(|x| {
                    let mut state = at;
                    (state.q[first], state.q[second]) = (x, y);
                    let [error, _] = model.errors(&state, &PerAxis::ZERO);
                    let [x, y, z] = error.position_mm;
                    (1e4 * (x * x + y * y + z * z).sqrt()).round() / 10.0
                })
                .collect()
        })
        .collect();
    let axis = |index: usize| MapAxis {
        name: model.axes[index],
        travel: model.travel[index].map(Displacement::mm_or_deg),
    };
    ErrorMap {
        axes: vec![axis(first), axis(second)],
        error_um,
    }
}
