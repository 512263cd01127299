//! What is asked for: the correction over the work space, the axes, the bound and the memory of a map.

use volcomp_vocabulary::{AxisName, Direction};

use crate::{GRID_AXES, Map, Misfit, OUTPUTS};

/// A correction over the work space: for the coordinates of the axes of the grid (mm or deg) and the direction in which each
/// came (`None`: the mean of both), what is added to each output, mm.
pub trait Field {
    /// The correction of each output, mm.
    fn correction_mm(
        &self,
        at: &[f64; GRID_AXES],
        directions: &[Option<Direction>; GRID_AXES],
    ) -> [f64; OUTPUTS];

    /// Whether it depends on the directions.
    fn is_bidirectional(&self) -> bool {
        false
    }
}

impl<F: Fn(&[f64; GRID_AXES]) -> [f64; OUTPUTS]> Field for F {
    fn correction_mm(
        &self,
        at: &[f64; GRID_AXES],
        _: &[Option<Direction>; GRID_AXES],
    ) -> [f64; OUTPUTS] {
        self(at)
    }
}

/// An axis that a map goes over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridAxis {
    /// The axis.
    pub name: AxisName,
    /// Its travel, mm or deg.
    pub travel: [f64; 2],
    /// A step of the position that the control's program has, mm or deg.
    pub step: f64,
}

/// An axis that a map corrects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// The axis, a linear one.
    pub name: AxisName,
    /// A step of its correction, mm.
    pub step_mm: f64,
    /// The largest correction, mm: 2 at the most, the ceiling of the guard.
    pub limit_mm: f64,
}

/// What is asked of a map: its axes, the error that it may have and the memory that it may take.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// The axes of the grid, one to five.
    pub axes: Vec<GridAxis>,
    /// The axes that are corrected, one to three.
    pub outputs: Vec<Output>,
    /// The largest error between the map and the field, mm.
    pub within_mm: f64,
    /// The words that the control has for one map.
    pub words: usize,
    /// The number of the map, 1 to 65535.
    pub counter: u16,
    /// What tells the model, see [`Header::model`](crate::Header::model).
    pub model: u32,
}

/// A map and how far it is from its field.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// The map.
    pub map: Map,
    /// Its error, found on a dense sample between the lines and in both directions of approach.
    pub misfit: Misfit,
    /// The largest change of a correction along an axis of the grid, mm for each mm or deg.
    pub steepest: f64,
}

impl Request {
    /// The travel of each axis, mm or deg.
    pub(crate) fn travels(&self) -> Vec<[f64; 2]> {
        self.axes.iter().map(|axis| axis.travel).collect()
    }
}
