//! Shortest paths through a weighted directed graph: between all pairs of nodes, and through layers of them.
//!
//! All pairs by R. W. Floyd, Algorithm 97, Communications of the ACM 5 (1962), 345; through layers by R. Bellman's
//! principle of optimality (Dynamic Programming, 1957). On a layered graph both find the same path; in the number of
//! layers, the time of the layered search is linear, that of all pairs cubic.

/// Why a graph is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GraphError {
    /// The length of a matrix row differs from the number of rows.
    #[error("found {found} weights from node {node}, expected {expected}: one to each node")]
    NotSquare {
        /// Node whose row has the wrong length, from 0.
        node: usize,
        /// Number of weights in the row of the node.
        found: usize,
        /// Number of nodes.
        expected: usize,
    },
    /// A weight is negative or NaN.
    #[error(
        "found a weight of {found} from node {from} to node {to}, expected 0 or more, or infinity where no edge is"
    )]
    Weight {
        /// Start of the edge, from 0.
        from: usize,
        /// End of the edge.
        to: usize,
        /// Weight of the edge.
        found: f64,
    },
}

/// Shortest paths between all pairs of nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct AllPairs {
    distances: Vec<Vec<f64>>,
    /// Second node of each shortest path; `None` without a path.
    next: Vec<Vec<Option<usize>>>,
    /// Number of path lengths compared: n³ for n nodes.
    pub operations: u64,
}

impl AllPairs {
    /// Length of the shortest path; infinite without a path or node.
    pub fn distance(&self, from: usize, to: usize) -> f64 {
        let row = self.distances.get(from);
        row.and_then(|row| row.get(to)).copied().unwrap_or(f64::INFINITY)
    }

    /// Nodes of the shortest path, both ends included; `None` without a path. Of paths of equal length it is the one found first.
    pub fn path(&self, from: usize, to: usize) -> Option<Vec<usize>> {
        let mut path = vec![from];
        let mut at = from;
        while at != to {
            at = (*self.next.get(at)?.get(to)?)?;
            path.push(at);
            if path.len() > self.next.len() {
                return None;
            }
        }
        (from < self.next.len()).then_some(path)
    }
}

/// Finds the shortest paths between all pairs of nodes. `weights[i][j]` is the weight of the edge from i to j, infinite without an edge.
/// `seen` is called after each round, with the number of nodes allowed as intermediate ones so far and all distances: D(0), D(1) … D(n).
///
/// # Errors
/// The matrix is not square, or a weight is negative or NaN.
pub fn all_pairs(
    weights: &[Vec<f64>],
    mut seen: impl FnMut(usize, &[Vec<f64>]),
) -> Result<AllPairs, GraphError> {
    let count = weights.len();
    let mut distances = Vec::with_capacity(count);
    let mut next = Vec::with_capacity(count);
    for (from, row) in weights.iter().enumerate() {
        if row.len() != count {
            return Err(GraphError::NotSquare { node: from, found: row.len(), expected: count });
        }
        for (to, &found) in row.iter().enumerate() {
            if found.is_nan() || found < 0.0 {
                return Err(GraphError::Weight { from, to, found });
            }
        }
        let edge = |(to, weight): (usize, &f64)| (from == to || weight.is_finite()).then_some(to);
        next.push(row.iter().enumerate().map(edge).collect::<Vec<_>>());
        let own = |(to, weight): (usize, &f64)| if from == to { 0.0 } else { *weight };
        distances.push(row.iter().enumerate().map(own).collect::<Vec<_>>());
    }
    seen(0, &distances);
    let mut operations = 0;
    for over in 0..count {
        let by = distances[over].clone();
        for from in 0..count {
            let first = distances[from][over];
            operations += count as u64;
            for (to, rest) in by.iter().enumerate() {
                let sum = first + rest;
                if sum < distances[from][to] {
                    distances[from][to] = sum;
                    next[from][to] = next[from][over];
                }
            }
        }
        seen(over + 1, &distances);
    }
    Ok(AllPairs { distances, next, operations })
}

/// Shortest path through layers of nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct Through {
    /// Node in each layer.
    pub nodes: Vec<usize>,
    /// Sum of the weights along the path.
    pub length: f64,
    /// Number of path lengths compared.
    pub operations: u64,
}

/// Finds the shortest path from any node of the first layer to any of the last. `counts` is the number of nodes of each layer;
/// `weight(layer, from, to)` is the weight of the edge from a node of a layer to one of the next, infinite without an edge. Of paths of
/// equal length the one with the first nodes wins. `None` if there is no path, or no layer.
pub fn through(
    counts: &[usize],
    mut weight: impl FnMut(usize, usize, usize) -> f64,
) -> Option<Through> {
    let mut lengths = vec![0.0; *counts.first()?];
    let mut before: Vec<Vec<usize>> = Vec::with_capacity(counts.len());
    let mut operations = 0;
    for (layer, &count) in counts.iter().enumerate().skip(1) {
        let mut to_here = vec![f64::INFINITY; count];
        let mut came_from = vec![0; count];
        for (from, length) in lengths.iter().enumerate() {
            for to in 0..count {
                operations += 1;
                let sum = length + weight(layer - 1, from, to);
                if sum < to_here[to] {
                    (to_here[to], came_from[to]) = (sum, from);
                }
            }
        }
        before.push(came_from);
        lengths = to_here;
    }
    let ends = lengths.iter().enumerate();
    let (mut at, &length) = ends.min_by(|a, b| a.1.total_cmp(b.1))?;
    if !length.is_finite() {
        return None;
    }
    let mut nodes = vec![at];
    for came_from in before.iter().rev() {
        at = came_from[at];
        nodes.push(at);
    }
    nodes.reverse();
    Some(Through { nodes, length, operations })
}
