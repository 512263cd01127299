//! The error of a model over the work space, before the correction and with it: what the page draws.

use serde::Serialize;
use volcomp_model::{
    Machine, MapGrid, ModelError, Temperatures, corrected, diagonals,
    kinematics::{Form, State, actual_pose},
    quantised,
};
use volcomp_vocabulary::AxisName;

/// Nodes along each axis of a section.
const NODES: usize = 21;
/// Nodes along each axis of the work space, its corners among them, where the largest error is sought.
const SOUGHT: usize = 11;
/// Corrections are taken in steps of this, as most controls do: mm and rad.
const STEP_MM: f64 = 1e-3;
const STEP_RAD: f64 = 1e-4 / 180.0 * std::f64::consts::PI;

/// One axis of a section.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SectionAxis {
    pub name: AxisName,
    pub travel: [f64; 2],
}

/// A plane through the middle of the work space.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Section {
    /// The axis across and the axis up.
    pub axes: [SectionAxis; 2],
    /// Where the third axis stands, mm.
    pub at: Option<(AxisName, f64)>,
    /// The length of the position error without correction, µm: rows along the axis up.
    pub before_um: Vec<Vec<f64>>,
    /// The same with correction in steps of 1 µm and 0.0001 deg.
    pub after_um: Vec<Vec<f64>>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorMap {
    /// Sections over the first two, the first and the last, and the last two of the linear axes.
    pub sections: Vec<Section>,
    /// The largest error of the whole work space before and after, µm: where the other axes stand.
    pub largest_um: [f64; 2],
    /// The ranges of the body diagonals (ISO 230-6) before and after, µm; empty where one of X, Y, Z is missing.
    pub diagonals_um: Vec<(&'static str, [f64; 2])>,
    /// Where the other axes stand, deg or mm.
    pub others: Vec<(AxisName, f64)>,
    /// Whether the terms of temperature are left out: the map is that at the reference temperature.
    pub reference_temperature: bool,
}

/// The larger of what was found and of these, before and after.
fn larger(largest_um: &mut [f64; 2], found_um: &[[f64; 2]]) {
    for (place, largest) in largest_um.iter_mut().enumerate() {
        let found = found_um.iter().map(|values| values[place]);
        *largest = found.fold(*largest, f64::max);
    }
}

/// Along each axis the places at which its curves have to be looked at, the others at their ends and in their middles or where
/// they are held: an error that repeats may have its zeros at all nodes of a grid.
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

/// The map of a model at its reference temperature, rotary axes where they are nearest to zero.
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
        let before = machine
            .error_at(state, Form::Exact, &none)
            .position_mm
            .norm();
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
    // A plane through the middle knows nothing of the corners.
    let space = MapGrid::over_travels(machine, [SOUGHT; 3], &others)?;
    let whole: Vec<[f64; 2]> = (0..space.len())
        .map(|index| lengths_um(&space.node(machine, index).1))
        .collect();
    larger(&mut map.largest_um, &whole);
    let between: Vec<[f64; 2]> = between_nodes(machine, &others)?
        .iter()
        .map(lengths_um)
        .collect();
    larger(&mut map.largest_um, &between);
    for (across, up) in [(0, 1), (0, 2), (1, 2)] {
        if up >= grid.axes.len() {
            continue;
        }
        let mut counts = [1; 3];
        for axis in [across, up] {
            let letters = [AxisName::X, AxisName::Y, AxisName::Z];
            if let Some(place) = letters.iter().position(|name| *name == grid.axes[axis]) {
                counts[place] = NODES;
            }
        }
        let plane = MapGrid::over_travels(machine, counts, &others)?;
        // The third axis has one node, so that the first axis of the section runs fastest.
        let both: Vec<[f64; 2]> = (0..plane.len())
            .map(|index| lengths_um(&plane.node(machine, index).1))
            .collect();
        larger(&mut map.largest_um, &both);
        let rows = |place: usize| {
            let rows = both.chunks(NODES);
            rows.map(|row| row.iter().map(|values| values[place]).collect())
                .collect()
        };
        let axis = |index: usize| SectionAxis {
            name: grid.axes[index],
            travel: machine
                .axis(grid.axes[index])
                .map_or([0.0; 2], |axis| axis.travel),
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
