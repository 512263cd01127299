//! Errors over two coordinates: bilinear patches.

use alloc::vec::Vec;

/// One component of an axis over two coordinates, bilinear between nodes, held outside.
#[derive(Clone, Debug, PartialEq)]
pub struct Patch {
    /// 0 to 5: which component.
    pub component: usize,
    /// How much of it counts forward, backward, and with unknown approach.
    pub weights: [f64; 3],
    /// The two axes looked at, by place in the chain.
    pub axes: [usize; 2],
    /// Nodes along each, rising, mm or deg; one at least.
    pub nodes: [Vec<f64>; 2],
    /// Values of the first axis's first node, then of its second …, mm or rad.
    pub values: Vec<f64>,
}

impl Patch {
    /// The value at the two coordinates.
    pub(crate) fn value(&self, at: [f64; 2]) -> f64 {
        let [first, second] = &self.nodes;
        let (i, s) = place(first, at[0]);
        let (j, t) = place(second, at[1]);
        let columns = second.len();
        let node = |i: usize, j: usize| {
            let (i, j) = (i.min(first.len() - 1), j.min(columns - 1));
            self.values.get(i * columns + j).copied().unwrap_or(0.0)
        };
        let row = |i: usize| {
            let (from, to) = (node(i, j), node(i, j + 1));
            from + (to - from) * t
        };
        let (from, to) = (row(i), row(i + 1));
        from + (to - from) * s
    }

    /// The largest slope along either axis.
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

/// The segment of a coordinate and the part of it passed, 0 to 1; NaN stays NaN.
fn place(nodes: &[f64], x: f64) -> (usize, f64) {
    let last = nodes.len() - 1;
    let segment = nodes
        .partition_point(|node| *node <= x)
        .saturating_sub(1)
        .min(last.saturating_sub(1));
    let Some(width) = nodes.get(segment + 1).map(|next| next - nodes[segment]) else {
        return (0, 0.0 * x);
    };
    let part = (x - nodes[segment]) / width;
    let part = if part < 0.0 { 0.0 } else { part };
    (segment, if part > 1.0 { 1.0 } else { part })
}
