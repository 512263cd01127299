//! Errors over two coordinates: bilinear patches.

use alloc::vec::Vec;

use volcomp_vocabulary::{AxisName, Component};

use volcomp_kinematics::Chain;

use crate::{
    EvaluatorError,
    error::no_axis,
    index::{Cell, Uniform},
};

/// One component of an axis over two coordinates: bilinear between nodes, constant outside.
#[derive(Clone, Debug, PartialEq)]
pub struct Patch {
    /// The component of the axis.
    pub component: Component,
    /// Factors on the values for forward travel, backward travel, and an unknown direction of the axis to which the
    /// error belongs.
    pub weights: [f64; 3],
    /// The two axes whose coordinates the error depends on.
    pub axes: [AxisName; 2],
    /// Nodes along each of the two axes, ascending, mm or deg; at least one.
    pub nodes: [Vec<f64>; 2],
    /// Values at all nodes, mm or rad; the node of the second axis varies fastest.
    pub values: Vec<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CompiledPatch {
    pub(crate) patch: Patch,
    /// The chain indices of the two axes.
    pub(crate) looked_at: [usize; 2],
    places: [Places; 2],
}

#[derive(Clone, Debug, PartialEq)]
struct Places {
    index: Uniform,
    cells: Vec<Cell>,
    /// Start of each segment and the inverse of its length.
    segments: Vec<[f64; 2]>,
}

impl CompiledPatch {
    /// Creates the compiled form of a checked `patch`; `looked_at` are the chain indices of its
    /// axes.
    pub(crate) fn new(patch: Patch, looked_at: [usize; 2]) -> Self {
        Self { looked_at, places: patch.nodes.each_ref().map(|nodes| Places::new(nodes)), patch }
    }

    pub(crate) fn value(&self, at: [f64; 2]) -> f64 {
        let (i, s) = self.places[0].place(at[0]);
        let (j, t) = self.places[1].place(at[1]);
        let columns = self.patch.nodes[1].len();
        // A single node along an axis is its own neighbour.
        let down = if self.patch.nodes[0].len() > 1 { columns } else { 0 };
        let right = usize::from(columns > 1);
        let from = i * columns + j;
        let node = |place: usize| self.patch.values.get(place).copied().unwrap_or(0.0);
        let row = |start: usize| {
            let (left, right) = (node(start), node(start + right));
            left + (right - left) * t
        };
        let (upper, lower) = (row(from), row(from + down));
        upper + (lower - upper) * s
    }
}

impl CompiledPatch {
    pub(crate) fn of(patch: Patch, chain: &Chain) -> Result<Self, EvaluatorError> {
        let [first, second] = patch.axes;
        let place = |axis: AxisName| {
            let index = chain.structure().index_of(axis);
            index.ok_or_else(|| no_axis(chain, axis))
        };
        Ok(Self::new(patch, [place(first)?, place(second)?]))
    }
}

impl Places {
    /// Creates the segments between `nodes` (ascending, not empty). A single node gives one segment of zero inverse
    /// length.
    fn new(nodes: &[f64]) -> Self {
        let segment = |pair: &[f64]| [pair[0], 1.0 / (pair[1] - pair[0])];
        let mut segments: Vec<[f64; 2]> = nodes.windows(2).map(segment).collect();
        if segments.is_empty() {
            segments.push([nodes[0], 0.0]);
        }
        let mut cells = Vec::new();
        // The breakpoints of the index are the inner nodes. Without inner nodes, a breakpoint at the largest number has
        // no effect.
        let inner = nodes.get(1..nodes.len() - 1).filter(|inner| !inner.is_empty());
        let index = Uniform::add(&mut cells, inner.unwrap_or(&[f64::MAX]), 0);
        Self { index, cells, segments }
    }

    /// Segment of a coordinate, and the position in it, 0 to 1 (NaN for NaN).
    fn place(&self, x: f64) -> (usize, f64) {
        let cell = &self.cells[self.index.cell(x)];
        let mut place = cell.first as usize + usize::from(x >= cell.split);
        for _ in 0..cell.more {
            place += usize::from(self.segments.get(place + 1).is_some_and(|next| x >= next[0]));
        }
        let place = place.min(self.segments.len() - 1);
        let [start, per_length] = self.segments[place];
        let part = (x - start) * per_length;
        let part = if part < 0.0 { 0.0 } else { part };
        (place, if part > 1.0 { 1.0 } else { part })
    }
}

impl Patch {
    /// Checks all numbers; the error states the expected value of the first invalid number.
    pub(crate) fn check(&self) -> Result<(), &'static str> {
        let rises = |nodes: &[f64]| {
            nodes.iter().all(|node| node.is_finite())
                && nodes.windows(2).all(|pair| pair[0] < pair[1])
        };
        if self.nodes.iter().any(Vec::is_empty) {
            return Err("at least one node along each axis");
        }
        if !self.nodes.iter().all(|nodes| rises(nodes)) {
            return Err("finite nodes that rise along each axis");
        }
        if self.values.len() != self.nodes[0].len() * self.nodes[1].len() {
            return Err("one value for each pair of nodes");
        }
        let numbers = self.values.iter().chain(&self.weights);
        if !numbers.into_iter().all(|number| number.is_finite()) {
            return Err("finite values and weights");
        }
        Ok(())
    }

    /// The largest absolute slope along either axis, mm or rad per mm or deg.
    pub(crate) fn slope_bound(&self) -> f64 {
        let [first, second] = &self.nodes;
        let columns = second.len();
        let value = |i: usize, j: usize| self.values.get(i * columns + j).copied().unwrap_or(0.0);
        let mut bound = 0.0_f64;
        for i in 0..first.len() {
            for j in 0..columns {
                if i + 1 < first.len() {
                    let rise = value(i + 1, j) - value(i, j);
                    bound = bound.max(libm::fabs(rise / (first[i + 1] - first[i])));
                }
                if j + 1 < columns {
                    let rise = value(i, j + 1) - value(i, j);
                    bound = bound.max(libm::fabs(rise / (second[j + 1] - second[j])));
                }
            }
        }
        bound
    }
}
