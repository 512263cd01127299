//! The error map around the current position.

use serde_json::{Value, json};
use volcomp_kinematics::State;

use crate::model::Model;

/// Nodes along each of the two axes.
const NODES: usize = 25;

/// The length of the error (um) over the travels of two linear axes, the others where they stand now. `state` is
/// the document of `GET /api/state`.
pub(super) fn map(model: &Model, state: &Value) -> Value {
    let linear: Vec<usize> = (0..model.axes.len())
        .filter(|&index| !model.axes[index].is_rotary())
        .take(2)
        .collect();
    let [first, second] = linear[..] else {
        return json!({});
    };
    let temperature = |name: &str| {
        let list = state["temperatures"].as_array()?;
        list.iter().find(|t| t["name"] == *name)?["degc"].as_f64()
    };
    let model = model.warmed(temperature);
    let mut at = State::default();
    for (index, name) in model.axes.iter().enumerate() {
        let (key, factor) = if name.is_rotary() {
            ("positions_deg", std::f64::consts::PI / 180.0)
        } else {
            ("positions_mm", 1.0)
        };
        at.q[index] = state[key][name.to_string()].as_f64().unwrap_or(0.0) * factor;
    }
    let nodes = |axis: usize| {
        let [low, high] = model.travel[axis];
        (0..NODES).map(move |i| low + (high - low) * i as f64 / (NODES - 1) as f64)
    };
    let rows: Vec<Vec<f64>> = nodes(second)
        .map(|y| {
            nodes(first)
                .map(|x| {
                    let mut state = at;
                    (state.q[first], state.q[second]) = (x, y);
                    let [x, y, z] = model.compiled.evaluate(&state).position_mm;
                    (1e4 * (x * x + y * y + z * z).sqrt()).round() / 10.0
                })
                .collect()
        })
        .collect();
    let axis = |index: usize| json!({ "name": model.axes[index].to_string(), "travel": model.travel[index] });
    json!({ "axes": [axis(first), axis(second)], "error_um": rows })
}
