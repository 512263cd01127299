//! Where the curves of a machine have nodes, where they have to be looked at, and from which directions they differ: the places at
//! which a comparison of two machines has to look.

use volcomp_model::{
    Machine,
    curve::{ErrorCurve, Field},
};
use volcomp_vocabulary::Displacement;

/// The places along each axis, mm and rad, at which a curve of a machine has a node: where it may bend.
pub(super) fn nodes(machine: &Machine) -> Vec<Vec<f64>> {
    let mut nodes = vec![Vec::new(); machine.axes().len()];
    let mut add = |axis: usize, coordinates: &[f64]| {
        if let Some(nodes) = nodes.get_mut(axis) {
            nodes.extend(places(machine, axis, coordinates));
        }
    };
    for (name, curve) in machine.errors() {
        for field in curve.fields() {
            match field {
                Field::Curve(curve) => {
                    if let Ok(axis) = machine.index_of(name.axis) {
                        add(axis, &curve.breakpoints());
                    }
                }
                Field::Grid(grid) => {
                    for (axis, nodes) in grid.axes().into_iter().zip(grid.nodes()) {
                        add(axis, nodes);
                    }
                }
            }
        }
    }
    for nodes in &mut nodes {
        nodes.sort_by(f64::total_cmp);
        nodes.dedup();
    }
    nodes
}

/// The places along each axis, mm and rad, at which a curve of a machine has to be looked at ([`Machine::places`]).
pub(super) fn looked_at(machine: &Machine) -> Vec<Vec<f64>> {
    let along = machine.places().into_iter().enumerate();
    along
        .map(|(axis, coordinates)| places(machine, axis, &coordinates))
        .collect()
}

/// Coordinates of an axis, mm or deg, in mm or rad; none for an axis that is not there.
fn places(machine: &Machine, axis: usize, coordinates: &[f64]) -> Vec<f64> {
    let Some(axis) = machine.axes().get(axis) else {
        return Vec::new();
    };
    let kind = axis.name.kind();
    let place = |q: &f64| Displacement::from_coordinate(kind, *q).mm_or_rad();
    coordinates.iter().map(place).collect()
}

/// The nodes of a grid over two axes, mm and rad.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct GridNodes {
    pub(super) axes: [usize; 2],
    pub(super) nodes: [Vec<f64>; 2],
}

/// The grids of a machine, by the axes over which they lie.
pub(super) fn grids(machine: &Machine) -> Vec<GridNodes> {
    let mut grids: Vec<GridNodes> = Vec::new();
    for (_, curve) in machine.errors() {
        for field in curve.fields() {
            let Field::Grid(grid) = field else { continue };
            let axes = grid.axes();
            let nodes = [0, 1].map(|side| places(machine, axes[side], &grid.nodes()[side]));
            let grid = GridNodes { axes, nodes };
            if !grids.contains(&grid) {
                grids.push(grid);
            }
        }
    }
    grids
}

/// Whether an error of each axis depends on the direction from which the axis came.
pub(super) fn reverses(machine: &Machine) -> Vec<bool> {
    let mut reverses = vec![false; machine.axes().len()];
    for (name, curve) in machine.errors() {
        if let Ok(axis) = machine.index_of(name.axis) {
            reverses[axis] |= !matches!(curve, ErrorCurve::Single(_));
        }
    }
    reverses
}
