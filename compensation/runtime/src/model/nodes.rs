//! Positions at which two models must be compared, mm and rad, and axes whose errors depend on the direction of approach.

use volcomp_model::{Machine, curve::Field};
use volcomp_vocabulary::Displacement;

/// Converts coordinates along each axis from mm or deg to mm or rad.
pub(super) fn in_mm_or_rad(machine: &Machine, along: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let along = along.into_iter().enumerate();
    along.map(|(axis, coordinates)| places(machine, axis, &coordinates)).collect()
}

/// Converts coordinates of an axis from mm or deg to mm or rad; empty for an axis that does not exist.
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

pub(super) fn reverses(machine: &Machine) -> Vec<bool> {
    let axes = machine.axes().iter();
    axes.map(|axis| machine.has_directions(axis.name)).collect()
}
