//! A table over up to three linear axes at once.

use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName;

use super::{refusal::ExchangeError, sampled::TableOptions};

/// Most lines along an axis.
pub(crate) const MOST_LINES: usize = 25;

/// The deviations (actual − commanded, mm) of linear axes on a grid of linear axes, linear in each axis within a cell.
#[derive(Clone, Debug, PartialEq)]
pub struct GridTable {
    /// The axes of the grid, the slowest first.
    pub axes: Vec<AxisName>,
    /// The positions of the lines along each, rising, mm.
    pub lines: Vec<Vec<f64>>,
    /// The axes that deviate.
    pub outputs: Vec<AxisName>,
    /// For each node, the last axis of the grid the fastest, one deviation of each output, mm.
    pub values: Vec<f64>,
}

impl GridTable {
    /// The grid of a machine: the mean of both directions, the other axes where they stand.
    pub(crate) fn of(
        machine: &Machine,
        temperatures: &Temperatures,
        options: &TableOptions,
    ) -> Result<Self, ExchangeError> {
        let reference = machine.state(&options.reference(machine)?)?;
        let wanted = machine.correction_options();
        let correctors = wanted.correctors(machine.chain());
        let mut places = correctors.linear().to_vec();
        places.sort_unstable_by_key(|&place| machine.axes()[place].name.index());
        let axes: Vec<AxisName> = places
            .iter()
            .map(|&place| machine.axes()[place].name)
            .collect();
        let along = |&place: &usize| {
            let [low, high] = machine.axes()[place].travel;
            let parts = ((high - low) / options.step_mm - 1e-9).ceil();
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "between 1 and 24"
            )]
            let parts = parts.clamp(1.0, (MOST_LINES - 1) as f64) as u32;
            let line = |part: u32| low + (high - low) * f64::from(part) / f64::from(parts);
            (0..=parts).map(line).collect()
        };
        let lines: Vec<Vec<f64>> = places.iter().map(along).collect();
        let mut grid = Self {
            outputs: axes.clone(),
            axes,
            lines,
            values: Vec::new(),
        };
        for node in 0..grid.nodes() {
            let mut state = reference;
            for (place, at) in places.iter().zip(grid.node(node)) {
                state.q[*place] = at;
            }
            let found = machine.correction_at(&state, temperatures, &wanted);
            grid.values
                .extend(places.iter().map(|&place| 0.0 - found.delta[place]));
        }
        Ok(grid)
    }

    /// How many nodes there are.
    pub fn nodes(&self) -> usize {
        self.lines.iter().map(Vec::len).product()
    }

    /// Where a node is, mm.
    pub fn node(&self, mut index: usize) -> Vec<f64> {
        let mut at: Vec<f64> = Vec::with_capacity(self.lines.len());
        for lines in self.lines.iter().rev() {
            let count = lines.len().max(1);
            at.push(lines.get(index % count).copied().unwrap_or(0.0));
            index /= count;
        }
        at.reverse();
        at
    }

    /// The deviations of the outputs at a position of the axes of the grid, mm.
    pub fn deviation(&self, at: &[f64]) -> Vec<f64> {
        let outputs = self.outputs.len();
        let cells: Vec<(usize, f64)> = self
            .lines
            .iter()
            .zip(at)
            .map(|(lines, at)| {
                let above = lines.partition_point(|line| line <= at);
                let cell = above.saturating_sub(1).min(lines.len().saturating_sub(2));
                let share = match (lines.get(cell), lines.get(cell + 1)) {
                    (Some(low), Some(high)) => ((at - low) / (high - low)).clamp(0.0, 1.0),
                    _ => 0.0,
                };
                (cell, share)
            })
            .collect();
        let mut sum = vec![0.0; outputs];
        for corner in 0..1_usize << cells.len() {
            let (mut node, mut weight) = (0, 1.0);
            for (axis, (cell, share)) in cells.iter().enumerate() {
                let far = corner >> axis & 1;
                node = node * self.lines[axis].len() + cell + far;
                weight *= if far == 1 { *share } else { 1.0 - share };
            }
            if weight == 0.0 {
                continue;
            }
            for (output, sum) in sum.iter_mut().enumerate() {
                let value = self.values.get(node * outputs + output);
                *sum += weight * value.copied().unwrap_or(0.0);
            }
        }
        sum
    }
}
