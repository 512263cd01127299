//! Error of a model over the work space before and after correction, as drawn by the web interface.

use serde::Serialize;
use volcomp_model::{
    Machine, MapGrid, ModelError, Temperatures, corrected, diagonals,
    kinematics::{Form, State, actual_pose},
    quantised,
};
use volcomp_vocabulary::AxisName;

const SECTION_NODES: usize = 21;
/// Nodes along each axis of the grid, corners included, on which the largest error is searched.
const SEARCH_NODES: usize = 11;
/// Resolution of corrections, as in most controls: mm and rad.
const STEP_MM: f64 = 1e-3;
const STEP_RAD: f64 = 1e-4 / 180.0 * std::f64::consts::PI;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SectionAxis {
    pub name: AxisName,
    pub travel: [f64; 2],
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Section {
    /// The horizontal and the vertical axis.
    pub axes: [SectionAxis; 2],
    /// Position of the third axis, mm; `None` if the machine has only two linear axes.
    pub at: Option<(AxisName, f64)>,
    /// Length of the position error without correction, µm. Each row holds the nodes along the horizontal axis.
    pub before_um: Vec<Vec<f64>>,
    /// Length of the position error with correction, µm; correction resolution 1 µm and 0.0001 deg.
    pub after_um: Vec<Vec<f64>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorMap {
    /// Sections over pairs of linear axes: first and second, first and third, second and third.
    pub sections: Vec<Section>,
    /// Largest error of the whole work space before and after correction, µm, with the other axes at `others`.
    pub largest_um: [f64; 2],
    /// Range of the body diagonals (ISO 230-6) before and after correction, µm; empty if X, Y or Z is missing.
    pub diagonals_um: Vec<(&'static str, [f64; 2])>,
    /// Positions of the other axes, deg for rotary and mm for linear axes.
    pub others: Vec<(AxisName, f64)>,
    /// True if temperature terms are omitted: the map applies at the reference temperature.
    pub reference_temperature: bool,
}

/// Element-wise maximum, before and after correction.
fn larger(largest_um: &mut [f64; 2], found_um: &[[f64; 2]]) {
    for (place, largest) in largest_um.iter_mut().enumerate() {
        let found = found_um.iter().map(|values| values[place]);
        *largest = found.fold(*largest, f64::max);
    }
}

/// States along each axis at the positions that resolve its curves, with the other axes at their ends and middles or at
/// their held positions. A periodic error may be zero at all nodes of a regular grid.
fn between_nodes(machine: &Machine, held: &[(AxisName, f64)]) -> Result<Vec<State>, ModelError> {
    let mut states = Vec::new();
    for (axis, places) in machine.axes().iter().zip(machine.places()) {
        if held.iter().any(|(name, _)| *name == axis.name) {
            continue;
        }
        for share in [0.0, 0.5, 1.0] {
            for place in &places {
                let at = machine.axes().iter().map(|of| {
                    let [low, high] = of.travel;
                    let held = held.iter().find(|(name, _)| *name == of.name);
                    let at = match held {
                        Some((_, at)) => *at,
                        None if of.name == axis.name => *place,
                        None => low + share * (high - low),
                    };
                    (of.name, at)
                });
                states.push(machine.state(&at.collect::<Vec<_>>())?);
            }
        }
    }
    Ok(states)
}

/// Error map of a model at its reference temperature, with rotary axes at the position nearest to zero.
pub fn error_map(machine: &Machine) -> Result<ErrorMap, ModelError> {
    let none = Temperatures::new();
    let source = machine.source(&none);
    let others: Vec<(AxisName, f64)> = machine
        .axes()
        .iter()
        .filter(|axis| ![AxisName::X, AxisName::Y, AxisName::Z].contains(&axis.name))
        .map(|axis| (axis.name, axis.nearest_zero()))
        .collect();
    let grid = MapGrid::over_travels(machine, [1; 3], &others)?;
    let options = machine.correction_options();
    let commanded = |state: &State| {
        let correction = machine.correction_at(state, &none, &options);
        let delta = quantised(machine, &correction.delta, STEP_MM, STEP_RAD);
        corrected(state, &delta)
    };
    let chain = machine.chain();
    let lengths_um = |state: &State| {
        let before = machine.error_at(state, Form::Exact, &none).position_mm.norm();
        let actual = actual_pose(chain, &source, &commanded(state))
            .transform_point(&chain.tool_tip_mm())
            - chain.workpiece_origin_mm();
        let after = (actual - chain.ideal_tip_mm(state)).norm();
        [before, after].map(|mm| (mm * 1e5).round() / 100.0)
    };
    let mut map = ErrorMap {
        sections: Vec::new(),
        largest_um: [0.0; 2],
        diagonals_um: Vec::new(),
        others: others.clone(),
        reference_temperature: true,
    };
    // A section through the middle does not contain the corners.
    let space = MapGrid::over_travels(machine, [SEARCH_NODES; 3], &others)?;
    let whole: Vec<[f64; 2]> =
        (0..space.len()).map(|index| lengths_um(&space.node(machine, index).1)).collect();
    larger(&mut map.largest_um, &whole);
    let between: Vec<[f64; 2]> = between_nodes(machine, &others)?.iter().map(lengths_um).collect();
    larger(&mut map.largest_um, &between);
    for (across, up) in [(0, 1), (0, 2), (1, 2)] {
        if up >= grid.axes.len() {
            continue;
        }
        let mut counts = [1; 3];
        for axis in [across, up] {
            let letters = [AxisName::X, AxisName::Y, AxisName::Z];
            if let Some(place) = letters.iter().position(|name| *name == grid.axes[axis]) {
                counts[place] = SECTION_NODES;
            }
        }
        let plane = MapGrid::over_travels(machine, counts, &others)?;
        // The third axis has one node, so the first axis of the section varies fastest.
        let both: Vec<[f64; 2]> =
            (0..plane.len()).map(|index| lengths_um(&plane.node(machine, index).1)).collect();
        larger(&mut map.largest_um, &both);
        let rows = |place: usize| {
            let rows = both.chunks(SECTION_NODES);
            rows.map(|row| row.iter().map(|values| values[place]).collect()).collect()
        };
        let axis = |index: usize| SectionAxis {
            name: grid.axes[index],
            travel: machine.axis(grid.axes[index]).map_or([0.0; 2], |axis| axis.travel),
        };
        let third = (0..grid.axes.len()).find(|index| ![across, up].contains(index));
        map.sections.push(Section {
            axes: [axis(across), axis(up)],
            at: third.map(|index| (grid.axes[index], grid.nodes_mm[index][0])),
            before_um: rows(0),
            after_um: rows(1),
        });
    }
    if grid.axes.len() == 3 {
        let before = diagonals(machine, &source, 20, &others, |state| *state)?;
        let after = diagonals(machine, &source, 20, &others, commanded)?;
        map.diagonals_um = before
            .into_iter()
            .zip(after)
            .map(|(before, after)| (before.name, [before.range_um, after.range_um]))
            .collect();
    }
    Ok(map)
}
